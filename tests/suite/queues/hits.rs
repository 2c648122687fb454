//! Intersection: every ray goes to the queue of what it meets.

use super::*;
use qtracer::scene::compiled::Sphere;
use qtracer::scene::rows;
use qtracer::scene::shapes::{Ray, intersect, shape_info};
use qtracer::transport::items::HitItem;

/// Twin of refine_sphere_distance: what shading makes of the distance in the queue.
fn refined(ray: &RayItem, sphere: &Sphere, t: f32) -> f32 {
    let f = ray.origin - sphere.center;
    let b = -f.dot(ray.direction);
    let sum = b.abs() + (t - b).abs();
    if t.abs() >= 0.5 * sum {
        return t;
    }
    let refined = (f.dot(f) - sphere.radius * sphere.radius) / sum.copysign(b);
    if refined > 0.0 { refined } else { t }
}

/// Every ray lands in the queue of its hit's material, misses in the environment's, each once; and the hit is the CPU's
/// but for rays within rounding of an edge.
#[test]
fn intersection_pushes_every_ray_to_exactly_one_queue() {
    for name in [
        "bansal-room-1",
        "cornell-box",
        "glossy-box",
        "furnace-open-half",
        "door-ajar",
        "many-lights",
        "metal-spheres",
        "rough-glass",
    ] {
        let compiled = CompiledScene::new(&scene(name));
        let harness = Harness::new(Stage::Intersect, &compiled, Schedule::Streamed);
        let camera = scene(name).camera;
        let rays: Vec<RayItem> = (0..3000u32)
            .map(|i| {
                // Directions on a spiral over the sphere, from the camera.
                let z = 1.0 - (2.0 * i as f32 + 1.0) / 3000.0;
                let (sin, cos) = (2.399_963 * i as f32).sin_cos();
                let r = (1.0 - z * z).sqrt();
                let direction = Vec3::new(r * cos, r * sin, z);
                RayItem { origin: camera.origin.as_vec3(), direction, path: i, ..RayItem::zeroed() }
            })
            .collect();
        let capacity = 3000;
        let queues = harness.key.hit_queues() as usize;
        let uniforms = Uniforms { capacity, ..compiled.uniforms(&camera, 1, 1, 0) };
        let hits = vec![UNTOUCHED; 3 * queues * capacity as usize];
        let rays_in = to_planes(&rays, 0, capacity);
        let counters = harness.counters(&[(Counter::Live, rays.len() as u32)]);
        let mut contents: Vec<(&str, &[u8])> = vec![
            ("counters", bytemuck::cast_slice(&counters)),
            ("rays_in", bytemuck::cast_slice(&rays_in)),
            ("hits", bytemuck::cast_slice(&hits)),
        ];
        let (rows, hot) = (rows::pack(&compiled), rows::hot(&compiled));
        contents.push(("scene_rows", bytemuck::cast_slice(&rows)));
        contents.push(("hot_rows", bytemuck::cast_slice(&hot)));
        let read = harness.run(uniforms, &contents, 3000u32.div_ceil(WORKGROUP), &["counters", "hits"]);
        let (counters, hits) = (words(&read[0]), words(&read[1]));
        // A plane of all queues for each of the three words.
        let hit = |queue: usize, i: usize| {
            let word = |plane: usize| hits[(queue + plane * queues) * capacity as usize + i];
            HitItem { slot: word(0), shape: word(1), t: f32::from_bits(word(2)) }
        };

        assert_eq!(counters[Counter::Overflow as usize], 0);
        let (mut seen, mut differing) = (BTreeSet::new(), 0);
        for queue in 0..queues {
            let length = counters[Counter::FirstHit as usize + queue] as usize;
            for (i, item) in (0..capacity as usize).map(|i| hit(queue, i)).enumerate() {
                assert_eq!(i < length, item.slot != UNTOUCHED, "{name}: queue {queue} is not dense");
                if i >= length {
                    continue;
                }
                assert!(seen.insert(item.slot), "{name}: ray {} was pushed twice", item.slot);
                let expected = match item.shape {
                    NONE => harness.key.hit_queues() - 1,
                    shape => harness.key.hit_queue(shape_info(&compiled, shape).kind),
                };
                assert_eq!(queue as u32, expected, "{name}: {item:?}");
                let ray = &rays[item.slot as usize];
                let cpu = intersect(&compiled, Ray { origin: ray.origin, direction: ray.direction });
                let same = match cpu {
                    None => item.shape == NONE,
                    Some(hit) => {
                        let (t, size) = match compiled.spheres.get(hit.shape as usize) {
                            Some(sphere) => (
                                refined(ray, sphere, item.t),
                                (ray.origin - sphere.center).length() + sphere.radius,
                            ),
                            None => (item.t, hit.t.max(1.0)),
                        };
                        // Eight roundings on either side (docs/ACCURACY.md).
                        hit.shape == item.shape && (hit.t - t).abs() <= 16.0 * size / 16_777_216.0
                    }
                };
                differing += usize::from(!same);
            }
        }
        let misses = rays.iter().filter(|ray| {
            intersect(&compiled, Ray { origin: ray.origin, direction: ray.direction }).is_none()
        });
        let dark = if harness.key.environment { 0 } else { misses.count() };
        assert!(
            seen.len().abs_diff(3000 - dark) <= 3,
            "{name}: {} of {} rays pushed",
            seen.len(),
            3000 - dark
        );
        assert!(differing <= 3, "{name}: {differing} hits differ from the CPU's");
    }
}
