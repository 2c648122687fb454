//! Rooms whose walls are huge spheres, as in P. Bansal's scenes: nothing leaks in from outside, and nothing of the light
//! inside is lost.

use crate::furnace::mean_and_relative_error;
use crate::support::*;
use qtracer::scene::Material;
use qtracer::transport::roulette::Roulette;
use qtracer::{Image, RenderOptions, Scene};

/// Where the walls are: the room reaches from here to there on each axis.
const ROOM: [[f64; 2]; 3] = [[-9.0, 9.0], [-6.0, 10.0], [-12.0, 16.0]];

/// The first `walls` of six spheres of this radius around the room.
fn room(radius: f64, walls: usize, wall: Material, environment: f64) -> Scene {
    let builder = Scene::builder("room of spheres")
        .camera([0.0, -3.0, 15.0], [0.0, -0.45, 0.0], 75.0)
        .environment([environment; 3])
        .material("wall", wall);
    let sides = (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]).take(walls);
    let add = |builder: qtracer::scene::SceneBuilder, (axis, side): (usize, usize)| {
        let mut center = [0.0; 3];
        center[axis] = ROOM[axis][side] + radius * [-1.0, 1.0][side];
        builder.sphere(center, radius, "wall")
    };
    sides.fold(builder, add).build().unwrap()
}

fn options(max_bounces: u32) -> RenderOptions {
    RenderOptions {
        direct_light: Some(false),
        roulette: Some(Roulette::Off),
        max_bounces: Some(max_bounces),
        ..small(24, 18, 41)
    }
}

fn lit_pixels(image: &Image) -> usize {
    image.rgb.iter().filter(|rgb| rgb.iter().any(|&v| v != 0.0)).count()
}

/// A sky of radiance 1e6 around a closed room of albedo 1 without lamps: every ray of 64 levels that got out would show.
#[test]
fn a_sealed_room_of_huge_spheres_is_black_under_the_brightest_sky() {
    for radius in [2000.0, 2e6] {
        let sealed = room(radius, 6, Material::diffuse([1.0; 3]), 1e6);
        for engine in ENGINES {
            let lit = lit_pixels(&render(&sealed, engine, &options(64), 64).image);
            assert_eq!(lit, 0, "{lit} pixels leak with walls of {radius} on {engine:?}, seed 41");
        }
        // Negative control: one wall.
        let open = room(radius, 1, Material::diffuse([1.0; 3]), 1e6);
        let lit = lit_pixels(&render(&open, Engine::Cpu, &options(64), 4).image);
        assert!(lit > 200, "{lit} with walls of {radius}");
    }
}

/// Walls of this radius, and the share of the light of 16 levels that may be lost at most. Near an edge of the room a hit
/// point may lie within the other wall, whose inner side is dark.
const LOST: [(f64, f64); 4] = [(2e3, 1e-6), (2e4, 2e-4), (2e5, 1.5e-3), (2e6, 1.2e-2)];

/// The share of the light that is missing in a room where every level adds `albedo` to its power.
fn lost(radius: f64, albedo: f64, engine: Engine) -> f64 {
    let shining = room(radius, 6, Material::diffuse([albedo; 3]).emitting([1.0; 3]), 0.0);
    let (mean, _) = mean_and_relative_error(&render(&shining, engine, &options(16), 64).image);
    1.0 - mean / 16.0
}

/// Walls of albedo 1 that emit 1 have radiance 16 at 16 levels: a path that gets into a wall meets its dark side instead.
#[test]
fn a_white_room_of_huge_spheres_keeps_its_light() {
    for (radius, bound) in LOST {
        for engine in ENGINES {
            let lost = lost(radius, 1.0, engine);
            println!("walls of {radius:e} on {engine:?}: {lost:.2e} lost");
            assert!((-1e-6..bound).contains(&lost), "walls of {radius:e} on {engine:?}: {lost:e}, seed 41");
        }
    }
    // Negative control: one that absorbs a hundred thousandth.
    assert!(lost(2e3, 0.99999, Engine::Cpu) > 5e-5);
}
