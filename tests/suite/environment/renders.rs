//! Images under maps.

use super::{ball_under, direction_of, map_of, one_bright, under};
use crate::engines::mean_z;
use crate::failing_images::expect_agreement;
use crate::furnace::mean_and_relative_error;
use crate::guiding_renders::guided;
use crate::references::Against;
use crate::support::*;
use glam::DVec3;
use qtracer::gpu::key::KernelKey;
use qtracer::gpu::stage::Schedule;
use qtracer::guiding::GuideMode;
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::{EnvironmentMap, Material};
use qtracer::stats::{ZTestOptions, z_test};
use qtracer::transport::roulette::Roulette;
use qtracer::{Image, RenderOptions, Scene};
use std::f64::consts::PI;

fn options(direct_light: bool, seed: u32) -> RenderOptions {
    RenderOptions { direct_light: Some(direct_light), ..small(16, 16, seed) }
}

/// A ball that loses nothing before a uniform map: without direct light it is invisible to rounding, as before a constant
/// environment; with it, within 4 standard errors of the mean (α = 6.3e-5 each).
#[test]
fn a_uniform_map_is_a_constant_environment() {
    let scene = under(map_of(8, 4, |_, _| [1.0; 3])).sphere([0.0; 3], 1.0, "white").build().unwrap();
    for engine in ENGINES {
        let image = render(&scene, engine, &options(false, 61), 16).image;
        let worst = image.rgb.iter().flatten().map(|v| (v - 1.0).abs()).fold(0.0, f32::max);
        let flat = Image::new(16, 16, vec![[1.0; 3]; 256]);
        expect_agreement(worst < 1e-4, &format!("{engine:?}"), 61, (&image, &flat), worst);
        let (mean, error) = mean_and_relative_error(&render(&scene, engine, &options(true, 62), 64).image);
        assert!((mean - 1.0).abs() < 4.0 * error + 1e-5, "{engine:?}: {mean} ± {error}");
        assert!(error < 3e-3, "{engine:?}: a mean with an error of {error} tells nothing");
    }
}

/// A floor of albedo 0.5 seen from above, under a sky of cosθ: irradiance ∫ cos²θ dω = 2π/3, so it sends 1/3 up. The map's
/// 128 rows are off by 3e-5 of that.
#[test]
fn a_cosine_sky_lights_a_floor_as_calculated() {
    let sky = map_of(4, 128, |_, row| [(PI * (f64::from(row) + 0.5) / 128.0).cos().max(0.0) as f32; 3]);
    let scene = under(sky)
        .camera([0.0, 3.0, 0.0], [0.0; 3], 30.0)
        .up([0.0, 0.0, 1.0])
        .quad([-9.0, 0.0, -9.0], [0.0, 0.0, 18.0], [18.0, 0.0, 0.0], "grey")
        .build()
        .unwrap();
    for (seed, engine) in (70..).zip(ENGINES) {
        for direct_light in [true, false] {
            let image = render(&scene, engine, &options(direct_light, seed), 64).image;
            let (mean, error) = mean_and_relative_error(&image);
            let deviation = 3.0 * mean - 1.0;
            assert!(
                deviation.abs() < 4.0 * error + 1e-4,
                "{engine:?}, direct light {direct_light}: {mean} ± {error}"
            );
            assert!(error < 5e-3, "{engine:?}: an error of {error} tells nothing");
        }
    }
}

/// Light from one texel is on the side from which it comes, wherever that is: a ball shows the shading of that direction.
#[test]
fn a_bright_texel_lights_the_side_that_it_should() {
    for (column, row, turn) in [(2, 2, 0.0), (5, 3, 0.0), (7, 5, 0.0), (2, 2, 135.0), (0, 4, -50.0)] {
        let map = one_bright(16, 8, column, row).rotated(turn);
        let towards = direction_of(&map, column.into(), row.into());
        let scene = ball_under(map);
        for engine in [Engine::Cpu, Engine::Wavefront(Schedule::Fused)] {
            let image = render(&scene, engine, &options(true, 5), 16).image;
            // The ball's middle three fifths: normals of points seen from far in front, nearly.
            let lit = |x: f64, y: f64| {
                let at = |v: f64| (8.0 + v * 8.0 * 0.6) as usize;
                f64::from(image.rgb[at(-y) * 16 + at(x)][0])
            };
            let [right, left, up, down] = [lit(1.0, 0.0), lit(-1.0, 0.0), lit(0.0, 1.0), lit(0.0, -1.0)];
            let what =
                format!("{engine:?}, {towards}: right {right:.0} left {left:.0} up {up:.0} down {down:.0}");
            assert!(towards.x.abs() < 0.3 || (right > left) == (towards.x > 0.0), "{what}");
            assert!(towards.y.abs() < 0.3 || (up > down) == (towards.y > 0.0), "{what}");
            assert!(towards.z < -0.6 || right.max(left).max(up).max(down) > 100.0, "{what}");
        }
    }
}

/// A sun of 0.15 sr in the dark at 16 samples: direct light finds it at nearly every sample, chance at one in forty.
#[test]
fn direct_light_finds_a_bright_texel() {
    let scene = ball_under(one_bright(32, 16, 9, 4));
    let errors = [true, false].map(|on| {
        let found = render(&scene, Engine::Cpu, &options(on, 6), 64).image;
        mean_and_relative_error(&found).1.powi(2)
    });
    println!(
        "squared relative errors of the mean: {:.2e} with direct light, {:.2e} without",
        errors[0], errors[1]
    );
    assert!(errors[0] < 1e-4 && errors[1] > 20.0 * errors[0], "{errors:?}");
}

/// A room of all the program's estimators: sun, lamp, glass.
fn mixed() -> Scene {
    under(map_of(24, 12, |c, r| if (c, r) == (7, 3) { [300.0, 200.0, 100.0] } else { [0.2, 0.4, 1.0] }))
        .camera([0.0, 1.5, 5.0], [0.0, 0.4, 0.0], 40.0)
        .material("lamp", Material::diffuse([0.1; 3]).emitting([4.0, 8.0, 4.0]))
        .material("glossy", Material::glossy([0.8; 3], 40.0))
        .material("mirror", Material::mirror([0.9; 3], 0.5))
        .quad([-5.0, 0.0, 5.0], [10.0, 0.0, 0.0], [0.0, 0.0, -10.0], "grey")
        .sphere([-1.0, 0.5, 0.0], 0.5, "glossy")
        .sphere([1.0, 0.5, 0.0], 0.5, "mirror")
        .sphere([0.0, 0.3, 0.8], 0.3, "grey")
        .quad([-0.4, 1.5, -0.5], [0.8, 0.0, 0.0], [0.0, 0.0, 0.8], "lamp")
        .build()
        .unwrap()
}

/// The map and the lamp share direct light: with it and without, the image is the same (α = 6.3e-5 for the means of the
/// channels, 1e-3 for the blocks).
#[test]
fn with_and_without_direct_light_the_image_is_the_same() {
    let scene = mixed();
    let share = CompiledScene::new(&scene).sky.unwrap().share;
    assert!((0.25..=0.75).contains(&share), "{share}");
    let by_chance = render(&scene, Engine::Cpu, &options(false, 81), 8192).image;
    for (seed, engine) in (82..).zip(ENGINES) {
        let lit = render(&scene, engine, &options(true, seed), 512).image;
        assert!(
            mean_z(&lit, &by_chance) < 4.0,
            "{engine:?}: means differ by {} s.e.",
            mean_z(&lit, &by_chance)
        );
        let z = ZTestOptions { alpha: 1e-3, ..Default::default() };
        let report = z_test(&lit.view(), &by_chance.view(), &z).unwrap();
        expect_agreement(report.passes, &format!("{engine:?}"), seed, (&lit, &by_chance), &report);
        // Negative control: a twentieth more light.
        let control = mean_z(&brightened(&lit, 1.05), &by_chance);
        assert!(control > 5.0, "{engine:?}: brighter by a twentieth, means differ by {control} s.e. only");
    }
}

/// Guides learn from the map what they learn from lamps, on every engine alike, and the image stays the same.
#[test]
fn guides_learn_under_maps() {
    let scene = mixed();
    let plain = render(&scene, Engine::Cpu, &options(true, 91), 512).image;
    let exact = open_gpu().summary.software;
    for (mode, roulette) in
        [(GuideMode::Adaptive, Roulette::Learnt), (GuideMode::Octant, Roulette::Throughput)]
    {
        let options = RenderOptions { direct_light: Some(true), ..guided(16, 16, 92, mode, roulette) };
        let reference = render(&scene, Engine::Megakernel, &options, 126);
        for schedule in SCHEDULES {
            let other = render(&scene, Engine::Wavefront(schedule), &options, 126);
            let differing = differing_pixels(&reference.film, &other.film);
            assert!(!exact || differing == 0, "{mode}, {schedule:?}: {differing} pixels differ");
        }
        let cpu = render(&scene, Engine::Cpu, &options, 126).image;
        for image in [&reference.image, &cpu] {
            assert!(mean_z(image, &plain) < 4.0, "{mode}: means differ by {} s.e.", mean_z(image, &plain));
        }
    }
}

/// A black map is no light at all, and costs nothing.
#[test]
fn a_black_map_is_dark_and_absent() {
    let scene = ball_under(map_of(4, 2, |_, _| [0.0; 3]));
    assert!(scene.warnings().iter().any(|warning| warning.to_string().contains("black")));
    let key = KernelKey::new(&CompiledScene::new(&scene), &options(true, 1).estimators(&scene));
    assert!(!key.environment && !key.environment_map && !key.direct_light);
    for engine in ENGINES {
        let image = render(&scene, engine, &options(true, 1), 4).image;
        assert!(image.rgb.iter().flatten().all(|&v| v == 0.0), "{engine:?}");
    }
}

/// Camera rays show the map as it is, seam and poles included.
#[test]
fn rays_of_the_camera_show_the_map() {
    let map = map_of(12, 6, |c, r| [(c * 7 % 5) as f32, r as f32, ((c + r) * 3 % 4) as f32]);
    for target in [DVec3::NEG_Z, DVec3::new(0.02, 1.0, 0.0), DVec3::new(0.3, -1.0, 0.2)] {
        let scene = Scene::builder("sky only")
            .camera([0.0; 3], target, 60.0)
            .environment_map(map.clone())
            .environment([1.0, 2.0, 0.5])
            .build()
            .unwrap();
        let cpu = render(&scene, Engine::Cpu, &options(true, 9), 64).image;
        let shown = cpu.rgb[8 * 16 + 8];
        let expected = super::radiance_of(&map, target.normalize()) * DVec3::new(1.0, 2.0, 0.5);
        let off = (DVec3::from_array(shown.map(f64::from)) - expected).abs().max_element();
        assert!(off < 0.7, "{target}: {shown:?} for {expected}");
        for engine in GPU_ENGINES {
            let gpu = render(&scene, engine, &options(true, 9), 64).image;
            let worst = gpu
                .rgb
                .iter()
                .flatten()
                .zip(cpu.rgb.iter().flatten())
                .map(|(g, c)| (g - c).abs())
                .fold(0.0, f32::max);
            assert!(worst < 1e-4, "{engine:?}: {worst}");
        }
    }
}

/// Converged by Mitsuba 3 with its own envmap, which interpolates and samples by code of its own. Light that glass gathers from
/// the sun is found by chance, so noise has a long tail.
#[test]
fn open_sky_agrees_with_mitsuba() {
    Against::plain("open-sky", "sky", 4096, 30).agrees(0.02);
    let engine = Engine::Wavefront(Schedule::Fused);
    Against { engine, ..Against::plain("open-sky", "sky", 1024, 31) }.agrees(0.05);
}

#[test]
#[ignore = "long: open-sky on every GPU engine; tests/run --long"]
fn open_sky_agrees_with_mitsuba_on_every_engine() {
    for (seed, engine) in (32..).zip(GPU_ENGINES) {
        Against { engine, ..Against::plain("open-sky", "sky", 8192, seed) }.agrees(0.02);
    }
}

/// What the picture is depends on the map, its turn and its tint.
#[test]
fn fingerprints_tell_maps_apart() {
    let of = |map: EnvironmentMap, tint: f64| {
        let scene = under(map).environment([tint; 3]).sphere([0.0; 3], 1.0, "grey").build().unwrap();
        let compiled = CompiledScene::new(&scene);
        (compiled.fingerprint(&compiled.uniforms(&scene.camera, 8, 8, 1)), compiled.light_fingerprint())
    };
    let base = of(one_bright(8, 4, 1, 1), 1.0);
    assert_eq!(base, of(one_bright(8, 4, 1, 1), 1.0));
    for other in [
        of(one_bright(8, 4, 2, 1), 1.0),
        of(one_bright(8, 4, 1, 1).rotated(1.0), 1.0),
        of(one_bright(8, 4, 1, 1), 0.5),
    ] {
        assert!(other.0 != base.0 && other.1 != base.1);
    }
}
