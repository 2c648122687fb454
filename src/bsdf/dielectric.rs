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

/// cos² of the refracted angle, at most 0 at total internal reflection. By way of ior² − 1, which keeps its digits where the
/// ior goes to 1 and where light grazes: 1 − sin² is then rounded away, and glass that bends nothing would be a mirror.
#[inline]
pub(super) fn cos2_refracted(cos_i: f32, ior: f32, outside: bool) -> f32 {
    let excess = (ior - 1.0) * (ior + 1.0);
    let cos2_i = cos_i * cos_i;
    if outside { (cos2_i + excess) / (ior * ior) } else { cos2_i * (ior * ior) - excess }
}

/// `normal` is on the viewer's side; `outside` says whether that is the outer side.
#[inline]
pub fn sample(material: &Material, normal: Vec3, wo: Vec3, outside: bool, u: f32) -> BsdfSample {
    let eta = if outside { material.parameter } else { 1.0 / material.parameter };
    let cos_i = wo.dot(normal);
    let cos2_t = cos2_refracted(cos_i, material.parameter, outside);
    let cos_t = cos2_t.max(0.0).sqrt();
    if cos2_t <= 0.0 || u < fresnel(cos_i, cos_t, eta) {
        return BsdfSample { wi: mirrored(-wo, normal), weight: material.color, pdf: 0.0 };
    }
    let refracted = (normal * (cos_i / eta - cos_t) - wo / eta).normalize();
    // Radiance is squeezed by the change of solid angle on entering the denser side (Veach 1997, §5.2).
    BsdfSample { wi: refracted, weight: material.color / (eta * eta), pdf: 0.0 }
}
