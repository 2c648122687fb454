//! Octants of directions, Bansal's eight actions: their numbers, their shares of a cosine lobe in closed form, and proposals
//! that make that lobe inside them. GPU twin: kernels/guiding/octant.wesl

use crate::math::acute_angle;
use crate::random::{SampleKey, Sampler, dimension_guide, sample4};
use crate::sampling::{BELOW_ONE, sample_cosine};
use glam::{Vec2, Vec3, Vec3Swizzles, Vec4};
use std::f32::consts::{FRAC_1_PI, FRAC_PI_2, FRAC_PI_4, PI};

/// Number of the octant in which `direction` lies: bit 0 for x ≤ 0, bit 1 for y ≤ 0, bit 2 for z ≤ 0 (Bansal 2018).
/// Total: −0 counts as 0, and whatever is not ≤ 0 counts as positive.
pub fn octant_of(direction: Vec3) -> u32 {
    u32::from(direction.x <= 0.0) | u32::from(direction.y <= 0.0) << 1 | u32::from(direction.z <= 0.0) << 2
}

/// The signs (±1, ±1, ±1) of the directions in an octant.
pub fn octant_signs(octant: u32) -> Vec3 {
    let sign = |bit: u32| if octant >> bit & 1 == 0 { 1.0 } else { -1.0 };
    Vec3::new(sign(0), sign(1), sign(2))
}

/// ∫ max(0, s·ω) over the octant of positive directions for each of the three vectors s that a unit vector `n`, no component of which
/// is negative and no two are 0, becomes where one component changes its sign: Lambert's formula for the spherical quadrangle that
/// the horizon leaves of the octant. For s = (a, b, −w) that is ½ (a·atan(b/w) + b·atan(a/w) + atan(w/(ab)) − w·π/2).
fn one_axis_below(n: Vec3) -> Vec3 {
    // Six arcs of the planes between two axes, of which two make a quarter turn each, and three along horizons, which make half a
    // turn. As arc tangents: their cosines are 1 to rounding where they are short.
    let arcs = Vec3::new(acute_angle(n.z, n.x), acute_angle(n.x, n.y), acute_angle(n.y, n.z));
    let (x, y) = (acute_angle(n.x, n.y * n.z), acute_angle(n.y, n.z * n.x));
    let along = Vec3::new(x, y, PI - x - y);
    0.5 * (n.yzx() * arcs + n.zxy() * (FRAC_PI_2 - arcs.yzx()) + along - FRAC_PI_2 * n)
}

/// The shares of a cosine lobe about the unit vector `normal` that the octants receive: ∫ max(0, cosθ)/π over each. They add up
/// to 1. Closed form: σ·n/4 for the octant that lies above the horizon, Lambert's polygon for those that it cuts.
pub fn octant_shares(normal: Vec3) -> [f32; 8] {
    let n = normal.abs();
    // Where the normal is an axis nothing is cut; most walls have such normals.
    let whole = FRAC_PI_4 * (n.element_sum() - n);
    let polygons = if n.element_sum() > 1.0 { one_axis_below(n) } else { whole };
    let one_below = (FRAC_1_PI * polygons).max(Vec3::ZERO);
    // ∫ max(0, s·ω) − ∫ max(0, −s·ω) = ∫ s·ω = (π/4) Σ s: two axes below follow from one axis below.
    let one_above = (FRAC_1_PI * polygons + 0.25 * (n - n.yzx() - n.zxy())).max(Vec3::ZERO);
    let shares = [
        0.25 * n.element_sum(),
        one_below.x,
        one_below.y,
        one_above.z,
        one_below.z,
        one_above.y,
        one_above.x,
        0.0,
    ];
    // So far for a normal whose components are positive. Each that is not flips a bit of the octants' numbers.
    let flips = [normal.x, normal.y, normal.z].map(|component| usize::from(component < 0.0));
    let flipped = flips[0] | flips[1] << 1 | flips[2] << 2;
    std::array::from_fn(|octant| shares[octant ^ flipped])
}

/// Where a guided direction's numbers come from: those of one surface of one path.
#[derive(Clone, Copy, Debug)]
pub struct Draws {
    pub sampler: Sampler,
    pub key: SampleKey,
    pub bounce: u32,
}

impl Draws {
    /// Four numbers in [0, 1) for the draw of that number, below 16.
    pub fn get(&self, draw: u32) -> Vec4 {
        sample4(self.sampler, self.key, dimension_guide(self.bounce, draw))
    }
}

/// Stands for 0 in denominators.
pub(super) const LEAST: f32 = 1e-30;

/// What the octants' proposals come to, ∫ Σ max(0, n_i·ω_i)/π over each: its share of the cosine lobe where the horizon does not cut
/// an octant, more elsewhere.
pub fn octant_wholes(normal: Vec3) -> [f32; 8] {
    std::array::from_fn(|octant| {
        let above = (normal * octant_signs(octant as u32)).max(Vec3::ZERO);
        0.25 * (above.x + above.y + above.z)
    })
}

/// A direction in an octant with density Σ max(0, n_i·ω_i)/(π·whole): an axis, then a cosine lobe about it, folded into the octant.
/// Strips of the unit square along u.x choose the axis.
pub fn propose_in_octant(normal: Vec3, octant: u32, u: Vec2) -> Vec3 {
    let signs = octant_signs(octant);
    let above = (normal * signs).max(Vec3::ZERO);
    let at = u.x * above.element_sum();
    let (first, second) = (at < above.x, at < above.x + above.y);
    let (strip, before) = match (first, second) {
        (true, _) => (above.x, 0.0),
        (_, true) => (above.y, above.x),
        _ => (above.z, above.x + above.y),
    };
    let rest = ((at - before) / strip.max(LEAST)).clamp(0.0, BELOW_ONE);
    let c = sample_cosine(Vec2::new(rest, 0.25 * u.y));
    let c = Vec3::new(c.x.abs(), c.y.abs(), c.z);
    let local = match (first, second) {
        (true, _) => c.zxy(),
        (_, true) => c.yzx(),
        _ => c,
    };
    local * signs
}

/// A proposal is kept with probability `kept` / `proposed`, which makes a cosine lobe of it.
#[derive(Clone, Copy, Debug)]
pub struct Acceptance {
    /// n·ω, negative below the horizon.
    pub kept: f32,
    /// Σ max(0, n_i·ω_i); the same, but for roundings on a GPU, where the horizon does not cut the octant.
    pub proposed: f32,
}

pub fn acceptance(normal: Vec3, direction: Vec3) -> Acceptance {
    let terms = normal * direction;
    Acceptance { kept: terms.element_sum(), proposed: terms.max(Vec3::ZERO).element_sum() }
}
