//! Microfacets whose slopes follow GGX (Trowbridge & Reitz 1975; Walter et al. 2007), with Smith's height-correlated masking
//! (Heitz 2014): what the rough materials share. Light scatters once: what other facets would catch is lost, the more the
//! rougher. GPU twin: kernels/bsdf/ggx.wesl

use super::BsdfValue;
use crate::math::{to_local, to_world};
use crate::sampling::sample_cone;
use crate::scene::compiled::LEAST_ALPHA;
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Width of the distribution of slopes: roughness squared, as glTF and most tools have it.
#[inline]
pub fn alpha_of(roughness: f32) -> f32 {
    (roughness * roughness).max(LEAST_ALPHA)
}

/// Reflectance by Schlick (1994) of a facet that is `f0` head on and white at grazing angles.
#[inline]
pub fn schlick(f0: Vec3, cosine: f32) -> Vec3 {
    let m = (1.0 - cosine).max(0.0);
    f0 + (Vec3::ONE - f0) * (m * m * m * m * m)
}

/// Density of facets, per solid angle and projected area, whose normal is along `middle`, of any length. By way of `middle`'s part
/// along the surface, which narrow distributions keep exact; 1 − cos² would be rounded away.
#[inline]
pub fn ggx_density(normal: Vec3, middle: Vec3, alpha: f32) -> f32 {
    let along_normal = middle.dot(normal);
    let aside = middle - normal * along_normal;
    let stretched = alpha * along_normal;
    let k = alpha * middle.dot(middle) / (aside.dot(aside) + stretched * stretched).max(1e-30);
    k * k * FRAC_1_PI
}

/// √(cos² + α²·sin²): Smith's Λ is (this / cos − 1) / 2.
#[inline]
pub fn smith_root(cosine: f32, alpha: f32) -> f32 {
    let alpha2 = alpha * alpha;
    (alpha2 + (1.0 - alpha2) * cosine * cosine).max(0.0).sqrt()
}

/// Masking and shadowing G₂ over cosθ of the viewer. Both cosines are positive.
#[inline]
pub fn ggx_seen_and_lit(cos_o: f32, cos_i: f32, alpha: f32) -> f32 {
    2.0 * cos_i / (cos_o * smith_root(cos_i, alpha) + cos_i * smith_root(cos_o, alpha))
}

/// Masking G₁ of the viewer over its cosθ: the density of visible facets is this times their cosine times [`ggx_density`].
#[inline]
pub fn ggx_seen(cos_o: f32, alpha: f32) -> f32 {
    2.0 / (cos_o + smith_root(cos_o, alpha))
}

/// A facet's normal, by how much of it the viewer sees, in local coordinates (Heitz 2018): a direction of a spherical cap
/// (Dupuy & Benyoub 2023), which is a cone. Finite for a viewer below the horizon too.
#[inline]
pub fn sample_visible_facet(wo: Vec3, alpha: f32, u: Vec2) -> Vec3 {
    let stretched = Vec3::new(alpha * wo.x, alpha * wo.y, wo.z).normalize();
    let middle = sample_cone(u, 1.0 + stretched.z) + stretched;
    Vec3::new(alpha * middle.x, alpha * middle.y, middle.z.max(1e-12)).normalize()
}

/// The same in the frame of the world.
#[inline]
pub fn ggx_sample_facet(normal: Vec3, wo: Vec3, alpha: f32, u: Vec2) -> Vec3 {
    to_world(sample_visible_facet(to_local(wo, normal), alpha, u), normal)
}

/// Reflection by facets that reflect everything.
#[derive(Clone, Copy, Debug, Default)]
pub struct GgxReflection {
    /// f·cosθ.
    pub value: f32,
    /// Density in sr⁻¹ with which facets that are chosen as seen reflect to there.
    pub pdf: f32,
    /// Cosine between either direction and the facet.
    pub cos_facet: f32,
}

/// 0 unless both directions are above the surface.
#[inline]
pub fn ggx_reflection(normal: Vec3, wo: Vec3, wi: Vec3, alpha: f32) -> GgxReflection {
    let (cos_o, cos_i) = (normal.dot(wo), normal.dot(wi));
    if cos_o.min(cos_i) <= 0.0 {
        return GgxReflection::default();
    }
    let middle = wo + wi;
    let density = 0.25 * ggx_density(normal, middle, alpha);
    GgxReflection {
        value: density * ggx_seen_and_lit(cos_o, cos_i, alpha),
        pdf: density * ggx_seen(cos_o, alpha),
        cos_facet: (0.5 * middle.dot(middle).sqrt()).min(1.0),
    }
}

/// [`ggx_reflection`] tinted by what a facet reflects.
#[inline]
pub fn tinted(lobe: &GgxReflection, f0: Vec3) -> BsdfValue {
    BsdfValue { value: schlick(f0, lobe.cos_facet) * lobe.value, pdf: lobe.pdf }
}
