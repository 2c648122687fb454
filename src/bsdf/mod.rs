//! What every material answers. Directions point away from the surface; `wo` to the viewer, `wi` to where light comes
//! from; `normal` is on the viewer's side. GPU twin: kernels/bsdf/interface.wesl

mod dielectric;
mod diffuse;
mod ggx;
mod glossy;
mod metal;
mod metallic_roughness;
mod mirror;
mod rough_dielectric;

pub use dielectric::fresnel;

use crate::scene::compiled::{
    KIND_DIELECTRIC, KIND_DIFFUSE, KIND_GLOSSY, KIND_METAL, KIND_METALLIC_ROUGHNESS, KIND_MIRROR,
    KIND_ROUGH_DIELECTRIC, Material,
};
use glam::{Vec3, Vec3Swizzles};

/// A direction that the material chose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfSample {
    pub wi: Vec3,
    /// f·cosθ / pdf; zero ends the path.
    pub weight: Vec3,
    /// Density of `wi` in sr⁻¹ over all non-delta lobes; 0 marks a delta lobe.
    pub pdf: f32,
}

/// What the material says of a direction chosen elsewhere.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BsdfValue {
    /// f·cosθ.
    pub value: Vec3,
    /// Density with which [`bsdf_sample`] would have chosen this direction, in sr⁻¹.
    pub pdf: f32,
}

/// What is known of a direction that was chosen by its density: its weight is its value over that.
#[inline]
fn weighed(wi: Vec3, BsdfValue { value, pdf }: BsdfValue) -> BsdfSample {
    BsdfSample { wi, weight: if pdf > 0.0 { value / pdf } else { Vec3::ZERO }, pdf }
}

/// Chooses `wi`. `u` holds three numbers in [0, 1): two for the direction, one for the lobe.
#[inline(always)]
pub fn bsdf_sample(material: &Material, normal: Vec3, wo: Vec3, outside: bool, u: Vec3) -> BsdfSample {
    match material.kind {
        KIND_DIFFUSE => diffuse::sample(material, normal, u.xy()),
        KIND_MIRROR => mirror::sample(material, normal, wo, u),
        KIND_GLOSSY => glossy::sample(material, normal, wo, u.xy()),
        KIND_DIELECTRIC => dielectric::sample(material, normal, wo, outside, u.z),
        KIND_METAL => metal::sample(material, normal, wo, u.xy()),
        KIND_METALLIC_ROUGHNESS => metallic_roughness::sample(material, normal, wo, u),
        KIND_ROUGH_DIELECTRIC => rough_dielectric::sample(material, normal, wo, outside, u),
        _ => BsdfSample { wi: normal, weight: Vec3::ZERO, pdf: 0.0 },
    }
}

/// Whether it reflects nothing at all, as lamps do. What has a coat reflects by that, whatever its colour.
#[inline]
pub fn is_black(material: &Material) -> bool {
    let coated = matches!(material.kind, KIND_METAL | KIND_METALLIC_ROUGHNESS);
    material.color.max_element() <= 0.0 && !coated
}

/// How much of the material is a Lambertian lobe: the only part that learns and is guided.
#[inline]
pub fn lambert_share(material: &Material) -> f32 {
    match material.kind {
        KIND_DIFFUSE => 1.0,
        KIND_MIRROR => 1.0 - material.parameter,
        _ => 0.0,
    }
}

/// Evaluates `wi`, which may be on the other side. Delta lobes contribute nothing here: no direction chosen elsewhere meets
/// them.
#[inline(always)]
pub fn bsdf_evaluate(material: &Material, normal: Vec3, wo: Vec3, outside: bool, wi: Vec3) -> BsdfValue {
    match material.kind {
        KIND_DIFFUSE => diffuse::evaluate(material, normal, wi),
        KIND_MIRROR => mirror::evaluate(material, normal, wi),
        KIND_GLOSSY => glossy::evaluate(material, normal, wo, wi),
        KIND_METAL => metal::evaluate(material, normal, wo, wi),
        KIND_METALLIC_ROUGHNESS => metallic_roughness::evaluate(material, normal, wo, wi),
        KIND_ROUGH_DIELECTRIC => rough_dielectric::evaluate(material, normal, wo, outside, wi),
        _ => BsdfValue::default(),
    }
}
