//! Rough materials in f64, as their papers write them: Walter et al. 2007 with tangents and half vectors, Smith's Λ after Heitz
//! 2014, Schlick 1994. The surface's normal is +z, and the viewer is above.

use super::bsdf::fresnel_by_cosines;
use glam::{DVec2, DVec3};
use std::f64::consts::{FRAC_1_PI, PI, TAU};

/// What a rough material is, after the program has made α of its roughness.
#[derive(Clone, Copy, Debug)]
pub enum Rough {
    Metal,
    /// By how much it is metal.
    Coated(f64),
    /// Index of refraction beyond the surface over that on the viewer's side.
    Glass(f64),
}

/// Its f·cosθ and its density, both for one channel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Answer {
    pub value: f64,
    pub pdf: f64,
}

/// Walter's equation 33.
fn distribution(m: DVec3, alpha: f64) -> f64 {
    if m.z <= 0.0 {
        return 0.0;
    }
    let tan2 = (m.x * m.x + m.y * m.y) / (m.z * m.z);
    alpha * alpha / (PI * m.z.powi(4) * (alpha * alpha + tan2).powi(2))
}

fn lambda(v: DVec3, alpha: f64) -> f64 {
    let tan2 = (v.x * v.x + v.y * v.y) / (v.z * v.z);
    ((1.0 + alpha * alpha * tan2).sqrt() - 1.0) / 2.0
}

fn masking(v: DVec3, alpha: f64) -> f64 {
    1.0 / (1.0 + lambda(v, alpha))
}

fn both_masked(a: DVec3, b: DVec3, alpha: f64) -> f64 {
    1.0 / (1.0 + lambda(a, alpha) + lambda(b, alpha))
}

pub fn schlick(f0: f64, cos: f64) -> f64 {
    f0 + (1.0 - f0) * (1.0 - cos).max(0.0).powi(5)
}

/// Density of facets as the viewer sees them.
fn visible(o: DVec3, m: DVec3, alpha: f64) -> f64 {
    masking(o, alpha) * o.dot(m).max(0.0) * distribution(m, alpha) / o.z
}

/// Facets that reflect everything, and the cosine at them.
fn mirror_facets(o: DVec3, i: DVec3, alpha: f64) -> (Answer, f64) {
    if i.z <= 0.0 {
        return (Answer::default(), 1.0);
    }
    let m = (o + i).normalize();
    let value = distribution(m, alpha) * both_masked(o, i, alpha) / (4.0 * o.z * i.z) * i.z;
    (Answer { value, pdf: visible(o, m, alpha) / (4.0 * o.dot(m)) }, o.dot(m))
}

/// Walter's equations 16, 17, 21 with i where light comes from: radiance, so squeezed by eta².
fn through(o: DVec3, i: DVec3, alpha: f64, eta: f64) -> Answer {
    let m = -(o + eta * i).normalize() * (eta - 1.0).signum();
    let (om, im) = (o.dot(m), i.dot(m));
    if om <= 0.0 || im >= 0.0 || m.z <= 0.0 || i.z >= 0.0 {
        return Answer::default();
    }
    let transmitted = 1.0 - fresnel_by_cosines(om, eta);
    let jacobian = eta * eta * im.abs() / (om + eta * im).powi(2);
    let below = DVec3::new(i.x, i.y, -i.z);
    let f = om * im.abs() / (o.z * i.z.abs())
        * transmitted
        * both_masked(o, below, alpha)
        * distribution(m, alpha)
        / (om + eta * im).powi(2);
    Answer { value: f * i.z.abs(), pdf: transmitted * visible(o, m, alpha) * jacobian }
}

const COAT: f64 = 0.04;
/// What the program divides by so that nothing is gained.
const THROUGH_COAT: f64 = 0.916;

/// Chance with which the program chooses the coat, for the colour of that luminance.
fn coat_share(metallic: f64, luminance: f64, cos: f64) -> f64 {
    let reflected = schlick(COAT * (1.0 - metallic) + luminance * metallic, cos);
    let scattered = luminance * (1.0 - metallic) * (1.0 - schlick(COAT, cos));
    if scattered > 0.0 { reflected / (reflected + scattered) } else { 1.0 }
}

impl Rough {
    /// Of a channel with this colour, of a material of that luminance.
    pub fn evaluate(self, [color, luminance]: [f64; 2], alpha: f64, o: DVec3, i: DVec3) -> Answer {
        let (facets, cos) = mirror_facets(o, i, alpha);
        match self {
            Rough::Metal => Answer { value: facets.value * schlick(color, cos), pdf: facets.pdf },
            Rough::Coated(metallic) => {
                let f0 = COAT * (1.0 - metallic) + color * metallic;
                let base = color * (1.0 - metallic) * (1.0 - schlick(COAT, o.z)) * (1.0 - schlick(COAT, i.z))
                    / THROUGH_COAT;
                let cosine = i.z.max(0.0) * FRAC_1_PI;
                let share = coat_share(metallic, luminance, o.z);
                Answer {
                    value: facets.value * schlick(f0, cos) + base * cosine,
                    pdf: share * facets.pdf + (1.0 - share) * cosine,
                }
            }
            Rough::Glass(eta) if i.z < 0.0 => {
                let Answer { value, pdf } = through(o, i, alpha, eta);
                Answer { value: color * value, pdf }
            }
            Rough::Glass(eta) => {
                let share = fresnel_by_cosines(cos, eta);
                Answer { value: color * share * facets.value, pdf: share * facets.pdf }
            }
        }
    }

    /// The share of light from everywhere that comes back to the viewer, without the squeezing of radiance in glass: by
    /// midpoints over the facets that the viewer sees, which fill a hemisphere evenly but for a cosine if α is 1.
    pub fn albedo(self, color: f64, alpha: f64, o: DVec3) -> f64 {
        let mean = facets_seen(o, alpha, |m| {
            let cos = o.dot(m);
            let i = 2.0 * cos * m - o;
            let reflected = outlives(o, i, alpha);
            match self {
                Rough::Metal => reflected * schlick(color, cos),
                Rough::Coated(metallic) => {
                    reflected * schlick(COAT * (1.0 - metallic) + color * metallic, cos)
                }
                Rough::Glass(eta) => {
                    let f = fresnel_by_cosines(cos, eta);
                    let cos_t = super::bsdf::cos2_refracted(cos, eta).max(0.0).sqrt();
                    let i = (cos / eta - cos_t) * m - o / eta;
                    color * (f * reflected + (1.0 - f) * outlives(o, DVec3::new(i.x, i.y, -i.z), alpha))
                }
            }
        });
        let Rough::Coated(metallic) = self else { return mean };
        let all_angles = (1.0 - COAT) * (1.0 - 2.0 / 42.0);
        mean + color * (1.0 - metallic) * (1.0 - schlick(COAT, o.z)) * all_angles / THROUGH_COAT
    }
}

/// Share of what a seen facet sends to `i` that other facets do not catch; none below the horizon.
fn outlives(o: DVec3, i: DVec3, alpha: f64) -> f64 {
    if i.z <= 0.0 { 0.0 } else { both_masked(o, i, alpha) / masking(o, alpha) }
}

/// Mean over the facets that the viewer sees.
fn facets_seen(o: DVec3, alpha: f64, of: impl Fn(DVec3) -> f64) -> f64 {
    const FINE: usize = 400;
    let w = DVec3::new(alpha * o.x, alpha * o.y, o.z).normalize();
    let (mut sum, mut weights) = (0.0, 0.0);
    for row in 0..FINE {
        for column in 0..FINE {
            let z = (row as f64 + 0.5) / FINE as f64;
            let phi = TAU * (column as f64 + 0.5) / FINE as f64;
            let r = (1.0 - z * z).sqrt();
            let stretched = DVec3::new(r * phi.cos(), r * phi.sin(), z);
            let weight = w.dot(stretched).max(0.0);
            if weight > 0.0 {
                sum += weight * of(DVec3::new(alpha * stretched.x, alpha * stretched.y, z).normalize());
                weights += weight;
            }
        }
    }
    sum / weights
}

/// The facet that reflects one direction to the other, as if α were 1.
pub fn stretched_facet(o: DVec3, i: DVec3, alpha: f64) -> DVec3 {
    let m = o + i;
    DVec3::new(m.x / alpha, m.y / alpha, m.z).normalize()
}

/// Density of [`stretched_facet`] of what the viewer sees.
pub fn stretched_density(o: DVec3, alpha: f64, m: DVec3) -> f64 {
    let w = DVec3::new(alpha * o.x, alpha * o.y, o.z).normalize();
    2.0 * w.dot(m).max(0.0) / (PI * (1.0 + w.z))
}

/// A direction above the surface.
pub fn above(cos: f64, phi: f64) -> DVec3 {
    let across = DVec2::from_angle(phi) * (1.0 - cos * cos).sqrt();
    across.extend(cos)
}
