//! Octants of directions, Bansal's eight actions: their numbers, their shares of a cosine lobe in closed form, and exact
//! sampling of that lobe inside one of them. GPU twin: kernels/guiding/octant.wesl

use crate::random::{SampleKey, Sampler, dimension_guide, sample4};
use crate::sampling::{BELOW_ONE, sample_cosine};
use glam::{Vec2, Vec3, Vec3Swizzles, Vec4, Vec4Swizzles};
use std::f32::consts::{FRAC_1_PI, FRAC_PI_2, FRAC_PI_4};

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

/// ∫ max(0, s·ω) over the octant of positive directions, for a unit vector s with s = (a, b, −w), all of them ≥ 0, in
/// any order of the axes: Lambert's formula for the spherical quadrangle that the horizon leaves of the octant.
fn one_axis_below(a: f32, b: f32, w: f32) -> f32 {
    // The last arc as an arc tangent: its cosine is 1 to rounding where w is small.
    0.5 * (a * b.atan2(w) + b * a.atan2(w) + w.atan2(a * b) - w * FRAC_PI_2)
}

/// Stands for 0 in denominators. Two arcs of [`one_axis_below`] are undefined on GPUs where w and a or b are 0, though their sum is
/// not, and this near it is right.
const LEAST: f32 = 1e-30;

/// The shares of a cosine lobe about the unit vector `normal` that the octants receive: ∫ max(0, cosθ)/π over each. They add up
/// to 1. Closed form: σ·n/4 for the octant that lies above the horizon, Lambert's polygon for those that it cuts.
pub fn octant_shares(normal: Vec3) -> [f32; 8] {
    let n = normal.abs();
    let w = n.max(Vec3::splat(LEAST));
    // Where the normal is an axis nothing is cut; most walls have such normals.
    let polygons = if n.element_sum() > 1.0 {
        Vec3::new(one_axis_below(n.y, n.z, w.x), one_axis_below(n.z, n.x, w.y), one_axis_below(n.x, n.y, w.z))
    } else {
        FRAC_PI_4 * (n.element_sum() - n)
    };
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

/// Draws inside a cut octant before one is taken as it comes.
pub const OCTANT_DRAWS: u32 = 4;

/// The proposal inside an octant: density ∝ Σ max(0, s_i)·|ω_i| over the whole octant, which is the cosine lobe itself
/// where nothing is cut off, and lies above it elsewhere. Strips of the unit square along u.x choose the axis.
fn propose(above: Vec3, signs: Vec3, u: Vec2) -> Vec3 {
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

/// A direction of `octant` with the density [`pdf_in_octant`]. Cut octants take the first of [`OCTANT_DRAWS`] proposals
/// that the horizon accepts, and the last one as it comes; it may lie below the horizon and is then worth nothing.
pub fn sample_in_octant(normal: Vec3, octant: u32, u: Vec2, draws: &Draws) -> Vec3 {
    let signs = octant_signs(octant);
    let s = normal * signs;
    let above = s.max(Vec3::ZERO);
    let mut direction = propose(above, signs, u);
    if s.min_element() >= 0.0 {
        return direction;
    }
    for draw in 1..OCTANT_DRAWS {
        // Whether the horizon accepts, and what to propose else.
        let next = draws.get(draw);
        if next.x * above.dot(direction * signs) < normal.dot(direction) {
            break;
        }
        direction = propose(above, signs, next.yz());
    }
    direction
}

/// Density of [`sample_in_octant`] in sr⁻¹ for a direction in the octant, whose share of the cosine lobe is `share`; it
/// integrates to 1 over the octant.
pub fn pdf_in_octant(normal: Vec3, octant: u32, share: f32, direction: Vec3) -> f32 {
    let s = normal * octant_signs(octant);
    let above = s.max(Vec3::ZERO);
    let cos_theta = normal.dot(direction).max(0.0);
    let whole = 0.25 * above.element_sum();
    if whole <= 0.0 {
        return 0.0;
    }
    if s.min_element() >= 0.0 {
        return cos_theta * FRAC_1_PI / whole;
    }
    // The first three draws are kept with probability `accepted` each; what is left of them is taken as proposed.
    let accepted = (share / whole).min(1.0);
    let rejected = 1.0 - accepted;
    let left = rejected * rejected * rejected;
    let proposal = above.dot(direction.abs()) * FRAC_1_PI / whole;
    (1.0 + rejected + rejected * rejected) * cos_theta * FRAC_1_PI / whole + left * proposal
}
