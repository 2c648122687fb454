//! Film positions and camera rays.

use super::twins::{SIDES, Side, Twins, World, Worst, camera};
use super::{ALPHA, WRONG};
use crate::oracles::sampling::ROUNDING;
use crate::probe::{floats, row};
use glam::{DVec2, DVec3};
use qtracer::random::{DIMENSION_CAMERA, sample4};
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::rows::Row;
use qtracer::scene::{Camera, Scene};
use qtracer::stats::chi2_test;

const GENERATE: (&str, &str) = (
    "import package::transport::path::generate;",
    "let ray = generate(a.x);
    out0 = vec4<u32>(bitcast<vec3<u32>>(ray.origin), ray.path);
    out1 = vec4<u32>(bitcast<vec3<u32>>(ray.direction), ray.bounce);
    out2 = vec4<u32>(bitcast<vec3<u32>>(ray.throughput), bitcast<u32>(ray.pdf));",
);

fn generate(world: &World, [[path, ..]]: &[Row; 1]) -> [Row; 3] {
    let ray = world.transport().generate(*path);
    [row(ray.origin, ray.path), row(ray.direction, ray.bounce), row(ray.throughput, ray.pdf.to_bits())]
}

/// One pixel of a film of that size, seen by a camera that stands askew.
fn pixel(size: u32, column: u32, line: u32) -> (World, Camera) {
    let scene = Scene::builder("empty").camera([1.0, 2.0, 3.0], [-4.0, 1.0, 0.5], 50.0).build().unwrap();
    let view =
        Camera { origin: DVec3::new(1.0, 2.0, 3.0), target: DVec3::new(-4.0, 1.0, 0.5), ..camera(50.0) };
    let mut world = World::of(CompiledScene::new(&scene));
    world.uniforms = world.scene.uniforms(&view, size, size, 41);
    world.uniforms.first_pixel = line * size + column;
    world.uniforms.pixel_count = 1;
    (world, view)
}

/// The film position, in pixels, that a direction points to, in f64.
fn film_position(view: &Camera, size: u32, direction: DVec3) -> DVec2 {
    let forward = (view.target - view.origin).normalize();
    let right = forward.cross(view.up).normalize();
    let up = right.cross(forward);
    let half = (view.fov_y_deg.to_radians() * 0.5).tan() * direction.dot(forward);
    let film = DVec2::new(direction.dot(right) / half, -direction.dot(up) / half);
    (film + 1.0) * 0.5 * f64::from(size)
}

/// Positions within the pixel that paths start from, and how far off the drawn ones they are.
fn positions(twins: &Twins<1, 3>, side: Side, world: &World, view: &Camera, worst: &Worst) -> Vec<DVec2> {
    let u = &world.uniforms;
    let corner = DVec2::new(f64::from(u.first_pixel % u.width), f64::from(u.first_pixel / u.width));
    let questions: Vec<_> = (0..1 << 18).map(|path| [[path, 0, 0, 0]]).collect();
    let answers = twins.answer(side, &questions).into_iter().zip(0..);
    let position = |([origin, direction, throughput], path): ([Row; 3], u32)| {
        assert_eq!(origin, row(u.camera_origin, path));
        assert_eq!((direction[3], throughput), (0, row(glam::Vec3::ONE, 0)));
        let direction = floats(direction).0.as_dvec3();
        assert!((direction.length() - 1.0).abs() < 3.0 * ROUNDING, "{direction}");
        let found = film_position(view, u.width, direction) - corner;
        let drawn = sample4(world.sampler, world.transport().sample_key(path), DIMENSION_CAMERA);
        worst.see((found - DVec2::new(drawn.x.into(), drawn.y.into())).abs().max_element());
        found
    };
    answers.map(position).collect()
}

/// Counts of positions in a 16 × 16 grid of the pixel.
fn counts(positions: &[DVec2]) -> Vec<u64> {
    let mut counts = vec![0; 256];
    let cell = |x: f64| (x * 16.0).clamp(0.0, 15.0) as usize;
    positions.iter().for_each(|p| counts[16 * cell(p.y) + cell(p.x)] += 1);
    counts
}

/// Samples cover exactly their pixel, evenly: a box filter. In a film of 16384², whose corner lies 2¹⁴ pixels from its zero,
/// 24 bits leave a thousandth of a pixel.
#[test]
fn film_positions_are_uniform_over_the_pixel() {
    for (size, column, line, bound) in
        [(64, 0, 63, 1.5e-5), (64, 40, 17, 1.5e-5), (16384, 16383, 9000, 3.5e-3)]
    {
        let (world, view) = pixel(size, column, line);
        let twins = Twins::new(&world, GENERATE, generate);
        for side in SIDES {
            let worst = Worst::default();
            let counts = counts(&positions(&twins, side, &world, &view, &worst));
            let p = chi2_test(&counts, &[1024.0; 256]).unwrap().p_value;
            assert!(p > ALPHA, "{side:?}: pixel {column}, {line} of {size}: p = {p}");
            println!("{side:?}: film positions of {size} × {size} are {:e} pixels off", worst.get());
            assert!(worst.get() < bound, "{side:?}, {size}: {} pixels off", worst.get());
            // Negative control: 3 % more in the left half.
            let askew: Vec<f64> =
                (0..256).map(|i| if i % 16 < 8 { 1024.0 * 1.03 } else { 1024.0 * 0.97 }).collect();
            assert!(chi2_test(&counts, &askew).unwrap().p_value < WRONG);
        }
    }
}
