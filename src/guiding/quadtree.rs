//! Quadtrees over the directions of an octant, in equal-area coordinates: (φ within the octant, |z|). A leaf's density is
//! its probability over its area. GPU twin: kernels/guiding/quadtree.wesl

use super::octant::octant_signs;
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_2_PI, FRAC_PI_2};

/// Levels below an octant at most: leaves of 2π/8 · 4⁻⁷ sr, about half a degree wide.
pub const MAX_DEPTH: u32 = 7;

/// Where a direction lies in its octant: (φ / 90°, |z|), both in [0, 1]; area on the sphere is proportional to area here.
pub fn octant_coordinates(direction: Vec3) -> Vec2 {
    let phi = direction.y.abs().atan2(direction.x.abs().max(1e-30));
    Vec2::new(phi * FRAC_2_PI, direction.z.abs())
}

/// The direction at `p` of an octant, the inverse of [`octant_coordinates`].
pub fn octant_direction(octant: u32, p: Vec2) -> Vec3 {
    let radius = (1.0 - p.y * p.y).max(0.0).sqrt();
    let phi = p.x * FRAC_PI_2;
    Vec3::new(radius * phi.cos(), radius * phi.sin(), p.y) * octant_signs(octant)
}

/// A node: how probability splits among its quarters. 16 bytes, one load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Probability of the half φ < ½.
    pub low_phi: f32,
    /// Probability of |z| < ½ within that half, and within the other.
    pub low_z: [f32; 2],
    /// Quarters that are nodes themselves: a bit each (quarter = φ bit + 2 · z bit), below their first number.
    pub children: u32,
}

impl Node {
    pub fn from_row(row: [u32; 4]) -> Node {
        let [a, b, c] = [row[0], row[1], row[2]].map(f32::from_bits);
        Node { low_phi: a, low_z: [b, c], children: row[3] }
    }

    pub fn row(&self) -> [u32; 4] {
        [self.low_phi.to_bits(), self.low_z[0].to_bits(), self.low_z[1].to_bits(), self.children]
    }

    /// The node in place of a quarter, None if that is a leaf. Child nodes lie next to each other.
    pub fn child(&self, quarter: u32) -> Option<u32> {
        let mask = self.children & 15;
        let before = (mask & ((1 << quarter) - 1)).count_ones();
        (mask >> quarter & 1 == 1).then_some((self.children >> 4) + before)
    }
}

/// The leaf of a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leaf {
    /// The node that it is a quarter of and the quarter: 4 · node + quarter; None if it is the whole octant.
    pub quarter: Option<u32>,
    /// Probability of the leaf within its octant, relative to its share of the octant's area.
    pub density: f32,
}

/// The leaf that a descent ends in, and the point of the octant that it stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Descent {
    pub leaf: Leaf,
    pub point: Vec2,
}

/// Descends from node `root` (None: the octant is one leaf). Where `warped`, `at` is random numbers in [0, 1)², and the point
/// has the density of its leaf; else `at` is the point itself.
pub fn descend(nodes: impl Fn(u32) -> Node, root: Option<u32>, at: Vec2, warped: bool) -> Descent {
    let mut leaf = Leaf { quarter: None, density: 1.0 };
    let (mut rest, mut next) = (at, root);
    let (mut corner, mut size) = (Vec2::ZERO, 1.0);
    for _ in 0..MAX_DEPTH {
        let Some(index) = next else { break };
        let node = nodes(index);
        let (high_phi, x) = choose(rest.x, if warped { node.low_phi } else { 0.5 });
        let low_z = if high_phi { node.low_z[1] } else { node.low_z[0] };
        let (high_z, y) = choose(rest.y, if warped { low_z } else { 0.5 });
        rest = Vec2::new(x, y);
        size *= 0.5;
        corner += Vec2::new(high_phi as u32 as f32, high_z as u32 as f32) * size;
        let quarter = u32::from(high_phi) + 2 * u32::from(high_z);
        let phi = if high_phi { 1.0 - node.low_phi } else { node.low_phi };
        let z = if high_z { 1.0 - low_z } else { low_z };
        leaf = Leaf { quarter: Some(4 * index + quarter), density: leaf.density * 4.0 * phi * z };
        next = node.child(quarter);
    }
    Descent { leaf, point: corner + rest * size }
}

/// Splits [0, 1) at `p`: the part in which `u` lies, and where `u` lies in it. A part of probability 0 is never chosen.
fn choose(u: f32, p: f32) -> (bool, f32) {
    let (high, rest) = if u < p { (false, u / p) } else { (true, (u - p) / (1.0 - p)) };
    (high, rest.min(BELOW_ONE))
}
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;
