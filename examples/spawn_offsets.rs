//! How often does a ray that leaves a surface meet the point that it leaves? Counts such rays of 4 million for spheres and
//! a quad at several scales, for offsets around the one in use: the evidence for `RELATIVE_OFFSET`.
//!
//! `cargo run --release --example spawn_offsets`

use glam::{Vec3, Vec4Swizzles};
use qtracer::random::{SampleKey, Sampler, sample4};
use qtracer::sampling::sample_cone;
use qtracer::scene::Material;
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::shapes::{Hit, Ray, Surface, intersect, spawn_ray, surface_at};
use qtracer::{Scene, scene::SceneError};

const RAYS: u32 = 4_000_000;

/// Four numbers of event `dimension` of ray `i`.
fn draw(i: u32, dimension: u32) -> glam::Vec4 {
    sample4(Sampler::Independent, SampleKey { pixel: 1, sample: i, seed: 9 }, dimension)
}

fn uniform_direction(i: u32, dimension: u32) -> Vec3 {
    sample_cone(draw(i, dimension).xy(), 2.0)
}

/// A ray that meets the only shape of the scene from outside or inside.
fn first_ray(scene: &CompiledScene, i: u32) -> Ray {
    let u = draw(i, 1);
    let (target, distance) = match (scene.spheres.first(), scene.quads.first()) {
        (Some(s), _) => (s.center + 0.9 * s.radius * uniform_direction(i, 2), s.radius * 4.0 * u.x),
        (_, Some(q)) => (q.corner + q.e1 * u.y + q.e2 * u.z, q.e1.length() * u.x),
        _ => unreachable!("the scene has one shape"),
    };
    let direction = uniform_direction(i, 3);
    Ray { origin: target - direction * distance, direction }
}

/// Whether a ray that left `surface` towards `direction` meets it again where geometry says that it does not, or misses it
/// where it does.
fn is_wrong(scene: &CompiledScene, surface: &Surface, direction: Vec3) -> bool {
    let hit = intersect(scene, spawn_ray(surface, direction));
    let chord = match scene.spheres.first() {
        Some(s) if (surface.position - s.center).dot(direction) < 0.0 => {
            let outward = (surface.position - s.center).as_dvec3().normalize();
            -2.0 * f64::from(s.radius) * outward.dot(direction.as_dvec3())
        }
        _ => 0.0,
    };
    match hit {
        None => chord > 0.0,
        Some(Hit { t, .. }) => f64::from(t) < 0.5 * chord || chord == 0.0,
    }
}

fn wrong_rays(scene: &CompiledScene, scale: f32) -> u32 {
    let mut wrong = 0;
    for i in 0..RAYS {
        let ray = first_ray(scene, i);
        let Some(hit) = intersect(scene, ray) else { continue };
        let mut surface = surface_at(scene, ray, hit);
        surface.offset *= scale;
        wrong += u32::from(is_wrong(scene, &surface, uniform_direction(i, 4)));
    }
    wrong
}

fn main() -> Result<(), SceneError> {
    let empty = |name: &str| {
        Scene::builder(name)
            .camera([0.0, 0.0, 1.0], [0.0; 3], 40.0)
            .material("m", Material::diffuse([0.5; 3]))
    };
    let ball =
        |name: &str, at: f64, radius: f64| empty(name).sphere([at, 0.3 * at, -0.7 * at], radius, "m").build();
    let scenes = [
        ball("ball of 1 at 0", 0.0, 1.0)?,
        ball("ball of 1e-3 at 0", 0.0, 1e-3)?,
        ball("ball of 1 at 100", 100.0, 1.0)?,
        ball("ball of 1 at 10,000", 1e4, 1.0)?,
        ball("wall of 2000 at 2000", 2000.0, 2000.0)?,
        ball("ball of 1e6 at 1e6", 1e6, 1e6)?,
        empty("quad of 555 at 0").quad([0.0; 3], [555.0, 0.0, 0.0], [0.0, 300.0, 400.0], "m").build()?,
        empty("quad of 1 at 10,000").quad([1e4, 1e4, 0.0], [0.6, 0.0, 0.8], [0.0, 1.0, 0.1], "m").build()?,
    ];
    println!("Wrong rays of {RAYS}, by offset relative to the largest coordinate\n");
    println!("| shape | 0 | 2^-24 | 2^-23 | 2^-22 | 2^-21 | 2^-20 (used) |\n|---|---|---|---|---|---|---|");
    for scene in scenes {
        let compiled = CompiledScene::new(&scene);
        let counts: Vec<String> = [0.0, 1.0 / 16.0, 1.0 / 8.0, 0.25, 0.5, 1.0]
            .map(|scale| wrong_rays(&compiled, scale).to_string())
            .to_vec();
        println!("| {} | {} |", scene.name, counts.join(" | "));
    }
    Ok(())
}
