//! Energy: light of 1 from everywhere, so that whatever reflects no more than it receives is nowhere brighter than 1, and what
//! loses nothing is exactly as bright.

use crate::support::*;
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};
use qtracer::gpu::stage::Schedule;
use qtracer::scene::Material;
use qtracer::stats::{normal_two_sided_threshold, sidak};
use qtracer::{Image, RenderOptions, Scene};

/// Kinds that lose nothing …
const KEEPING: [&str; 4] = ["diffuse", "mirror", "glossy", "dielectric"];
/// … and those that do where they are rough, since light scatters once.
const ROUGH: [&str; 3] = ["metal", "metallic-roughness", "rough-dielectric"];

/// A material of that kind: `parameter`, from 0 to 1, covers mirrors of all levels, Phong exponents from 0 to 1e6, glass of
/// index 1 to 4, roughness from 0 to 1.
fn material(kind: &str, color: [f64; 3], parameter: f64) -> Material {
    match kind {
        "diffuse" => Material::diffuse(color),
        "mirror" => Material::mirror(color, parameter),
        "glossy" => Material::glossy(color, (1e6 + 1.0f64).powf(parameter) - 1.0),
        "dielectric" => Material::dielectric(color, 1.0 + 3.0 * parameter),
        "metal" => Material::metal(color, parameter),
        "metallic-roughness" => Material::metallic_roughness(color, 1.0 - parameter, parameter),
        _ => Material::rough_dielectric(color, 1.5, parameter),
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

/// What is wrong with the image, if anything. The second channel loses nothing if it `keeps` all, the others may: their mean is at most 1 and
/// 4 standard errors (α = 3.2e-5), each pixel at most 1 and as many as the brightest of all may be off by (α = 1e-3, Šidák).
fn energy_fault(image: &Image, keeps: bool) -> Option<String> {
    let n = image.rgb.len() as f64;
    let errors = image.standard_error.as_ref().unwrap();
    let limit = normal_two_sided_threshold(2.0 * sidak(1e-3, 3 * image.rgb.len()));
    for c in 0..3 {
        let mean = image.rgb.iter().map(|rgb| f64::from(rgb[c])).sum::<f64>() / n;
        let error = errors.iter().map(|se| f64::from(se[c]).powi(2)).sum::<f64>().sqrt() / n;
        let excess = mean - 1.0;
        let bad = if c == 1 && keeps { excess.abs() } else { excess };
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
    let kinds = [&KEEPING[..], &ROUGH].concat();
    let inputs = (0..kinds.len(), [albedo.clone(), albedo], parameter, any::<bool>(), 0..engines.len());
    TestRunner::new_with_rng(config, rng)
        .run(&inputs, |(kind, [red, blue], parameter, lamp, engine)| {
            let scene = balls(material(kinds[kind], [red, 1.0, blue], parameter), lamp);
            for engine in [Engine::Cpu, engines[engine]] {
                let image = render(&scene, engine, &options(51), spp).image;
                let fault = energy_fault(&image, kind < KEEPING.len());
                prop_assert!(fault.is_none(), "{} on {engine:?}, seed 51: {}", kinds[kind], fault.unwrap());
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
    for kind in KEEPING {
        for lamp in [false, true] {
            for albedo in [1.02, 0.98] {
                let scene = balls(material(kind, [albedo; 3], 0.4), lamp);
                let image = render(&scene, Engine::Cpu, &options(52), 1024).image;
                assert!(
                    energy_fault(&image, true).is_some(),
                    "{kind} of albedo {albedo} passes, lamp {lamp}"
                );
            }
        }
    }
}

/// … and two hundredths more where what is smooth enough loses next to nothing.
#[test]
fn a_rough_material_that_gains_is_found() {
    for kind in ROUGH {
        for lamp in [false, true] {
            let image = |albedo: f64| {
                let scene = balls(material(kind, [albedo; 3], 0.1), lamp);
                render(&scene, Engine::Cpu, &options(53), 512).image
            };
            assert!(energy_fault(&image(1.0), false).is_none(), "{kind}, lamp {lamp}");
            assert!(energy_fault(&image(1.06), false).is_some(), "{kind} passes, lamp {lamp}");
        }
    }
}

/// Light of 1 from everywhere is as bright whether it is met by chance or sampled as well: both strategies weigh rough
/// materials alike, and through glass from either side. Means of the whole image, within 4 standard errors, α = 6.3e-5 each.
#[test]
fn rough_materials_reflect_a_lamp_as_they_do_the_sky() {
    let mean = |image: &Image| {
        let n = image.rgb.len() as f64;
        let errors = image.standard_error.as_ref().unwrap();
        let error = errors.iter().map(|se| f64::from(se[1]).powi(2)).sum::<f64>().sqrt() / n;
        (image.rgb.iter().map(|rgb| f64::from(rgb[1])).sum::<f64>() / n, error)
    };
    for (kind, parameter) in ROUGH.into_iter().flat_map(|kind| [0.1, 0.5, 1.0].map(|p| (kind, p))) {
        let of = |lamp: bool, engine: Engine, seed: u32| {
            let scene = balls(material(kind, [0.9; 3], parameter), lamp);
            mean(&render(&scene, engine, &options(seed), 512).image)
        };
        let (sky, sky_error) = of(false, Engine::Cpu, 54);
        for engine in [Engine::Cpu, Engine::Wavefront(Schedule::Streamed)] {
            let (lamp, error) = of(true, engine, 55);
            let bound = 4.0 * error.hypot(sky_error) + ROUNDING;
            let what = format!("{kind} {parameter} on {engine:?}: {lamp} of a lamp, {sky} of the sky");
            assert!((lamp - sky).abs() < bound, "{what}, ± {bound}");
            // Enough samples to see a hundredth.
            assert!(bound < 0.01, "{what}, ± {bound}");
        }
    }
}

/// A coat shines on a black base too, and metal that is black head on is white where light grazes; a lamp of black diffuse does
/// not.
#[test]
fn black_coats_shine() {
    let black = |material: Material, engine: Engine| {
        let image = render(&balls(material, false), engine, &options(56), 64).image;
        // The middle of the left ball, from which a coat sends back 4 % and more.
        f64::from(image.rgb[12 * 6 + 3][1])
    };
    for engine in [Engine::Cpu, Engine::Megakernel] {
        let coat = black(Material::metallic_roughness([0.0; 3], 0.0, 0.3), engine);
        assert!((0.03..0.3).contains(&coat), "{engine:?}: {coat}");
        let metal = black(Material::metal([0.0; 3], 0.3), engine);
        assert!(metal > 1e-6 && metal < coat, "{engine:?}: {metal}");
        assert_eq!(black(Material::diffuse([0.0; 3]), engine), 0.0);
    }
}
