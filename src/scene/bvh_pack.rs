//! Packs nodes of the hierarchy into rows: boxes in bytes, on a grid that the node carries (Ylitie, Karras, Laine 2017, §3.1).

use super::bvh::{COUNT_BIT, INNER_BIT, LEAF, LIST_BIT, NODE_ROWS, WIDTH};
use super::bvh_collapse::{Wide, WideNode};
use super::rows::Row;
use glam::Vec3;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use rayon::prelude::*;

/// How far boxes lie within the grid's lines at least, in extents of their node: more than a walk rounds by. It computes where a
/// ray meets a line as (place of the grid − origin)/direction + line·step/direction, wrong by some roundings of either term: up to
/// 7 · 2⁻²⁴ of twice the extent, beyond those of the sum, which `FAR_SIDE` makes up for.
const MARGIN: f64 = 1.0 / (1 << 19) as f64;

/// A grid of 256 lines along each axis, and between which of them each box lies.
struct Grid {
    origin: Vec3,
    /// Powers of two between lines, as exponents of f32.
    exponents: [u32; 3],
    low: [[u8; WIDTH]; 3],
    high: [[u8; WIDTH]; 3],
}

/// All rows: of the nodes, then lists of the shapes of those nodes whose shapes are not numbered in a row. `numbers` are the
/// shapes' numbers, in the order of the hierarchy.
pub(super) fn packed(tree: &Bvh2, wide: &Wide, numbers: &[u32]) -> Vec<Row> {
    let mut rows = vec![Row::default(); wide.nodes.len() * NODE_ROWS];
    rows.par_chunks_mut(NODE_ROWS).zip(&wide.nodes).for_each(|(rows, node)| {
        rows.copy_from_slice(&packed_node(tree, node, numbers));
    });
    for (i, node) in wide.nodes.iter().enumerate() {
        let shapes = shapes_of(node, numbers);
        if !in_a_row(shapes) {
            let mut list = Row::default();
            for (slot, shape) in (node.inner..).zip(shapes) {
                list[slot] = LEAF | shape;
            }
            rows[i * NODE_ROWS][3] |= LIST_BIT;
            rows[i * NODE_ROWS + 2][3] = rows.len() as u32;
            rows.push(list);
        }
    }
    rows
}

fn shapes_of<'a>(node: &WideNode, numbers: &'a [u32]) -> &'a [u32] {
    &numbers[node.first_shape as usize..][..node.children.len() - node.inner]
}

fn in_a_row(shapes: &[u32]) -> bool {
    shapes.windows(2).all(|pair| pair[1] == pair[0] + 1)
}

fn packed_node(tree: &Bvh2, node: &WideNode, numbers: &[u32]) -> [Row; NODE_ROWS] {
    let boxes: Vec<Aabb> = node.children.iter().map(|&child| tree.nodes[child as usize].aabb).collect();
    let Grid { origin, exponents: [ex, ey, ez], low, high } = grid(&boxes);
    let counts = INNER_BIT * node.inner as u32 + COUNT_BIT * boxes.len() as u32;
    let first_shape = shapes_of(node, numbers).first().copied().unwrap_or_default();
    let [x, y, z] = origin.to_array().map(f32::to_bits);
    let [low_x, low_y, low_z] = low.map(u32::from_le_bytes);
    let [high_x, high_y, high_z] = high.map(u32::from_le_bytes);
    [
        [x, y, z, ex | ey << 8 | ez << 16 | counts],
        [low_x, low_y, low_z, node.first_node],
        [high_x, high_y, high_z, (LEAF | first_shape).wrapping_sub(node.inner as u32)],
    ]
}

fn grid(boxes: &[Aabb]) -> Grid {
    let around = boxes.iter().fold(Aabb::INVALID, |all, b| all.union(b));
    let (low, high) = ([[0; WIDTH]; 3], [[0; WIDTH]; 3]);
    let mut grid = Grid { origin: Vec3::ZERO, exponents: [0; 3], low, high };
    for k in 0..3 {
        let [low, high] = [around.min, around.max].map(|corner| f64::from(corner[k]));
        let margin = (high - low) * MARGIN;
        let origin = not_above(low - margin);
        let exponent = exponent((high + margin - f64::from(origin)) / 255.0);
        let step = f64::from(f32::from_bits(exponent << 23));
        (grid.origin[k], grid.exponents[k]) = (origin, exponent);
        for (i, b) in boxes.iter().enumerate() {
            let line = |x: f64| (x - f64::from(origin)) / step;
            grid.low[k][i] = line(f64::from(b.min[k]) - margin).floor() as u8;
            grid.high[k][i] = line(f64::from(b.max[k]) + margin).ceil() as u8;
        }
    }
    grid
}

/// The greatest f32 that is not above x.
fn not_above(x: f64) -> f32 {
    let nearest = x as f32;
    if f64::from(nearest) > x { nearest.next_down() } else { nearest }
}

/// The exponent, as f32 keeps it, of the least power of two that is not below `step`.
fn exponent(step: f64) -> u32 {
    let below = ((step as f32).to_bits() >> 23).clamp(1, 253);
    below + u32::from(f64::from(f32::from_bits(below << 23)) < step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3A;

    /// Lines lie outside of their boxes by the margin, near the origin and far from it, for flat and for tiny boxes.
    #[test]
    fn grids_hold_their_boxes() {
        for (place, size) in [(0.0, 1.0), (1e6, 10.0), (-3.0, 1e-6), (1e-20, 1e-22), (5e8, 1e9)] {
            let corner = |i: usize, k: usize| place + size * (((i * 3 + k) * 7919 % 97) as f32 / 97.0);
            let boxes: Vec<Aabb> = (0..WIDTH)
                .map(|i| {
                    let min: [f32; 3] = std::array::from_fn(|k| corner(i, k));
                    let max = Vec3A::from_array(min) + Vec3A::new(size, 0.0, size * 1e-3);
                    Aabb { min: min.into(), max }
                })
                .collect();
            let grid = grid(&boxes);
            for (i, b) in boxes.iter().enumerate() {
                for k in 0..3 {
                    let step = f64::from(f32::from_bits(grid.exponents[k] << 23));
                    let at = |line: u8| f64::from(grid.origin[k]) + f64::from(line) * step;
                    let (low, high) = (at(grid.low[k][i]), at(grid.high[k][i]));
                    let [least, most] = [b.min[k], b.max[k]].map(f64::from);
                    assert!(low <= least && most <= high, "{place} {size}: {low} {least} {most} {high}");
                    let loose = 2.0 * step + (least.abs() + most.abs()) * 1.3e-7;
                    assert!(low >= least - loose && high <= most + loose, "{place} {size}: too large");
                }
            }
        }
    }
}
