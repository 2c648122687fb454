//! Quadtrees over the directions of an octant, in equal-area coordinates: (φ within the octant, |z|), and how their leaves
//! lie in the table. A leaf's probability is a whole number of its cell's *tickets*, so a direction is drawn by one look at
//! a ticket, and the leaf of a direction is found on a *map*, four by four squares at a time.
//! GPU twin: kernels/guiding/quadtree.wesl

use super::octant::octant_signs;
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_2_PI, FRAC_PI_2};

/// Levels below an octant at most: leaves of 2π/8 · 4⁻⁷ sr, about half a degree wide.
pub const MAX_DEPTH: u32 = 7;
/// Bits of a word that count tickets.
pub const TICKET_BITS: u32 = 12;
/// Bits of a word of the map that number the leaf in its cell.
pub const LEAF_BITS: u32 = 16;
/// Squares of a block of the map: four by four.
pub const BLOCK_WORDS: u32 = 16;
/// Marks a word of the map that leads to the block in place of its square.
pub const FINER_BLOCK: u32 = 1 << 31;
/// Blocks from an octant down to its finest leaves.
pub const MAP_LEVELS: u32 = 4;

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

/// 2⁻ⁿ, exactly, for n up to 126.
fn inverse_power(n: u32) -> f32 {
    f32::from_bits((127 - n) << 23)
}

/// Density in sr⁻¹ of a leaf in a cell of 2^`log_tickets` tickets: its share of them over its solid angle, π/2 · 4^−depth.
/// `leaf` is a word of the map or a ticket: tickets, then depth.
pub fn leaf_density(leaf: u32, log_tickets: u32) -> f32 {
    let tickets = leaf & ((1 << TICKET_BITS) - 1);
    (tickets << (2 * leaf_depth(leaf))) as f32 * inverse_power(log_tickets) * FRAC_2_PI
}

/// A ticket: a leaf's tickets and depth, its place on the grid of squares of its size, its octant.
pub fn ticket(tickets: u32, depth: u32, [x, y]: [u32; 2], octant: u32) -> u32 {
    tickets | depth << TICKET_BITS | x << 15 | y << 22 | octant << 29
}

/// A word of the map: a leaf's tickets and depth, its number in the cell.
pub fn map_word(tickets: u32, depth: u32, number: u32) -> u32 {
    tickets | depth << TICKET_BITS | number << (TICKET_BITS + 3)
}

/// The number of the leaf in its cell that a word of the map tells: octants first, then the quarters of nodes.
pub fn leaf_number(leaf: u32) -> u32 {
    leaf >> (TICKET_BITS + 3) & ((1 << LEAF_BITS) - 1)
}

/// How deep the leaf of a ticket, or of a word of the map, lies.
pub fn leaf_depth(ticket: u32) -> u32 {
    ticket >> TICKET_BITS & 7
}

/// The direction of a ticket at `rest` of its leaf, [0, 1)².
pub fn ticket_direction(ticket: u32, rest: Vec2) -> Vec3 {
    let corner = Vec2::new((ticket >> 15 & 127) as f32, (ticket >> 22 & 127) as f32);
    octant_direction(ticket >> 29, (corner + rest) * inverse_power(leaf_depth(ticket)))
}

/// The word of the map with the leaf of the point `p` of an octant. `map` is the first word of the cell's map, where each
/// octant has a block, and from where blocks are counted; `word` reads one.
pub fn find_leaf(word: impl Fn(u32) -> u32, map: u32, octant: u32, p: Vec2) -> u32 {
    let x = ((p.x * 256.0) as u32).min(255);
    let y = ((p.y * 256.0) as u32).min(255);
    let mut block = BLOCK_WORDS * octant;
    let mut leaf = 0;
    for level in 0..MAP_LEVELS {
        let shift = 6 - 2 * level;
        leaf = word(map + block + (x >> shift & 3) + 4 * (y >> shift & 3));
        if leaf & FINER_BLOCK == 0 {
            break;
        }
        block = BLOCK_WORDS * (leaf & !FINER_BLOCK);
    }
    leaf
}
