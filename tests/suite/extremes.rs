//! Whole renders of extremes, each with a closed form: albedo 0.999, radiances from 1e-8 to 1e8, lights 1e8 : 1, a tiny light
//! near beside an enclosing one, a million samples.

use crate::furnace::{closed_form, mean_and_relative_error};
use crate::guiding_renders::guided;
use crate::support::*;
use glam::DVec3;
use qtracer::gpu::stage::Schedule;
use qtracer::guiding::GuideMode;
use qtracer::scene::{Material, MaterialKind};
use qtracer::stats::{normal_two_sided_threshold, sidak};
use qtracer::transport::roulette::Roulette;
use qtracer::{Image, RenderOptions, Scene};

/// One engine of each class.
const CLASSES: [Engine; 3] = [Engine::Cpu, Engine::Megakernel, Engine::Wavefront(Schedule::Fused)];

/// The closed furnace with this albedo.
fn furnace_of(albedo: f64) -> Scene {
    let mut scene = scene("furnace-closed-99");
    scene.materials[0].kind = MaterialKind::Diffuse { color: DVec3::splat(albedo) };
    scene
}

fn unlit(roulette: Roulette, options: RenderOptions) -> RenderOptions {
    RenderOptions { direct_light: Some(false), roulette: Some(roulette), max_bounces: Some(64), ..options }
}

/// Sixty-four levels at albedo 0.999: 62.0, of which each level is as bright as the first but for a thousandth. No noise, so
/// the bound of 1e-5 is that of 64 roundings and of f32 sums.
#[test]
fn sixty_four_levels_at_albedo_0_999_are_the_closed_form() {
    let expected = closed_form(0.999, 64);
    for engine in ENGINES {
        let image = render(&furnace_of(0.999), engine, &unlit(Roulette::Off, small(12, 12, 7)), 4).image;
        let off =
            image.rgb.iter().flatten().map(|v| (f64::from(*v) / expected - 1.0).abs()).fold(0.0, f64::max);
        println!("{engine:?}: {off:.1e} off");
        assert!(off < 1e-5, "{engine:?}: {off}");
    }
}

/// The same while paths are guided and end by what was learnt: within 4 standard errors, α = 6.3e-5 each.
#[test]
fn sixty_four_levels_at_albedo_0_999_are_the_closed_form_when_guided() {
    let expected = closed_form(0.999, 64);
    let ways = [
        (Engine::Cpu, GuideMode::Adaptive, Roulette::Learnt),
        (Engine::Megakernel, GuideMode::Octant, Roulette::Learnt),
        (Engine::Wavefront(Schedule::Fused), GuideMode::Octant, Roulette::Off),
    ];
    for (engine, mode, roulette) in ways {
        let mut options = unlit(roulette, guided(6, 6, 79, mode, roulette));
        // Learnt roulette of a table that is young here lets few paths live, which weigh much.
        options.guide.mature_samples = 64;
        let image = render(&furnace_of(0.999), engine, &options, 510).image;
        let judge = |image: &Image| {
            let (mean, error) = mean_and_relative_error(image);
            (mean / expected - 1.0, error)
        };
        let (off, error) = judge(&image);
        println!("{mode}, roulette {roulette} on {engine:?}: {off:.1e} off, s.e. {error:.1e}");
        assert!(error < 0.05, "{mode} on {engine:?}: too few samples, s.e. {error}");
        assert!(off.abs() < 4.0 * error, "{mode} on {engine:?}: {off} off, s.e. {error}");
        // Negative control.
        let (off, error) = judge(&brightened(&image, 1.3));
        assert!(off.abs() > 4.0 * error, "30 % brighter passes: {mode} on {engine:?}, {off} {error}");
    }
}

/// The scene with all its light times `factor`.
fn relit(scene: &Scene, factor: f64) -> Scene {
    let mut scene = scene.clone();
    scene.environment *= factor;
    scene.materials.iter_mut().for_each(|material| material.emission *= factor);
    scene
}

/// How many sums and colours of `b` are not those of `a` times `factor`, a power of two, to the bit.
fn unscaled(a: &Render, b: &Render, factor: f64) -> usize {
    let scaled = |[x, y]: [&[f64; 3]; 2], factor: f64| x.map(|v| v * factor) == *y;
    let films = a.film.pixels().iter().zip(b.film.pixels());
    let sums = films.filter(|(a, b)| {
        !(scaled([&a.sum, &b.sum], factor) && scaled([&a.sum_sq, &b.sum_sq], factor * factor))
    });
    let images = a.image.rgb.iter().zip(&b.image.rgb);
    sums.count() + images.filter(|(a, b)| a.map(|v| v * factor as f32) != **b).count()
}

/// Radiances of 2^-27, 2^27 (1.3e8) and 2^45 times the scene's: the image is that of the scene times so much, to the bit,
/// guided or not. So what is learnt neither overflows nor vanishes, and helps as much as ever.
#[test]
fn light_of_any_strength_makes_the_same_image_to_the_bit() {
    let cornell = scene("cornell-box");
    let guides = [GuideMode::Off, GuideMode::Adaptive, GuideMode::Octant];
    for (i, mode) in guides.into_iter().enumerate() {
        let roulette = if mode == GuideMode::Off { Roulette::Throughput } else { Roulette::Learnt };
        let options = guided(16, 16, 8, mode, roulette);
        for engine in [Engine::Cpu, [CLASSES[1], CLASSES[2], CLASSES[1]][i]] {
            let plain = render(&cornell, engine, &options, 30);
            for exponent in if engine == Engine::Cpu { vec![-27, 27, 45] } else { vec![-27, 45] } {
                let factor = 2f64.powi(exponent);
                let mut other = render(&relit(&cornell, factor), engine, &options, 30);
                let differing = unscaled(&plain, &other, factor);
                assert_eq!(differing, 0, "{engine:?}, guide {mode}, light times 2^{exponent}");
                // Negative control: a last bit more.
                other.image.rgb[7][1] = f32::from_bits(other.image.rgb[7][1].to_bits() + 1);
                assert_eq!(unscaled(&plain, &other, factor), 1);
            }
        }
    }
}

/// Light of 2^-110 (1e-32), whose squares are 0 in f32 and whose estimates learnt roulette does not trust: nothing is lost, and
/// the mean is the scene's, within 4 standard errors of it (α = 6.3e-5).
#[test]
fn light_too_faint_to_learn_from_is_right_all_the_same() {
    let cornell = scene("cornell-box");
    for engine in CLASSES {
        let options = guided(16, 16, 9, GuideMode::Adaptive, Roulette::Learnt);
        let plain = channel(&render(&cornell, engine, &options, 62).image, 1);
        let faint = render(&relit(&cornell, 2f64.powi(-110)), engine, &options, 62).image;
        let mean = channel(&faint, 1).0 * 2f64.powi(110);
        println!("{engine:?}: {mean:.4} for {:.4} ± {:.4}", plain.0, plain.1);
        assert!((mean - plain.0).abs() < 4.0 * 2f64.sqrt() * plain.1, "{engine:?}: {mean} for {plain:?}");
    }
}

/// Mean of a channel over the image, and its standard error.
fn channel(image: &Image, c: usize) -> (f64, f64) {
    let n = image.rgb.len() as f64;
    let mean = image.rgb.iter().map(|rgb| f64::from(rgb[c])).sum::<f64>() / n;
    let errors = image.standard_error.as_ref().unwrap();
    (mean, errors.iter().map(|se| f64::from(se[c]).powi(2)).sum::<f64>().sqrt() / n)
}

/// Within 4 standard errors, α = 6.3e-5, of which each is below `precision` of what is expected; and a value that is off by
/// eight times that is not.
fn is_expected(what: &str, image: &Image, c: usize, expected: f64, precision: f64) {
    let (mean, error) = channel(image, c);
    println!("{what}, channel {c}: {:.1e} off, s.e. {:.1e}", mean / expected - 1.0, error / expected);
    assert!(error < precision * expected, "{what}, channel {c}: too few samples, {mean} ± {error}");
    let agrees = |mean: f64| (mean - expected).abs() < 4.0 * error + 2e-6 * expected;
    assert!(agrees(mean), "{what}, channel {c}: {mean} ± {error} for {expected}");
    assert!(!agrees(mean * (1.0 + 8.0 * precision)), "{what}, channel {c}: what is wrong passes");
}

/// A grey floor of albedo 1/2, seen through so small an angle that its middle fills the image, and what lights it.
fn floor(half: f64, lights: &[(DVec3, f64, bool, DVec3)]) -> Scene {
    let mut scene = Scene::builder("floor")
        .camera([half, half, 0.0], [0.0; 3], 1e-3)
        .material("floor", Material::diffuse([0.5; 3]))
        .quad([-half, 0.0, -half], [0.0, 0.0, 2.0 * half], [2.0 * half, 0.0, 0.0], "floor");
    for (i, &(center, radius, inward, emission)) in lights.iter().enumerate() {
        let name = format!("lamp {i}");
        scene = scene.material(&name, Material::diffuse([0.0; 3]).emitting(emission));
        scene = match inward {
            true => scene.inward_sphere(center, radius, &name),
            false => scene.sphere(center, radius, &name),
        };
    }
    scene.build().unwrap()
}

/// Share of the cosine-weighted hemisphere of a floor that a ball wholly above it covers: sin²θ of its cone times the
/// cosine to its centre.
fn ball_share(center: DVec3, radius: f64) -> f64 {
    radius * radius / center.length_squared() * center.y / center.length()
}

/// A red lamp 1e8 times as bright as a green one: direct light hardly ever chooses the green, and yet both are right.
#[test]
fn a_light_beside_one_that_is_a_hundred_million_times_as_strong_keeps_its_share() {
    let [red, green] = [DVec3::new(-1.0, 1.0, 1.0), DVec3::new(1.0, 1.0, -1.0)];
    let scene = floor(
        2.0,
        &[(red, 0.6, false, DVec3::new(1e8, 0.0, 0.0)), (green, 0.6, false, DVec3::new(0.0, 1.0, 0.0))],
    );
    for engine in CLASSES {
        let image = render(&scene, engine, &small(8, 8, 31), 1024).image;
        is_expected(&format!("{engine:?}"), &image, 0, 0.5e8 * ball_share(red, 0.6), 0.02);
        is_expected(&format!("{engine:?}"), &image, 1, 0.5 * ball_share(green, 0.6), 0.02);
    }
}

/// A red ball of a thousandth, a thousandth above the floor, alone and in a green sky that is a ball of 10,000: the one is
/// seen by cones, the other from inside, and the ball shades the sky.
#[test]
fn a_tiny_light_near_and_a_huge_one_around_are_the_closed_form() {
    let (ball, share) = (DVec3::new(0.0, 2e-3, 0.0), 0.25);
    assert!((ball_share(ball, 1e-3) - share).abs() < 1e-12);
    let tiny = (ball, 1e-3, false, DVec3::new(4.0, 0.0, 0.0));
    let huge = (DVec3::new(3e3, 0.0, -1e3), 1e4, true, DVec3::new(0.0, 1.0, 0.0));
    for engine in CLASSES {
        let alone = render(&floor(0.05, &[tiny]), engine, &small(8, 8, 32), 256).image;
        is_expected(&format!("alone on {engine:?}"), &alone, 0, 0.5 * 4.0 * share, 5e-3);
        let both = render(&floor(0.05, &[tiny, huge]), engine, &small(8, 8, 33), 1024).image;
        is_expected(&format!("both on {engine:?}"), &both, 0, 0.5 * 4.0 * share, 0.02);
        is_expected(&format!("both on {engine:?}"), &both, 1, 0.5 * (1.0 - share), 0.02);
    }
}

/// Every pixel of a furnace by itself, α = 1e-3 for all of an engine together (Šidák), and their mean within 4 standard
/// errors; and with samples that are all equal, where nothing hides it, what the sums drift. In f32 the sum of 32 equal samples is
/// off by up to 16 roundings, always the same way: 1e-6.
fn means_do_not_drift(spp: u32) {
    let expected = closed_form(0.5, 64);
    for engine in CLASSES {
        let options = unlit(Roulette::Throughput, small(4, 4, 41));
        let image = render(&scene("furnace-closed-50"), engine, &options, spp).image;
        let errors = image.standard_error.as_ref().unwrap();
        let z = |i: usize| (f64::from(image.rgb[i][1]) - expected) / f64::from(errors[i][1]);
        let worst = (0..16).map(|i| z(i).abs()).fold(0.0, f64::max);
        let limit = normal_two_sided_threshold(sidak(1e-3, 16));
        let (mean, error) = mean_and_relative_error(&image);
        let off = mean / expected - 1.0;
        println!(
            "{engine:?}, {spp} samples: worst pixel {worst:.2} s.e. of {limit:.2}; mean {off:.1e}, s.e. {error:.1e}"
        );
        assert!(worst < limit, "{engine:?}: a pixel is {worst} s.e. off");
        assert!(off.abs() < 4.0 * error, "{engine:?}: {off} off, s.e. {error}");

        let options = RenderOptions { max_bounces: Some(3), ..unlit(Roulette::Off, small(2, 2, 42)) };
        let image = render(&furnace_of(0.9), engine, &options, spp).image;
        let off = mean_and_relative_error(&image).0 / closed_form(0.9, 3) - 1.0;
        println!("{engine:?}, {spp} equal samples: {off:.1e} off");
        assert!(off.abs() < 1.2e-6, "{engine:?}: {off} off without noise");
    }
}

#[test]
fn ten_thousand_samples_drift_less_than_their_standard_error() {
    means_do_not_drift(10_000);
}

#[test]
#[ignore = "long: a million samples a pixel on three engines; tests/run --long"]
fn a_million_samples_drift_less_than_their_standard_error() {
    means_do_not_drift(1_000_000);
}
