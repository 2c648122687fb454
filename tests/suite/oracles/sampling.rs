//! Solid angles and densities of lights, and frames, in f64.

use glam::{DVec3, Vec3};

/// Half the distance of 1 from the next f32: the relative error of one operation.
pub const ROUNDING: f64 = f32::EPSILON as f64 / 2.0;

/// The largest deviation of three vectors from a right-handed orthonormal basis.
pub fn frame_error([tangent, bitangent, normal]: [Vec3; 3]) -> f64 {
    let [t, b, n] = [tangent, bitangent, normal].map(Vec3::as_dvec3);
    let off = [t.length() - 1.0, b.length() - 1.0, t.dot(b), t.dot(n), b.dot(n), (t.cross(b) - n).length()];
    off.into_iter().map(f64::abs).fold(0.0, f64::max)
}

/// What a sphere looks like from a point outside.
pub struct Cap {
    /// Distance of its centre.
    pub distance: f64,
    /// Cosine of the cone that it fills.
    pub cos_max: f64,
    /// Density of uniform directions to it, in sr⁻¹.
    pub pdf: f64,
}

pub fn cap(to_center: DVec3, radius: f64) -> Cap {
    let distance = to_center.length();
    let sin = radius / distance;
    let cos_max = ((distance - radius) * (distance + radius)).max(0.0).sqrt() / distance;
    Cap { distance, cos_max, pdf: (1.0 + cos_max) / (std::f64::consts::TAU * sin * sin) }
}
