//! Pinhole camera: a pixel's samples cover exactly that pixel (box filter). GPU twin: kernels/scene/camera.wesl

use super::compiled::Uniforms;
use super::shapes::Ray;
use glam::{UVec2, Vec2};

/// The ray through film position `pixel` + `jitter`, both in pixels, row 0 at the top.
#[inline]
pub fn camera_ray(uniforms: &Uniforms, pixel: [u32; 2], jitter: Vec2) -> Ray {
    let size = UVec2::new(uniforms.width, uniforms.height).as_vec2();
    let film = (UVec2::from(pixel).as_vec2() + jitter) / size;
    let direction = uniforms.camera_forward
        + uniforms.camera_right * (2.0 * film.x - 1.0)
        + uniforms.camera_up * (1.0 - 2.0 * film.y);
    Ray { origin: uniforms.camera_origin, direction: direction.normalize() }
}
