//! Smooth normals make no light and let none through.

use super::{smooth_sphere, white};
use crate::support::*;
use glam::DVec3;
use qtracer::scene::{Material, MeshData, Scene, SceneBuilder};
use qtracer::transport::roulette::Roulette;
use qtracer::{Image, RenderOptions};

fn options(direct_light: bool) -> RenderOptions {
    RenderOptions { direct_light: Some(direct_light), roulette: Some(Roulette::Off), ..small(20, 20, 61) }
}

/// Materials of albedo 1.
fn materials() -> [(&'static str, Material); 5] {
    let all = [1.0; 3];
    [
        ("diffuse", white()),
        ("half mirror", Material::mirror(all, 0.5)),
        ("mirror", Material::mirror(all, 1.0)),
        ("glossy", Material::glossy(all, 40.0)),
        ("glass", Material::dielectric(all, 1.5)),
    ]
}

/// Eighty triangles that pass for a sphere, filling most of the image.
fn ball(material: Material) -> SceneBuilder {
    let builder = Scene::builder("ball").camera([0.3, 0.4, 3.0], [0.0; 3], 44.0).material("ball", material);
    builder.mesh(smooth_sphere(1), "ball")
}

/// The largest excess over 1 in standard errors, f32's own rounding allowed, and the mean.
fn excess(image: &Image) -> (f64, f64) {
    let errors = image.standard_error.as_ref().unwrap();
    let z = |(rgb, error): (&[f32; 3], &[f32; 3])| (f64::from(rgb[1]) - 1.0) / (f64::from(error[1]) + 1e-5);
    let worst = image.rgb.iter().zip(errors).map(z).fold(f64::NEG_INFINITY, f64::max);
    (worst, image.rgb.iter().map(|rgb| f64::from(rgb[1])).sum::<f64>() / image.rgb.len() as f64)
}

/// Of the light that a surface of albedo 1 gets from everywhere, it may lose some to directions that only its smooth normal
/// takes for possible, and gains none: α = 3e-5 for each of 400 pixels if any were noisy.
#[test]
fn white_smooth_surfaces_never_outshine_a_white_sky() {
    for (name, material) in materials() {
        let scene = ball(material).environment([1.0; 3]).build().unwrap();
        for engine in [Engine::Cpu, Engine::Megakernel] {
            let (worst, mean) = excess(&render(&scene, engine, &options(false), 64).image);
            println!("{name} on {engine:?}: mean {mean:.4}, at most {worst:.1} s.e. above 1");
            assert!(worst < 4.0 && mean <= 1.0 + 1e-6, "{name} on {engine:?}: {worst} s.e., mean {mean}");
            assert!(mean > 0.96, "{name} on {engine:?} loses light: {mean}");
        }
    }
    // Negative control: a gain of a hundredth.
    let scene = ball(Material::diffuse([1.01; 3])).environment([1.0; 3]).build().unwrap();
    assert!(excess(&render(&scene, Engine::Cpu, &options(false), 64).image).0 > 4.0);
}

/// The same in a closed box that shines and reflects nothing, found by shadow rays and by chance.
#[test]
fn white_smooth_surfaces_never_outshine_the_bright_box_around_them() {
    for (name, material) in materials() {
        let lamp = Material::diffuse([0.0; 3]).emitting([1.0; 3]);
        let mut builder = ball(material).material("lamp", lamp);
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let (mut e1, mut e2) = (DVec3::ZERO, DVec3::ZERO);
                (e1[(axis + 1) % 3], e2[(axis + 2) % 3]) = (10.0, -side * 10.0);
                let mut corner = DVec3::ZERO;
                (corner[axis], corner[(axis + 1) % 3], corner[(axis + 2) % 3]) =
                    (5.0 * side, -5.0, 5.0 * side);
                builder = builder.quad(corner, e1, e2, "lamp");
            }
        }
        let scene = builder.build().unwrap();
        let seen = render(&scene, Engine::Cpu, &RenderOptions { max_bounces: Some(1), ..options(false) }, 4);
        let behind = seen.image.rgb.iter().filter(|rgb| rgb[1] == 1.0).count();
        assert!((20..400).contains(&behind), "the box is closed and shines inwards: {behind}");
        for direct_light in [false, true] {
            let (worst, mean) = excess(&render(&scene, Engine::Cpu, &options(direct_light), 64).image);
            println!("{name}, direct light {direct_light}: mean {mean:.4}, {worst:.1} s.e. above 1 at most");
            assert!(worst < 4.0 && (0.95..1.01).contains(&mean), "{name}: {worst} s.e., mean {mean}");
        }
    }
}

/// A cube whose corners have the normals of a sphere: 55° off those of its sides.
fn round_cube() -> MeshData {
    let corner = |i: u32| {
        DVec3::new(
            [-1.0, 1.0][i as usize & 1],
            [-1.0, 1.0][i as usize >> 1 & 1],
            [-1.0, 1.0][i as usize >> 2],
        )
    };
    let positions: Vec<DVec3> = (0..8).map(corner).collect();
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    MeshData { normals: positions.clone(), positions, triangles, ..Default::default() }
}

/// A white cube without a lamp under the brightest sky: every ray of 64 levels that got in or out would show.
#[test]
fn a_sealed_cube_with_round_normals_is_black_inside() {
    for (name, material) in materials().into_iter().filter(|(name, _)| *name != "glass") {
        let builder = Scene::builder("sealed").environment([1e6; 3]).material("wall", material);
        let builder = builder.camera([0.3, -0.2, 0.5], [-1.0, -0.4, -0.3], 90.0);
        let scene = builder.mesh(round_cube(), "wall").build().unwrap();
        assert!(scene.warnings().is_empty());
        for engine in ENGINES {
            let image = render(&scene, engine, &options(false), 16).image;
            let lit = image.rgb.iter().filter(|rgb| rgb.iter().any(|&v| v != 0.0)).count();
            assert_eq!(lit, 0, "{name} on {engine:?} leaks in {lit} pixels");
        }
    }
}

/// A lamp lights the outside only: shadow rays that the smooth normals of the far side would allow end at the near one.
#[test]
fn a_lamp_outside_a_sealed_cube_does_not_light_its_inside() {
    let lamp = Material::diffuse([0.0; 3]).emitting([1e4; 3]);
    let builder = Scene::builder("lamp outside").material("wall", white()).material("lamp", lamp);
    let builder =
        builder.camera([0.3, -0.2, 0.5], [-1.0, -0.4, -0.3], 90.0).sphere([0.0, 4.0, 1.0], 1.0, "lamp");
    let scene = builder.mesh(round_cube(), "wall").build().unwrap();
    for engine in [Engine::Cpu, Engine::Wavefront(qtracer::gpu::stage::Schedule::Streamed)] {
        let image = render(&scene, engine, &options(true), 16).image;
        assert!(image.rgb.iter().all(|rgb| *rgb == [0.0; 3]), "{engine:?}");
    }
}
