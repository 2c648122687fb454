//! How much of direct light goes to the environment.

use super::super::compiled::CompiledScene;
use glam::Vec3;

/// What arrives is not known before it is traced: walls may keep the sky out, or lamps may be in another room. So neither
/// gets less than this.
const LEAST_SHARE: f64 = 0.25;

/// The chance that direct light asks the environment map, not a lamp: by the power that it sends through the sphere about
/// the scene against that of the lamps, 0.25 to 0.75; 1 without lamps, 0 without a map.
///
/// `lamps` is the power of all lamps, of all channels together, over π, as [`Sky::irradiance`](super::Sky) times an area.
pub fn environment_share(scene: &CompiledScene, lamps: f64) -> f32 {
    let Some(sky) = &scene.sky else { return 0.0 };
    if scene.lights.is_empty() {
        return 1.0;
    }
    let sky = sky.irradiance * radius(scene).powi(2);
    (sky / (sky + lamps)).clamp(LEAST_SHARE, 1.0 - LEAST_SHARE) as f32
}

/// Half the diagonal of the box about all shapes.
fn radius(scene: &CompiledScene) -> f64 {
    let spheres = scene.spheres.iter().flat_map(|s| [s.center - s.radius, s.center + s.radius]);
    let quads = scene.quads.iter().flat_map(|q| {
        let far = q.corner + q.e1 + q.e2;
        [q.corner, q.corner + q.e1, q.corner + q.e2, far]
    });
    let triangles = scene.triangles.iter().flat_map(|t| [t.a, t.b, t.c]);
    let triangles = triangles.chain(scene.shared.bounds.iter().flatten().copied());
    let grow = |[low, high]: [Vec3; 2], point: Vec3| [low.min(point), high.max(point)];
    let [low, high] = spheres.chain(quads).chain(triangles).fold([Vec3::INFINITY, Vec3::NEG_INFINITY], grow);
    0.5 * f64::from((high - low).length())
}
