//! Reflection and refraction in f64.

use glam::{DVec3, Vec3};
use std::f64::consts::TAU;

/// Unpolarised Fresnel reflectance from the sine and tangent laws, which the program does not use.
pub fn fresnel(theta_i: f64, eta: f64) -> f64 {
    let sin_t = theta_i.sin() / eta;
    if sin_t >= 1.0 {
        return 1.0;
    }
    if theta_i < 1e-9 {
        return ((eta - 1.0) / (eta + 1.0)).powi(2);
    }
    let theta_t = sin_t.asin();
    let s = ((theta_i - theta_t).sin() / (theta_i + theta_t).sin()).powi(2);
    let p = ((theta_i - theta_t).tan() / (theta_i + theta_t).tan()).powi(2);
    0.5 * (s + p)
}

/// cos² of the refracted angle; negative beyond the critical angle.
pub fn cos2_refracted(cos_i: f64, eta: f64) -> f64 {
    ((eta - 1.0) * (eta + 1.0) + cos_i * cos_i) / (eta * eta)
}

/// The same reflectance from cosines, which keeps its digits where light grazes and where η goes to 1.
pub fn fresnel_by_cosines(cos_i: f64, eta: f64) -> f64 {
    let cos2_t = cos2_refracted(cos_i, eta);
    if cos2_t <= 0.0 {
        return 1.0;
    }
    let cos_t = cos2_t.sqrt();
    let parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    let perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    0.5 * (parallel * parallel + perpendicular * perpendicular)
}

/// Density of a Phong lobe at 1 − cosα, in sr⁻¹.
pub fn phong(one_minus_cos: f64, exponent: f64) -> f64 {
    if one_minus_cos >= 1.0 {
        return 0.0;
    }
    (exponent + 1.0) / TAU * (exponent * (-one_minus_cos).ln_1p()).exp()
}

/// Density of the lobe that is folded at the horizon, for unit vectors that are so to rounding; and what their rounding does
/// to it, relative, in roundings: 1 − cosα of a direction has √2·√(1 − cosα) times the direction's own.
pub fn glossy(exponent: f64, [normal, wo, wi]: [Vec3; 3]) -> (f64, f64) {
    let [normal, wo, wi] = [normal, wo, wi].map(|v| v.as_dvec3().normalize());
    let mirrored = |d: DVec3| d - normal * (2.0 * d.dot(normal));
    let axis = mirrored(-wo);
    let lobe = |d: DVec3| {
        let x = 0.5 * (axis - d).length_squared();
        let steepness = exponent * (2.0 * x).sqrt() / (1.0 - x).max(1e-6);
        (phong(x, exponent), 2.0 + exponent * x + steepness)
    };
    let [(p, a), (q, b)] = [lobe(wi), lobe(mirrored(wi))];
    (p + q, (p * a + q * b) / (p + q))
}
