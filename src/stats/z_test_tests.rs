//! Negative controls: the test must fail what is wrong, and what is right only as often as it promises.

use super::super::test_images::TestImage;
use super::*;

const PIXELS: ZTestOptions =
    ZTestOptions { alpha: 0.01, block: 8, pixels_decisive: true, dispersion_decisive: false };

fn truth(width: usize, height: usize) -> TestImage {
    let mut truth = TestImage::noisy(0, width, height);
    for pixel in 0..width * height {
        for channel in 0..3 {
            truth.rgb[pixel][channel] = (0.5 + 0.4 * (pixel as f64 * 0.03 + channel as f64).sin()) as f32;
        }
    }
    truth
}

fn passes(a: &TestImage, b: &TestImage, options: &ZTestOptions) -> bool {
    z_test(&a.view(), &b.view(), options).unwrap().passes
}

/// α = 0.05 over 1500 seeds: 75 ± 8.4 false alarms; bounds at 4 σ. Two noisy images, both errors known.
#[test]
fn right_images_fail_as_often_as_alpha_says() {
    let options = ZTestOptions { alpha: 0.05, ..PIXELS };
    let alarms = |options: &ZTestOptions| {
        let fails = |seed| {
            !passes(&TestImage::noisy(seed, 32, 24), &TestImage::noisy(seed + 1_000_000, 32, 24), options)
        };
        (1..=1500).filter(|&seed| fails(seed)).count()
    };
    for options in [options, ZTestOptions { pixels_decisive: false, ..options }] {
        let count = alarms(&options);
        assert!((41..=109).contains(&count), "{count} false alarms in 1500");
    }
}

/// The dispersion is on the safe side for independent channels: never more false alarms than α.
#[test]
fn dispersion_of_right_images_is_one() {
    let truth = truth(64, 64);
    let options = ZTestOptions { dispersion_decisive: true, ..Default::default() };
    let reports: Vec<_> = (1..=200)
        .map(|seed| z_test(&TestImage::noisy(seed, 64, 64).view(), &truth.exact(), &options).unwrap())
        .collect();
    let mean = reports.iter().map(|r| r.dispersion.mean_square_z).sum::<f64>() / 200.0;
    assert!((mean - 1.0).abs() < 0.03, "{mean}");
    assert!(reports.iter().filter(|r| !r.passes).count() <= 8);
}

#[test]
fn errors_stated_too_small_widen_the_dispersion() {
    let mut image = TestImage::noisy(3, 128, 128);
    image.standard_error.iter_mut().flatten().for_each(|se| *se *= 0.7);
    let report = z_test(&image.view(), &truth(128, 128).exact(), &ZTestOptions::default()).unwrap();
    assert!(report.dispersion.mean_square_z > 1.7 && !report.dispersion.passes());
}

#[test]
fn a_two_percent_brighter_image_fails_the_z_test() {
    for seed in 1..=20 {
        let brighter = TestImage::noisy(seed, 64, 64).scaled(1.02);
        assert!(
            !passes(&brighter, &TestImage::noisy(seed + 99, 64, 64), &ZTestOptions::default()),
            "seed {seed}"
        );
    }
}

#[test]
fn one_wrong_block_fails_the_z_test_and_is_named() {
    for seed in 1..=20 {
        let mut wrong = TestImage::noisy(seed, 64, 64);
        for pixel in (16..24).flat_map(|y| (40..48).map(move |x| y * 64 + x)) {
            wrong.rgb[pixel][1] *= 1.1;
        }
        let report = z_test(&wrong.view(), &truth(64, 64).exact(), &ZTestOptions::default()).unwrap();
        assert!(!report.passes, "seed {seed}");
        assert_eq!((report.blocks.x, report.blocks.y, report.blocks.channel), (40, 16, 1));
    }
}

#[test]
fn one_wrong_pixel_fails_where_pixels_decide() {
    let mut wrong = TestImage::noisy(5, 64, 64);
    let pixel = 33 * 64 + 21;
    wrong.rgb[pixel][2] += 20.0 * wrong.standard_error[pixel][2];
    let reference = truth(64, 64);
    assert!(!passes(&wrong, &reference, &PIXELS));
    assert!(passes(&wrong, &reference, &ZTestOptions::default()));
    let report = z_test(&wrong.view(), &reference.exact(), &PIXELS).unwrap();
    assert_eq!(
        (report.pixels.extreme.x, report.pixels.extreme.y, report.pixels.extreme.channel),
        (21, 33, 2)
    );
}

#[test]
fn exact_values_must_agree_to_rounding() {
    let exact = TestImage::constant(16, 16, [0.5; 3]);
    let nearly = exact.clone().scaled(1.0 + 5e-6);
    let wrong = exact.clone().scaled(1.0 + 5e-5);
    assert!(passes(&nearly, &exact, &PIXELS));
    assert!(!passes(&wrong, &exact, &ZTestOptions::default()));
    let mut one_block = exact.clone();
    one_block.rgb[0][0] = 0.6;
    let report = z_test(&one_block.view(), &exact.exact(), &ZTestOptions::default()).unwrap();
    assert_eq!(report.blocks.max_abs_z, f64::INFINITY);
}

#[test]
fn not_a_number_fails_the_z_test() {
    let mut image = TestImage::noisy(1, 16, 16);
    image.rgb[77][0] = f32::NAN;
    assert!(!passes(&image, &truth(16, 16), &ZTestOptions::default()));
}

#[test]
fn questions_without_an_answer_are_errors() {
    let image = TestImage::noisy(1, 16, 16);
    let options = ZTestOptions::default();
    assert_eq!(z_test(&image.exact(), &image.exact(), &options), Err(StatsError::NoStandardErrors));
    for alpha in [0.0, 1.0, f64::NAN] {
        assert!(z_test(&image.view(), &image.view(), &ZTestOptions { alpha, ..options }).is_err());
    }
    assert!(z_test(&image.view(), &image.view(), &ZTestOptions { block: 0, ..options }).is_err());
    let mut unknown = image.clone();
    unknown.standard_error[18][2] = f32::INFINITY;
    let error = z_test(&image.view(), &unknown.view(), &options).unwrap_err();
    assert!(error.to_string().contains("second image's standard error is inf at pixel (2, 1)"), "{error}");
}

#[test]
fn edge_blocks_smaller_than_the_rest_are_tested_too() {
    let mut image = truth(19, 11);
    let pixel = 10 * 19 + 18;
    image.rgb[pixel][0] += 40.0 * image.standard_error[pixel][0];
    let report = z_test(&image.view(), &truth(19, 11).exact(), &ZTestOptions::default()).unwrap();
    assert!(!report.passes);
    assert_eq!((report.blocks.x, report.blocks.y, report.blocks.tests), (16, 8, 18));
}
