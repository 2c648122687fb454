//! Phong lobe about the mirror direction; what falls below the horizon is folded up, so nothing is lost:
//! f·cosθ = color · (n + 1)/2π · (cosⁿα + cosⁿα′), α′ measured for the direction reflected in the surface.
//! GPU twin: kernels/bsdf/glossy.wesl

use super::{BsdfSample, BsdfValue};
use crate::math::{mirrored, one_minus_cos, to_world};
use crate::sampling::{pdf_phong, sample_phong};
use crate::scene::compiled::Material;
use glam::{Vec2, Vec3};

#[inline]
pub fn evaluate(material: &Material, normal: Vec3, wo: Vec3, wi: Vec3) -> BsdfValue {
    if normal.dot(wi) <= 0.0 {
        return BsdfValue::default();
    }
    let axis = mirrored(-wo, normal);
    let pdf = pdf_phong(one_minus_cos(axis, wi), material.parameter)
        + pdf_phong(one_minus_cos(axis, mirrored(wi, normal)), material.parameter);
    BsdfValue { value: material.color * pdf, pdf }
}

#[inline]
pub fn sample(material: &Material, normal: Vec3, wo: Vec3, u: Vec2) -> BsdfSample {
    let axis = mirrored(-wo, normal);
    let lobe = to_world(sample_phong(u, material.parameter), axis);
    let wi = if lobe.dot(normal) < 0.0 { mirrored(lobe, normal) } else { lobe };
    let pdf = evaluate(material, normal, wo, wi).pdf;
    // value / pdf is the colour exactly; a sample on the horizon itself has no density and ends the path.
    BsdfSample { wi, weight: if pdf > 0.0 { material.color } else { Vec3::ZERO }, pdf }
}
