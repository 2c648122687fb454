//! Rough metal: GGX facets that reflect `color` head on and everything at grazing angles (Schlick 1994).
//! GPU twin: kernels/bsdf/metal.wesl

use super::ggx::{alpha_of, ggx_reflection, ggx_sample_facet, tinted};
use super::{BsdfSample, BsdfValue, weighed};
use crate::math::mirrored;
use crate::scene::compiled::Material;
use glam::{Vec2, Vec3};

#[inline]
pub fn evaluate(material: &Material, normal: Vec3, wo: Vec3, wi: Vec3) -> BsdfValue {
    tinted(&ggx_reflection(normal, wo, wi, alpha_of(material.roughness)), material.color)
}

#[inline]
pub fn sample(material: &Material, normal: Vec3, wo: Vec3, u: Vec2) -> BsdfSample {
    let facet = ggx_sample_facet(normal, wo, alpha_of(material.roughness), u);
    let wi = mirrored(-wo, facet);
    weighed(wi, evaluate(material, normal, wo, wi))
}
