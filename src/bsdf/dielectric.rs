//! Smooth glass: exact unpolarised Fresnel reflection, total internal reflection, refraction. All lobes are delta lobes.
//! GPU twin: kernels/bsdf/dielectric.wesl

use super::BsdfSample;
use crate::math::mirrored;
use crate::scene::compiled::Material;
use glam::Vec3;

/// Reflected share at a smooth interface; `eta` = ior beyond the surface / ior on the incident side.
/// `cos_t` is the cosine of the refracted angle, 0 at total internal reflection.
#[inline]
pub fn fresnel(cos_i: f32, cos_t: f32, eta: f32) -> f32 {
    let parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    let perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    0.5 * (parallel * parallel + perpendicular * perpendicular)
}

/// `normal` is on the viewer's side; `outside` says whether that is the outer side.
#[inline]
pub fn sample(material: &Material, normal: Vec3, wo: Vec3, outside: bool, u: f32) -> BsdfSample {
    let eta = if outside { material.parameter } else { 1.0 / material.parameter };
    let cos_i = wo.dot(normal);
    let cos2_t = 1.0 - (1.0 - cos_i * cos_i) / (eta * eta);
    let cos_t = cos2_t.max(0.0).sqrt();
    if cos2_t <= 0.0 || u < fresnel(cos_i, cos_t, eta) {
        return BsdfSample { wi: mirrored(-wo, normal), weight: material.color, pdf: 0.0 };
    }
    let refracted = (normal * (cos_i / eta - cos_t) - wo / eta).normalize();
    // Radiance is squeezed by the change of solid angle on entering the denser side (Veach 1997, §5.2).
    BsdfSample { wi: refracted, weight: material.color / (eta * eta), pdf: 0.0 }
}
