//! What every material answers. Directions point away from the surface; `wo` to the viewer, `wi` to where light comes
//! from; `normal` is on the viewer's side. GPU twin: kernels/bsdf/interface.wesl

mod dielectric;
mod diffuse;
mod glossy;
mod mirror;

pub use dielectric::fresnel;

use crate::scene::compiled::{KIND_DIELECTRIC, KIND_DIFFUSE, KIND_GLOSSY, KIND_MIRROR, Material};
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

/// Chooses `wi`. `u` holds three numbers in [0, 1): two for the direction, one for the lobe.
#[inline(always)]
pub fn bsdf_sample(material: &Material, normal: Vec3, wo: Vec3, outside: bool, u: Vec3) -> BsdfSample {
    match material.kind {
        KIND_DIFFUSE => diffuse::sample(material, normal, u.xy()),
        KIND_MIRROR => mirror::sample(material, normal, wo, u),
        KIND_GLOSSY => glossy::sample(material, normal, wo, u.xy()),
        KIND_DIELECTRIC => dielectric::sample(material, normal, wo, outside, u.z),
        _ => BsdfSample { wi: normal, weight: Vec3::ZERO, pdf: 0.0 },
    }
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

/// Evaluates `wi`. Delta lobes contribute nothing here: no direction chosen elsewhere meets them.
#[inline(always)]
pub fn bsdf_evaluate(material: &Material, normal: Vec3, wo: Vec3, wi: Vec3) -> BsdfValue {
    match material.kind {
        KIND_DIFFUSE => diffuse::evaluate(material, normal, wi),
        KIND_MIRROR => mirror::evaluate(material, normal, wi),
        KIND_GLOSSY => glossy::evaluate(material, normal, wo, wi),
        _ => BsdfValue::default(),
    }
}
