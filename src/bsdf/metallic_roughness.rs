//! The material of glTF 2.0 (appendix B): by `metallic` a rough metal that reflects `color`, else a diffuse base of that colour
//! under a rough coat that reflects 4 %. The two coats are one lobe, since Schlick's reflectance is linear in F₀.
//!
//! glTF lets 1 − F(V·H) of the light through to the base, which together with the coat returns up to 1.7 of what arrives at
//! grazing angles. Here light is taken off once on its way in and once on its way out (Ashikhmin & Shirley 2000; Kelemen &
//! Szirmay-Kalos 2001), so that no more leaves than came. GPU twin: kernels/bsdf/metallic_roughness.wesl

use super::ggx::{alpha_of, ggx_reflection, ggx_sample_facet, schlick, tinted};
use super::{BsdfSample, BsdfValue, weighed};
use crate::math::{luminance, mirrored, to_world};
use crate::sampling::{pdf_cosine, sample_cosine};
use crate::scene::compiled::Material;
use glam::{Vec3, Vec3Swizzles};

/// What the coat over the base reflects head on: an index of refraction of 1.5.
const COAT: f32 = 0.04;
/// What comes through a smooth coat of light from everywhere, 1 − COAT − (1 − COAT) / 21 = 0.9143, and 0.2 % more, so that coats
/// of no roughness together with a white base return more than arrives.
const THROUGH_COAT: f32 = 0.916;

/// Reflectance of both coats head on.
#[inline]
fn coat_reflectance(material: &Material) -> Vec3 {
    Vec3::splat(COAT * (1.0 - material.metallic)) + material.color * material.metallic
}

/// What comes through the coat over the base in that direction.
#[inline]
fn through_coat(cosine: f32) -> f32 {
    1.0 - schlick(Vec3::splat(COAT), cosine).x
}

/// Share of what leaves the base, were light everywhere, that goes to a viewer there; of the colour.
#[inline]
fn base_share(material: &Material, cos_o: f32) -> f32 {
    (1.0 - material.metallic) * through_coat(cos_o)
}

/// Chance of choosing the coat: the luminance of what it reflects, were it smooth, against that of the base.
#[inline]
fn coat_share(material: &Material, cos_o: f32) -> f32 {
    let reflected = luminance(schlick(coat_reflectance(material), cos_o));
    let scattered = luminance(material.color) * base_share(material, cos_o);
    if scattered > 0.0 { reflected / (reflected + scattered) } else { 1.0 }
}

#[inline]
pub fn evaluate(material: &Material, normal: Vec3, wo: Vec3, wi: Vec3) -> BsdfValue {
    let (cos_o, cos_i) = (normal.dot(wo), normal.dot(wi));
    if cos_o.min(cos_i) <= 0.0 {
        return BsdfValue::default();
    }
    let lobe =
        tinted(&ggx_reflection(normal, wo, wi, alpha_of(material.roughness)), coat_reflectance(material));
    let diffuse = base_share(material, cos_o) * through_coat(cos_i) / THROUGH_COAT * pdf_cosine(cos_i);
    let share = coat_share(material, cos_o);
    BsdfValue {
        value: lobe.value + material.color * diffuse,
        pdf: share * lobe.pdf + (1.0 - share) * pdf_cosine(cos_i),
    }
}

#[inline]
pub fn sample(material: &Material, normal: Vec3, wo: Vec3, u: Vec3) -> BsdfSample {
    let wi = if u.z < coat_share(material, normal.dot(wo)) {
        mirrored(-wo, ggx_sample_facet(normal, wo, alpha_of(material.roughness), u.xy()))
    } else {
        to_world(sample_cosine(u.xy()), normal)
    };
    weighed(wi, evaluate(material, normal, wo, wi))
}
