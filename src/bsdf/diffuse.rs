//! Lambertian reflection, two-sided: f = color/π. GPU twin: kernels/bsdf/diffuse.wesl

use super::{BsdfSample, BsdfValue};
use crate::math::to_world;
use crate::sampling::{pdf_cosine, sample_cosine};
use crate::scene::compiled::Material;
use glam::{Vec2, Vec3};

#[inline]
pub fn evaluate(material: &Material, normal: Vec3, wi: Vec3) -> BsdfValue {
    let pdf = pdf_cosine(normal.dot(wi));
    BsdfValue { value: material.color * pdf, pdf }
}

#[inline]
pub fn sample(material: &Material, normal: Vec3, u: Vec2) -> BsdfSample {
    let local = sample_cosine(u);
    BsdfSample { wi: to_world(local, normal), weight: material.color, pdf: pdf_cosine(local.z) }
}
