//! Furnaces: scenes whose radiance is known in closed form, so that every factor of the estimator is weighed.

use crate::failing_images::expect_agreement;
use crate::support::*;
use qtracer::scene::Material;
use qtracer::transport::roulette::Roulette;
use qtracer::{Image, RenderOptions, Scene};

/// Radiance inside a sphere that emits 1 and has albedo ρ, from paths of at most k levels.
pub fn closed_form(albedo: f64, levels: i32) -> f64 {
    (1.0 - albedo.powi(levels)) / (1.0 - albedo)
}

/// The closed furnaces and their albedos.
const CLOSED: [(&str, f64); 3] =
    [("furnace-closed-50", 0.5), ("furnace-closed-90", 0.9), ("furnace-closed-99", 0.99)];

/// Mean over all pixels and channels, and its standard error relative to it. The channels share their samples, so the
/// error is a channel's.
pub fn mean_and_relative_error(image: &Image) -> (f64, f64) {
    let n = image.rgb.len() as f64;
    let mean = image.rgb.iter().flatten().map(|&v| f64::from(v)).sum::<f64>() / (3.0 * n);
    let errors = image.standard_error.as_ref().unwrap();
    let variance: f64 = errors.iter().map(|se| f64::from(se[1]).powi(2)).sum();
    (mean, variance.sqrt() / n / mean)
}

fn options(direct_light: bool, roulette: bool) -> RenderOptions {
    let roulette = Some(if roulette { Roulette::Throughput } else { Roulette::Off });
    RenderOptions { direct_light: Some(direct_light), roulette, ..small(16, 16, 77) }
}

/// Every path meets the wall at every level, so without direct light and roulette all samples are equal: no noise but
/// that of f32 sums of squares, and the bound of 1e-3 is left to rounding, which takes 1e-5 of it.
#[test]
fn closed_furnaces_have_their_radiance_on_every_engine() {
    for (name, albedo) in CLOSED {
        for engine in ENGINES {
            let image = render(&scene(name), engine, &options(false, false), 4).image;
            let (mean, error) = mean_and_relative_error(&image);
            let expected = closed_form(albedo, 64);
            assert!(error < 2e-5, "{name} on {engine:?} is noisy: {error}");
            assert!((mean / expected - 1.0).abs() < 1e-5, "{name} on {engine:?}: {mean} for {expected}");
        }
    }
}

/// Direct light against chance hits: the weights of both strategies add up to one at every level. 131,072 paths take the
/// standard error below 2.5e-4, a quarter of the bound of 1e-3; α = 6.3e-5 at most.
#[test]
fn closed_furnaces_have_their_radiance_with_direct_light_on_every_engine() {
    for (name, albedo) in CLOSED {
        for engine in ENGINES {
            let image = render(&scene(name), engine, &options(true, false), 512).image;
            let (mean, error) = mean_and_relative_error(&image);
            let expected = closed_form(albedo, 64);
            assert!(error < 2.5e-4, "{name} on {engine:?}: too few samples, s.e. {error}");
            assert!((mean / expected - 1.0).abs() < 1e-3, "{name} on {engine:?}: {mean} for {expected}");
        }
    }
}

/// Roulette spreads the lengths of paths, so it takes more samples than direct light: within 4 standard errors of the
/// closed form, α = 6.3e-5 each, and these below `error_bound`, relatively.
fn closed_furnaces_keep_their_radiance_under_roulette(engine: Engine, spp: u32, error_bound: f64) {
    for (name, albedo) in CLOSED {
        for direct_light in [false, true] {
            let image = render(&scene(name), engine, &options(direct_light, true), spp).image;
            let (mean, error) = mean_and_relative_error(&image);
            let deviation = mean / closed_form(albedo, 64) - 1.0;
            println!("{name} {engine:?}, direct light {direct_light}: {deviation:.1e} off, s.e. {error:.1e}");
            assert!(error < error_bound, "{name} on {engine:?}: too few samples, s.e. {error}");
            assert!(deviation.abs() < 4.0 * error, "{name} on {engine:?}: {deviation} off, s.e. {error}");
        }
    }
}

#[test]
fn closed_furnaces_have_their_radiance_under_roulette() {
    closed_furnaces_keep_their_radiance_under_roulette(Engine::Cpu, 1536, 1.5e-3);
    for engine in GPU_ENGINES {
        closed_furnaces_keep_their_radiance_under_roulette(engine, 128, 6e-3);
    }
}

/// 16.8 million paths: 4 standard errors are 1e-3.
#[test]
#[ignore = "long: 100 million paths on the CPU; tests/run --long"]
fn closed_furnaces_have_their_radiance_within_a_thousandth_under_roulette() {
    closed_furnaces_keep_their_radiance_under_roulette(Engine::Cpu, 1 << 16, 2.5e-4);
}

/// k levels give k terms of the series: 1 shows the wall alone, 2 adds what it reflects once.
#[test]
fn a_furnace_of_k_levels_has_k_terms() {
    for engine in ENGINES {
        for levels in [1, 2, 5] {
            let limited = RenderOptions { max_bounces: Some(levels), ..options(false, false) };
            let image = render(&scene("furnace-closed-90"), engine, &limited, 4).image;
            let expected = closed_form(0.9, levels as i32);
            let (mean, _) = mean_and_relative_error(&image);
            assert!(
                (mean / expected - 1.0).abs() < 1e-5,
                "{engine:?}, {levels} levels: {mean} for {expected}"
            );

            let lit = RenderOptions { direct_light: Some(true), ..limited };
            let (mean, error) =
                mean_and_relative_error(&render(&scene("furnace-closed-90"), engine, &lit, 128).image);
            let deviation = mean / expected - 1.0;
            assert!(deviation.abs() < 4.0 * error + 1e-5, "{engine:?}, {levels} levels, lit: {deviation}");
        }
    }
}

/// A ball of this material before a unit environment, filling most of the image.
fn open_furnace(material: Material) -> Scene {
    Scene::builder("open furnace")
        .camera([0.0, 0.0, 3.0], [0.0; 3], 45.0)
        .environment([1.0; 3])
        .material("ball", material)
        .sphere([0.0; 3], 1.0, "ball")
        .build()
        .unwrap()
}

/// Largest deviation of a pixel from `expected`.
fn worst(image: &Image, expected: f32) -> f32 {
    image.rgb.iter().flatten().map(|v| (v - expected).abs()).fold(0.0, f32::max)
}

/// Every material that conserves energy is invisible before a uniform environment. A path off a single ball carries
/// weight 1 whatever it does, so there is no noise: the bound is rounding of up to 64 products.
#[test]
fn a_ball_that_loses_nothing_is_invisible_before_its_background() {
    let materials = [
        Material::diffuse([1.0; 3]),
        Material::mirror([1.0; 3], 0.3),
        Material::mirror([1.0; 3], 1.0),
        Material::glossy([1.0; 3], 20.0),
        Material::glossy([1.0; 3], 0.0),
        Material::dielectric([1.0; 3], 1.5),
        Material::dielectric([1.0; 3], 1.0),
        Material::rough_dielectric([1.0; 3], 1.0, 0.7),
    ];
    for material in materials {
        let scene = open_furnace(material.clone());
        for engine in ENGINES {
            for roulette in [false, true] {
                let image = render(&scene, engine, &options(true, roulette), 16).image;
                let what = format!("{:?} on {engine:?}, roulette {roulette}", material.kind);
                let (flat, off) = (Image::new(16, 16, vec![[1.0; 3]; 256]), worst(&image, 1.0));
                expect_agreement(off < 1e-4, &what, 77, (&image, &flat), off);
            }
        }
    }
    // Negative control: a thousandth less is seen.
    let image =
        render(&open_furnace(Material::diffuse([0.999; 3])), Engine::Cpu, &options(true, false), 16).image;
    assert!(worst(&image, 1.0) > 5e-4);
}

/// Half on the ball, all around it: pixels that the ball covers wholly, and those that it does not touch.
#[test]
fn a_ball_of_albedo_one_half_reflects_one_half() {
    for engine in ENGINES {
        let image =
            render(&open_furnace(Material::diffuse([0.5; 3])), engine, &options(true, false), 16).image;
        // The ball's rim lies at tan(asin(1/3)) = 0.354 of a half-height of tan(22.5°) = 0.414, in units of 8 pixels.
        let rim = (1.0f32 / 3.0).asin().tan() / 22.5f32.to_radians().tan() * 8.0;
        let mut counts = [0; 2];
        for (i, rgb) in image.rgb.iter().enumerate() {
            let (x, y) = ((i % 16) as f32 - 7.5, (i / 16) as f32 - 7.5);
            let radius = (x * x + y * y).sqrt();
            let expected = if radius < rim - 0.75 { 0.5 } else { 1.0 };
            if (radius - rim).abs() > 0.75 {
                assert!(rgb.iter().all(|v| (v - expected).abs() < 1e-5), "{engine:?} at ({x}, {y}): {rgb:?}");
                counts[usize::from(expected == 0.5)] += 1;
            }
        }
        assert!(counts[0] > 40 && counts[1] > 90, "{counts:?}");
    }
}
