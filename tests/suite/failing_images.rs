//! What is left of a comparison of images that fails: the image, its reference, their difference and the z-scores, for
//! someone to look at.

use crate::support::root;
use qtracer::Image;
use qtracer::film::{WriteOptions, false_colour, luminance, read_image, write_image};
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// |z| that has the full colour in the picture of z-scores.
const FULL_COLOUR: f32 = 5.0;
/// What f32 arithmetic in another order may change, relatively: as much noise is assumed in every z-score.
const ROUNDING: f32 = 2.5e-6;

/// Fails unless `agrees`, naming the seed and the folder of the images: `target/failed-images` or
/// `QTRACER_FAILED_IMAGES`, and in it one for each `test`.
pub fn expect_agreement(
    agrees: bool,
    test: &str,
    seed: u32,
    (image, reference): (&Image, &Image),
    findings: impl Display,
) {
    if !agrees {
        let folder = std::env::var_os("QTRACER_FAILED_IMAGES")
            .map_or_else(|| root().join("target/failed-images"), PathBuf::from)
            .join(file_name(test));
        fail(&folder, &format!("{test}, seed {seed}: {findings}"), image, reference);
    }
}

/// Panics with `what`, and where the images are.
fn fail(folder: &Path, what: &str, image: &Image, reference: &Image) -> ! {
    match write_all(folder, image, reference) {
        Ok(()) => panic!("{what}\nimage, reference, difference and z-scores are in {}", folder.display()),
        Err(error) => panic!("{what}\nand its images can't be written: {error}"),
    }
}

/// Letters, figures and hyphens.
fn file_name(test: &str) -> String {
    let words = test.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join("-").to_lowercase()
}

/// `.exr` with the numbers, per channel and signed; `.png` in false colours, red where the image is brighter.
fn write_all(folder: &Path, image: &Image, reference: &Image) -> Result<(), Box<dyn std::error::Error>> {
    std::fs::create_dir_all(folder)?;
    let over_pixels = |value: &dyn Fn(usize) -> [f32; 3]| {
        Image::new(image.width, image.height, (0..image.rgb.len()).map(value).collect())
    };
    let difference = |i: usize| std::array::from_fn(|c| image.rgb[i][c] - reference.rgb[i][c]);
    let scores = |i: usize| z_scores(image, reference, i);
    let brightness = |i: usize| {
        let [a, b] = [image.rgb[i], reference.rgb[i]].map(|rgb| luminance(rgb.map(f64::from)) as f32);
        false_colour(4.0 * (a - b) / (b.abs() + 0.01))
    };
    let noise = |i: usize| {
        let worst = scores(i).into_iter().fold(0.0, |a: f32, z| if a.abs() >= z.abs() { a } else { z });
        false_colour(worst / FULL_COLOUR)
    };
    let files = [
        ("image.exr", image.clone()),
        ("reference.exr", reference.clone()),
        ("difference.exr", over_pixels(&difference)),
        ("z-scores.exr", over_pixels(&scores)),
        ("image.png", image.clone()),
        ("reference.png", reference.clone()),
        ("difference.png", over_pixels(&brightness)),
        ("z-scores.png", over_pixels(&noise)),
    ];
    for (name, picture) in files {
        write_image(&folder.join(name), &picture, &WriteOptions::default())?;
    }
    Ok(())
}

/// Difference over standard error of a pixel, per channel.
fn z_scores(image: &Image, reference: &Image, pixel: usize) -> [f32; 3] {
    let error = |of: &Image, c: usize| of.standard_error.as_ref().map_or(0.0, |errors| errors[pixel][c]);
    std::array::from_fn(|c| {
        let (a, b) = (image.rgb[pixel][c], reference.rgb[pixel][c]);
        let variance = error(image, c).powi(2) + error(reference, c).powi(2);
        let rounding = ROUNDING * a.abs().max(b.abs());
        if a == b { 0.0 } else { (a - b) / (variance + rounding * rounding).sqrt() }
    })
}

/// A grey image of 4 × 3 pixels whose errors are a tenth.
fn grey() -> Image {
    Image { standard_error: Some(vec![[0.1; 3]; 12]), ..Image::new(4, 3, vec![[0.5; 3]; 12]) }
}

/// Makes a comparison fail on purpose and finds what it says it left.
#[test]
fn a_comparison_that_fails_leaves_its_images_and_names_their_folder_and_the_seed() {
    let (folder, reference) = (tempfile::tempdir().unwrap(), grey());
    let mut image = grey();
    (image.rgb[5], image.rgb[6]) = ([0.8, 0.5, 0.5], [0.5, 0.1, 0.5]);
    let place = folder.path().join(file_name("Some test: on Wavefront(Fused)"));
    assert!(place.ends_with("some-test-on-wavefront-fused"));
    let failure = std::panic::catch_unwind(|| fail(&place, "some test, seed 77: 3 %", &image, &reference));
    let failure = failure.unwrap_err();
    let message = failure.downcast_ref::<String>().unwrap();
    assert!(message.contains("seed 77") && message.contains(place.to_str().unwrap()), "{message}");

    let read = |name: &str| read_image(&place.join(name)).unwrap();
    assert_eq!((read("image.exr").rgb, read("reference.exr").rgb), (image.rgb.clone(), reference.rgb));
    let (difference, z) = (read("difference.exr").rgb, read("z-scores.exr").rgb);
    let close = |a: f32, b: f32| (a - b).abs() < 1e-4;
    assert!(close(difference[5][0], 0.3) && close(difference[6][1], -0.4), "{difference:?}");
    let sigma = 0.02f32.sqrt();
    assert!(close(z[5][0], 0.3 / sigma) && close(z[6][1], -0.4 / sigma) && z[0] == [0.0; 3], "{z:?}");
    for name in ["difference.png", "z-scores.png"] {
        let rgb = read(name).rgb;
        assert!(rgb[5][0] > rgb[5][2] && rgb[6][2] > rgb[6][0] && rgb[0] == [0.0; 3], "{name}: {rgb:?}");
    }
    assert!(read("image.png").rgb.len() == 12 && read("reference.png").rgb.len() == 12);
}

#[test]
fn a_comparison_that_passes_leaves_nothing() {
    expect_agreement(true, "a comparison that passes", 1, (&grey(), &grey()), "");
    assert!(!root().join("target/failed-images/a-comparison-that-passes").exists());
}
