//! First-hit albedo, normal and depth, for denoisers and compositing. Few rays, so always by the CPU twins.

use crate::accel::Search;
use crate::film::Features;
use crate::random::{DIMENSION_CAMERA, SampleKey, Sampler, sample4};
use crate::scene::camera::camera_ray;
use crate::scene::compiled::{CompiledScene, Uniforms};
use crate::scene::shapes::{shape_info, surface_at};
use crate::scene::texels::textured;
use glam::{Vec3, Vec4Swizzles};
use rayon::prelude::*;

/// Rays per pixel: edges are smoothed as in the image.
const SAMPLES: u32 = 16;

/// Means over the pixel. Albedo and normal (world space, towards the viewer) are zero where nothing is hit; depth is the
/// mean distance of the rays that hit, 0 if none does.
pub fn features(scene: &CompiledScene, uniforms: &Uniforms) -> Features {
    let search = Search::new(scene);
    let pixels: Vec<(Vec3, Vec3, f32)> = (0..uniforms.width * uniforms.height)
        .into_par_iter()
        .map(|pixel| pixel_features(scene, &search, uniforms, pixel))
        .collect();
    Features {
        albedo: pixels.iter().map(|p| p.0.to_array()).collect(),
        normal: pixels.iter().map(|p| p.1.to_array()).collect(),
        depth: pixels.iter().map(|p| p.2).collect(),
    }
}

fn pixel_features(
    scene: &CompiledScene,
    search: &Search,
    uniforms: &Uniforms,
    pixel: u32,
) -> (Vec3, Vec3, f32) {
    let (mut albedo, mut normal, mut depth, mut hits) = (Vec3::ZERO, Vec3::ZERO, 0.0, 0u32);
    for sample in 0..SAMPLES {
        let key = SampleKey { pixel, sample, seed: uniforms.seed };
        let u = sample4(Sampler::Stratified, key, DIMENSION_CAMERA);
        let ray = camera_ray(uniforms, [pixel % uniforms.width, pixel / uniforms.width], u.xy());
        let Some(hit) = search.intersect(ray) else { continue };
        let mut surface = surface_at(scene, ray, hit);
        let index = shape_info(scene, hit.shape).material;
        albedo += match scene.surfaces.is_textured() {
            false => scene.materials[index as usize].color,
            true => textured(scene, index, &mut surface).color,
        };
        let towards_viewer = if ray.direction.dot(surface.normal) < 0.0 { 1.0 } else { -1.0 };
        normal += surface.shading_normal * towards_viewer;
        depth += hit.t;
        hits += 1;
    }
    let mean = 1.0 / SAMPLES as f32;
    (albedo * mean, normal * mean, if hits > 0 { depth / hits as f32 } else { 0.0 })
}
