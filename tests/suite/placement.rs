//! The same scene elsewhere and at another size looks the same.

use crate::engines::mean_z;
use crate::support::*;
use glam::DVec3;
use qtracer::scene::Geometry;
use qtracer::stats::{ZTestOptions, differences, z_test};
use qtracer::{Image, RenderOptions, Scene};

/// The scene and its camera, `scale` times as large and then moved by `shift`.
fn placed(scene: &Scene, scale: f64, shift: DVec3) -> Scene {
    let mut placed = scene.clone();
    let point = |p: DVec3| p * scale + shift;
    placed.camera.origin = point(placed.camera.origin);
    placed.camera.target = point(placed.camera.target);
    for shape in &mut placed.shapes {
        shape.geometry = match shape.geometry {
            Geometry::Mesh(_) | Geometry::Instance(_) => unreachable!("none of the scenes has one"),
            Geometry::Sphere { center, radius, inward } => {
                Geometry::Sphere { center: point(center), radius: radius * scale, inward }
            }
            Geometry::Quad { corner, e1, e2 } => {
                Geometry::Quad { corner: point(corner), e1: e1 * scale, e2: e2 * scale }
            }
        };
    }
    placed.validate().unwrap();
    placed
}

const SCENES: [&str; 3] = ["cornell-box", "bansal-room-1", "glass-caustic"];
const SOMEWHERE: DVec3 = DVec3::new(0.6, -0.7, 1.0);

fn thumbnail(seed: u32) -> RenderOptions {
    small(32, 24, seed)
}

/// Powers of two change exponents and no digit: the same image to the bit, on every engine.
#[test]
fn scenes_a_thousand_and_twenty_four_times_as_large_render_the_same_bits() {
    for name in SCENES {
        let scene = scene(name);
        for engine in ENGINES {
            let films = [1.0, 1024.0, 1.0 / 1024.0]
                .map(|scale| render(&placed(&scene, scale, DVec3::ZERO), engine, &thumbnail(51), 16).film);
            for film in &films[1..] {
                assert_eq!(differing_pixels(&films[0], film), 0, "{name} on {engine:?}, seed 51");
            }
        }
        // Negative control: a scale that is no power of two.
        let films = [1.0, 1000.0]
            .map(|scale| render(&placed(&scene, scale, DVec3::ZERO), Engine::Cpu, &thumbnail(51), 16).film);
        assert!(differing_pixels(&films[0], &films[1]) > 100);
    }
}

/// Whether noise explains every difference, α = 1e-3: by blocks, and by the largest deviation of a mean in standard errors.
fn same(a: &Image, b: &Image) -> (bool, f64) {
    let options = ZTestOptions { alpha: 1e-3, ..Default::default() };
    (z_test(&a.view(), &b.view(), &options).unwrap().passes, mean_z(a, b))
}

/// A scene, and whether blocks of its image are judged: light through glass is so rare that a
/// thumbnail's errors are not what they say, only its means are.
const PLACED: [(&str, bool); 4] =
    [("cornell-box", true), ("bansal-room-1", true), ("glossy-box", true), ("glass-caustic", false)];

/// Whether the placed scene renders the image of the scene where it was, at another seed.
fn renders_alike(name: &str, blocks: bool, engine: Engine, (scale, shift): (f64, f64), seed: u32) -> bool {
    let here = scene(name);
    let there = placed(&here, scale, SOMEWHERE * shift);
    let [a, b] =
        [(&here, 52), (&there, seed)].map(|(s, seed)| render(s, engine, &thumbnail(seed), 256).image);
    let (passes, means) = same(&a, &b);
    println!("{name} {engine:?} scale {scale} shift {shift}, seed {seed}: {passes} {means:.2}");
    (passes || !blocks) && means < 4.0
}

/// A thousandth as large, a thousand times as large, ten thousand units away. α = 1e-3 each for blocks, 6.3e-5 for means.
#[test]
fn scenes_elsewhere_and_of_another_size_render_the_same_image() {
    let places = [(1e-3, 0.0), (1e3, 0.0), (1.0, 1e4)];
    for (name, blocks) in PLACED {
        for engine in [Engine::Cpu, Engine::Megakernel] {
            for (place, seed) in places.into_iter().zip(53..) {
                assert!(renders_alike(name, blocks, engine, place, seed), "{name} {engine:?} {place:?}");
            }
        }
    }
    // Negative control, and where it ends: rooms ten units wide a million units away, where rays start a unit off.
    for (name, seed) in [("bansal-room-1", 57), ("glass-caustic", 58)] {
        assert!(!renders_alike(name, true, Engine::Cpu, (1.0, 1e6), seed));
    }
}

/// Another size alone changes the digits of every number and hardly a path: the share of pixels within a thousandth is that
/// which CPU and GPU have in common.
#[test]
fn scenes_of_another_size_trace_the_same_paths() {
    let close = |name: &str, scale: f64, shift: f64| {
        let here = scene(name);
        let there = placed(&here, scale, SOMEWHERE * shift);
        let [a, b] = [&here, &there].map(|s| render(s, Engine::Cpu, &thumbnail(59), 16).image);
        let share = differences(&a.view(), &b.view()).unwrap().share_within_1e3;
        println!("{name} scale {scale} shift {shift}: {:.2} % of pixels within 1e-3", 100.0 * share);
        share
    };
    for (name, claimed) in [("cornell-box", 0.995), ("bansal-room-1", 0.9), ("glass-caustic", 0.995)] {
        for scale in [1e3, 1e-3] {
            let share = close(name, scale, 0.0);
            assert!(share >= claimed, "{name} times {scale}: {share}, seed 59");
        }
        close(name, 1.0, 1e4);
    }
    // Negative control, and what moving costs: positions have fewer digits, so paths part ways.
    assert!(close("bansal-room-1", 1.0, 1e5) < 0.2);
}
