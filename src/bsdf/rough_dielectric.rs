//! Rough glass: GGX facets that each reflect or refract as smooth glass does (Walter et al. 2007), as much as Fresnel says.
//! Radiance is squeezed as by smooth glass. GPU twin: kernels/bsdf/rough_dielectric.wesl

use super::dielectric::{self, cos2_refracted, fresnel};
use super::ggx::{alpha_of, ggx_density, ggx_reflection, ggx_sample_facet, ggx_seen, ggx_seen_and_lit};
use super::{BsdfSample, BsdfValue, weighed};
use crate::math::mirrored;
use crate::scene::compiled::Material;
use glam::{Vec3, Vec3Swizzles};

/// Glass that hardly bends spreads light by about (ior − 1)·α. Less than this, f32 directions can't tell the facet that a
/// refracted one came by, and the glass counts as smooth: of index 1 it is not there.
const LEAST_SPREAD: f32 = 1e-5;

#[inline]
fn counts_as_smooth(material: &Material) -> bool {
    (material.parameter - 1.0) * alpha_of(material.roughness) < LEAST_SPREAD
}

/// What a facet reflects; all beyond the critical angle.
#[inline]
fn reflected_share(cos_i: f32, eta: f32, ior: f32, outside: bool) -> f32 {
    let cos2_t = cos2_refracted(cos_i, ior, outside);
    if cos2_t <= 0.0 { 1.0 } else { fresnel(cos_i, cos2_t.sqrt(), eta) }
}

/// `wi` is on the other side. wo + eta·wi is along the normal of the facet that refracts one to the other, to the side of the
/// lesser index; its length is what the Jacobian of refraction is made of.
#[inline]
fn transmission(material: &Material, normal: Vec3, wo: Vec3, wi: Vec3, outside: bool) -> BsdfValue {
    let eta = if outside { material.parameter } else { 1.0 / material.parameter };
    let middle = if outside { -(wo + wi * eta) } else { wo + wi * eta };
    let length = middle.dot(middle).max(1e-30).sqrt();
    let (to_o, to_i) = (middle.dot(wo) / length, -middle.dot(wi) / length);
    let (cos_o, cos_i) = (normal.dot(wo), -normal.dot(wi));
    if to_o.min(to_i).min(middle.dot(normal)).min(cos_o) <= 0.0 {
        return BsdfValue::default();
    }
    let alpha = alpha_of(material.roughness);
    let through = 1.0 - fresnel(to_o, to_i, eta);
    let density = through * to_o * to_i * ggx_density(normal, middle, alpha) / (length * length);
    BsdfValue {
        value: material.color * (density * ggx_seen_and_lit(cos_o, cos_i, alpha)),
        pdf: density * ggx_seen(cos_o, alpha) * (eta * eta),
    }
}

#[inline]
fn reflection(material: &Material, normal: Vec3, wo: Vec3, wi: Vec3, outside: bool) -> BsdfValue {
    let lobe = ggx_reflection(normal, wo, wi, alpha_of(material.roughness));
    let eta = if outside { material.parameter } else { 1.0 / material.parameter };
    let share = reflected_share(lobe.cos_facet, eta, material.parameter, outside);
    BsdfValue { value: material.color * (share * lobe.value), pdf: share * lobe.pdf }
}

/// `normal` is on the viewer's side; `outside` says whether that is the outer side. `wi` may be on either.
#[inline]
pub fn evaluate(material: &Material, normal: Vec3, wo: Vec3, outside: bool, wi: Vec3) -> BsdfValue {
    let cos_i = normal.dot(wi);
    if cos_i == 0.0 || counts_as_smooth(material) {
        return BsdfValue::default();
    }
    if cos_i > 0.0 {
        return reflection(material, normal, wo, wi, outside);
    }
    transmission(material, normal, wo, wi, outside)
}

/// Light that a facet sends to the side where it does not belong is lost.
#[inline]
pub fn sample(material: &Material, normal: Vec3, wo: Vec3, outside: bool, u: Vec3) -> BsdfSample {
    if counts_as_smooth(material) {
        return dielectric::sample(material, normal, wo, outside, u.z);
    }
    let eta = if outside { material.parameter } else { 1.0 / material.parameter };
    let facet = ggx_sample_facet(normal, wo, alpha_of(material.roughness), u.xy());
    let cos_facet = facet.dot(wo).clamp(0.0, 1.0);
    let reflects = u.z < reflected_share(cos_facet, eta, material.parameter, outside);
    let cos_t = cos2_refracted(cos_facet, material.parameter, outside).max(0.0).sqrt();
    let wi = if reflects {
        mirrored(-wo, facet)
    } else {
        (facet * (cos_facet / eta - cos_t) - wo / eta).normalize()
    };
    let value = evaluate(material, normal, wo, outside, wi);
    let lost = (normal.dot(wi) > 0.0) != reflects;
    weighed(wi, if lost { BsdfValue::default() } else { value })
}
