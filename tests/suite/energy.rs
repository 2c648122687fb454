//! Energy: light of 1 from everywhere, so that whatever reflects no more than it receives is nowhere brighter than 1, and what
//! loses nothing is exactly as bright.

use crate::support::*;
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};
use qtracer::gpu::stage::Schedule;
use qtracer::scene::Material;
use qtracer::stats::{normal_two_sided_threshold, sidak};
use qtracer::{Image, RenderOptions, Scene};

const KINDS: [&str; 4] = ["diffuse", "mirror", "glossy", "dielectric"];

/// A material of that kind: `parameter`, from 0 to 1, covers mirrors of all levels, Phong exponents from 0 to 1e6, glass of
/// index 1 to 4.
fn material(kind: &str, color: [f64; 3], parameter: f64) -> Material {
    match kind {
        "diffuse" => Material::diffuse(color),
        "mirror" => Material::mirror(color, parameter),
        "glossy" => Material::glossy(color, (1e6 + 1.0f64).powf(parameter) - 1.0),
        _ => Material::dielectric(color, 1.0 + 3.0 * parameter),
    }
}

/// Two balls, close enough to see each other, in light of 1: of the environment, which is met by chance, or of a ball
/// around all, which is sampled too.
fn balls(material: Material, lamp: bool) -> Scene {
    let scene = Scene::builder("white furnace")
        .camera([0.0, 0.5, 4.0], [0.0; 3], 45.0)
        .material("ball", material)
        .sphere([-0.8, 0.0, 0.0], 0.75, "ball")
        .sphere([0.8, 0.0, -0.3], 0.8, "ball");
    let scene = match lamp {
        true => scene
            .material("lamp", Material::diffuse([0.0; 3]).emitting([1.0; 3]))
            .inward_sphere([0.0; 3], 20.0, "lamp"),
        false => scene.environment([1.0; 3]),
    };
    scene.build().unwrap()
}

/// Rounding of up to 64 products, and of pixels without noise.
const ROUNDING: f64 = 1e-4;

/// What is wrong with the image, if anything. The second channel loses nothing, the others may: their mean is at most 1 and
/// 4 standard errors (α = 3.2e-5), each pixel at most 1 and as many as the brightest of all may be off by (α = 1e-3, Šidák).
fn energy_fault(image: &Image) -> Option<String> {
    let n = image.rgb.len() as f64;
    let errors = image.standard_error.as_ref().unwrap();
    let limit = normal_two_sided_threshold(2.0 * sidak(1e-3, 3 * image.rgb.len()));
    for c in 0..3 {
        let mean = image.rgb.iter().map(|rgb| f64::from(rgb[c])).sum::<f64>() / n;
        let error = errors.iter().map(|se| f64::from(se[c]).powi(2)).sum::<f64>().sqrt() / n;
        let excess = mean - 1.0;
        let bad = if c == 1 { excess.abs() } else { excess };
        if bad > 4.0 * error + ROUNDING {
            return Some(format!("channel {c} has a mean of {mean} ± {error}"));
        }
        for (i, (rgb, se)) in image.rgb.iter().zip(errors).enumerate() {
            if f64::from(rgb[c]) - 1.0 > limit * f64::from(se[c]) + ROUNDING {
                return Some(format!("pixel {i}, channel {c}: {} ± {}", rgb[c], se[c]));
            }
        }
    }
    None
}

fn options(seed: u32) -> RenderOptions {
    RenderOptions { direct_light: Some(true), ..small(12, 12, seed) }
}

fn no_material_makes_light(cases: u32, spp: u32, engines: &[Engine]) {
    let config = ProptestConfig { cases, failure_persistence: None, ..Default::default() };
    let rng = TestRng::from_seed(RngAlgorithm::ChaCha, &[29; 32]);
    let albedo = prop_oneof![Just(1.0), Just(0.0), 0.0..1.0f64];
    let parameter = prop_oneof![Just(0.0), Just(1.0), 0.0..1.0f64];
    let inputs = (0..KINDS.len(), [albedo.clone(), albedo], parameter, any::<bool>(), 0..engines.len());
    TestRunner::new_with_rng(config, rng)
        .run(&inputs, |(kind, [red, blue], parameter, lamp, engine)| {
            let scene = balls(material(KINDS[kind], [red, 1.0, blue], parameter), lamp);
            for engine in [Engine::Cpu, engines[engine]] {
                let fault = energy_fault(&render(&scene, engine, &options(51), spp).image);
                prop_assert!(fault.is_none(), "{} on {engine:?}, seed 51: {}", KINDS[kind], fault.unwrap());
            }
            Ok(())
        })
        .unwrap();
}

#[test]
fn no_material_makes_light_of_albedo_at_most_one() {
    no_material_makes_light(24, 128, &[Engine::Megakernel, Engine::Wavefront(Schedule::Fused)]);
}

#[test]
#[ignore = "long: 200 materials at 2048 samples; tests/run --long"]
fn no_material_of_hundreds_makes_light() {
    no_material_makes_light(200, 2048, &GPU_ENGINES);
}

/// Negative control: two hundredths more are found, whatever the kind, and two less where nothing should be lost.
#[test]
fn a_material_that_gains_or_loses_two_hundredths_is_found() {
    for kind in KINDS {
        for lamp in [false, true] {
            for albedo in [1.02, 0.98] {
                let scene = balls(material(kind, [albedo; 3], 0.4), lamp);
                let image = render(&scene, Engine::Cpu, &options(52), 1024).image;
                assert!(energy_fault(&image).is_some(), "{kind} of albedo {albedo} passes, lamp {lamp}");
            }
        }
    }
}
