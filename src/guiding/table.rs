//! The table that guides paths: cells on surfaces, found by position and normal, each with its learnt distribution over
//! directions. Flat rows of four words, the same on the CPU and on the GPU. GPU twin: kernels/guiding/table.wesl

use super::octant::{Draws, octant_of, octant_share, pdf_in_octant, sample_in_octant};
use super::quadtree::{Leaf, Node, descend, octant_coordinates, octant_direction};
use crate::gpu_struct;
use glam::{Vec2, Vec3, Vec4};
use std::f32::consts::{FRAC_1_PI, FRAC_2_PI};

gpu_struct! {
    /// Numbers of the guide for one pass; a storage buffer (docs/DECISIONS.md).
    pub struct GuideUniforms {
        /// Lower corner of the grid of base cells.
        origin: Vec3,
        /// Base cells per unit of length.
        inverse_size: f32,
        /// Base cells along each axis.
        cells_x: u32,
        cells_y: u32,
        cells_z: u32,
        /// Sectors of the normal: 6, or 1 for none.
        sectors: u32,
        /// Row of the first cell; before it lies the index, four words a row.
        cells_at: u32,
        /// Row of the first quadtree node.
        nodes_at: u32,
        /// Row of the pixels' estimates, four to a row.
        pixels_at: u32,
        cell_count: u32,
        /// Quadtree nodes.
        node_count: u32,
        /// Fixed-point units per unit of radiance.
        unit: f32,
        /// Share of guided directions where the guide is trusted, below 1.
        mixture: f32,
        /// How far a look-up moves off the surface, so that a wall between two layers of cells lies in one.
        lift: f32,
        /// Bansal's rule: octants below this share of the largest Q are drawn again.
        threshold: f32,
        /// Bansal's rule: what is left of the best Q of the next surface.
        discount: f32,
        /// 1 while transitions are collected. For the CPU engine: on a GPU, other kernels are linked.
        learning: u32,
        /// What a pass leaves of what was known. Adaptive, octant: the share of its weight. Bansal's rule: −ln(1 − α), by
        /// whose multiples visits forget.
        memory: f32,
    }
}

/// Rows of a cell.
pub const CELL_ROWS: u32 = 3;
/// Marks a word of the index that leads to eight finer words.
pub const FINER: u32 = 1 << 31;
/// No cell has been made here yet.
pub const NO_CELL: u32 = u32::MAX;
/// Levels of cells below the base grid.
pub const MAX_CELL_LEVELS: u32 = 6;

/// Sector of a normal: its largest component, and that one's sign.
pub fn normal_sector(normal: Vec3) -> u32 {
    let a = normal.abs();
    let (axis, value) = if a.x >= a.y && a.x >= a.z {
        (0, normal.x)
    } else if a.y >= a.z {
        (1, normal.y)
    } else {
        (2, normal.z)
    };
    2 * axis + u32::from(value < 0.0)
}

/// A look-up's result: what the position has to do with the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellPlace {
    /// Number of the cell, [`NO_CELL`] if none exists.
    pub cell: u32,
    /// Number of the base cell and sector: where a missing cell is counted.
    pub base: u32,
    /// Which eighth of the cell: where it would be cut.
    pub eighth: u32,
}

impl GuideUniforms {
    /// Words of the index that belong to the base grid.
    pub fn base_words(&self) -> u32 {
        self.cells_x * self.cells_y * self.cells_z * self.sectors
    }
}

/// The table as it is uploaded, with its numbers.
#[derive(Clone, Debug, Default)]
pub struct GuideTable {
    pub uniforms: GuideUniforms,
    pub rows: Vec<[u32; 4]>,
}

/// A cell's learnt distribution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    pub index: u32,
    /// Adaptive: probability of each octant. Octant and Bansal: mean radiance that arrives through it.
    pub octants: [f32; 8],
    /// Quadtree roots: a bit per octant that has one, below the number of the first.
    pub roots: u32,
    /// Irradiance of what direct light does not account for; octant and Bansal: ΣQ, which nothing but trust depends on.
    pub irradiance: f32,
    /// Share of guided directions, relative to the table's; 0 before the cell has learnt.
    pub trust: f32,
}

impl Cell {
    /// The root node of an octant's quadtree, None if the octant is one leaf.
    fn root(&self, octant: u32) -> Option<u32> {
        let mask = self.roots & 255;
        let before = (mask & ((1 << octant) - 1)).count_ones();
        (mask >> octant & 1 == 1).then_some((self.roots >> 8) + before)
    }

    pub fn rows(&self) -> [[u32; 4]; CELL_ROWS as usize] {
        let bits = |values: &[f32]| std::array::from_fn(|i| values[i].to_bits());
        let last = [self.roots, self.irradiance.to_bits(), self.trust.to_bits(), 0];
        [bits(&self.octants[..4]), bits(&self.octants[4..]), last]
    }
}

/// Position in units of cells, put into the grid; whatever it is, it ends up inside.
fn grid_position(uniforms: &GuideUniforms, position: Vec3) -> Vec3 {
    let size = Vec3::new(uniforms.cells_x as f32, uniforms.cells_y as f32, uniforms.cells_z as f32);
    ((position - uniforms.origin) * uniforms.inverse_size).clamp(Vec3::ZERO, size)
}

impl GuideTable {
    fn word(&self, index: u32) -> u32 {
        self.rows[(index / 4) as usize][(index % 4) as usize]
    }

    /// The cell at a surface point. Total: positions outside belong to the cells at the border.
    pub fn place(&self, position: Vec3, normal: Vec3) -> CellPlace {
        let u = &self.uniforms;
        let p = grid_position(u, position + normal * u.lift);
        let x = (p.x as u32).min(u.cells_x - 1);
        let y = (p.y as u32).min(u.cells_y - 1);
        let z = (p.z as u32).min(u.cells_z - 1);
        let sector = if u.sectors > 1 { normal_sector(normal) } else { 0 };
        let base = ((z * u.cells_y + y) * u.cells_x + x) * u.sectors + sector;
        let mut inside = p - Vec3::new(x as f32, y as f32, z as f32);
        let mut eighth = next_eighth(&mut inside);
        let mut word = self.word(base);
        for _ in 0..MAX_CELL_LEVELS {
            if word == NO_CELL || word & FINER == 0 {
                break;
            }
            word = self.word((word & !FINER) + eighth);
            eighth = next_eighth(&mut inside);
        }
        CellPlace { cell: word, base, eighth }
    }

    pub fn cell(&self, index: u32) -> Cell {
        let at = (self.uniforms.cells_at + CELL_ROWS * index) as usize;
        let [low, high, last] = [self.rows[at], self.rows[at + 1], self.rows[at + 2]];
        let float = |i: usize| f32::from_bits(if i < 4 { low[i] } else { high[i - 4] });
        Cell {
            index,
            octants: std::array::from_fn(float),
            roots: last[0],
            irradiance: f32::from_bits(last[1]),
            trust: f32::from_bits(last[2]),
        }
    }

    pub fn node(&self, index: u32) -> Node {
        Node::from_row(self.rows[(self.uniforms.nodes_at + index) as usize])
    }

    /// The learnt estimate of a pixel's radiance, 0 before there is one.
    pub fn pixel_estimate(&self, pixel: u32) -> f32 {
        f32::from_bits(self.word(4 * self.uniforms.pixels_at + pixel))
    }

    /// Where what arrives from `direction` is added up: a slot of the sums.
    fn slot(&self, cell: u32, octant: u32, leaf: &Leaf) -> u32 {
        leaf.quarter.map_or(8 * cell + octant, |quarter| 8 * self.uniforms.cell_count + quarter)
    }
}

/// Which eighth of its cell `inside` (0..1 along each axis) lies in; `inside` becomes the position in that eighth.
fn next_eighth(inside: &mut Vec3) -> u32 {
    let p = *inside * 2.0;
    let (x, y, z) = (p.x >= 1.0, p.y >= 1.0, p.z >= 1.0);
    *inside = p - Vec3::new(x as u32 as f32, y as u32 as f32, z as u32 as f32);
    u32::from(x) + 2 * u32::from(y) + 4 * u32::from(z)
}

/// A direction as the table sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GuidedDensity {
    /// Density in sr⁻¹.
    pub pdf: f32,
    /// Where what arrives from there is added up.
    pub slot: u32,
}

/// Octant-rooted quadtrees: the adaptive guide.
pub mod adaptive {
    use super::*;

    fn leaf_density(table: &GuideTable, cell: &Cell, octant: u32, leaf: &Leaf) -> GuidedDensity {
        GuidedDensity {
            pdf: cell.octants[octant as usize] * FRAC_2_PI * leaf.density,
            slot: table.slot(cell.index, octant, leaf),
        }
    }

    /// Density and slot of `direction`.
    pub fn density(table: &GuideTable, cell: &Cell, direction: Vec3) -> GuidedDensity {
        let octant = octant_of(direction);
        let found = descend(|i| table.node(i), cell.root(octant), octant_coordinates(direction), false);
        leaf_density(table, cell, octant, &found.leaf)
    }

    /// A direction with that density, and what the table says of it. `choice` picks the octant.
    pub fn sample(table: &GuideTable, cell: &Cell, choice: f32, u: Vec2) -> (Vec3, GuidedDensity) {
        let (octant, _) = choose_octant(&cell.octants, 1.0, choice);
        let found = descend(|i| table.node(i), cell.root(octant), u, true);
        (octant_direction(octant, found.point), leaf_density(table, cell, octant, &found.leaf))
    }
}

/// Eight octants with the cosine: the octant guide.
pub mod octants {
    use super::*;

    /// Σ Q_a·F_a: the mean radiance weighted by the cosine, whose product with the albedo is what the surface sends back.
    pub fn mean_radiance(cell: &Cell, shares: &[f32; 8]) -> f32 {
        (0..8).map(|a| cell.octants[a] * shares[a]).sum()
    }

    /// Density and slot of `direction`: cosθ/π · Q_a / ΣQF wherever the octant is not cut by the horizon.
    pub fn density(
        cell: &Cell,
        normal: Vec3,
        shares: &[f32; 8],
        mean: f32,
        direction: Vec3,
    ) -> GuidedDensity {
        let octant = octant_of(direction);
        let slot = 8 * cell.index + octant;
        if mean <= 0.0 {
            return GuidedDensity { pdf: 0.0, slot };
        }
        let share = shares[octant as usize];
        let probability = cell.octants[octant as usize] * share / mean;
        GuidedDensity { pdf: probability * pdf_in_octant(normal, octant, share, direction), slot }
    }

    /// A direction with that density. `u`: acceptance, two for the direction, choice of the octant.
    pub fn sample(cell: &Cell, normal: Vec3, shares: &[f32; 8], mean: f32, u: Vec4, draws: &Draws) -> Vec3 {
        let weights: [f32; 8] = std::array::from_fn(|a| cell.octants[a] * shares[a]);
        let (octant, rest) = choose_octant(&weights, mean, u.w);
        sample_in_octant(normal, octant, Vec4::new(u.x, u.y, u.z, rest), draws)
    }
}

/// The octant at `choice` of the distribution `weights` / `total`, and where in it `choice` lies, in [0, 1).
fn choose_octant(weights: &[f32; 8], total: f32, choice: f32) -> (u32, f32) {
    let target = choice * total;
    let (mut octant, mut below, mut weight) = (0, 0.0, 1.0);
    let mut sum = 0.0;
    for (a, &w) in weights.iter().enumerate() {
        if w > 0.0 && target >= sum {
            (octant, below, weight) = (a as u32, sum, w);
        }
        sum += w;
    }
    (octant, ((target - below) / weight).clamp(0.0, 0.999_999_94))
}

/// Bansal's redraw rule: cosine directions, drawn again until one lies in an octant whose Q is above a share of the
/// largest.
pub mod bansal {
    use super::*;

    /// Draws at most.
    pub const DRAWS: u32 = 8;

    /// The best Q of a cell.
    pub fn best(cell: &Cell) -> f32 {
        cell.octants.iter().fold(0.0, |best, &q| best.max(q))
    }

    /// Whether the rule keeps a direction in this octant.
    pub fn accepts(cell: &Cell, threshold: f32, octant: u32) -> bool {
        cell.octants[octant as usize] > threshold * best(cell)
    }

    /// The density of the rule, which Bansal left out: with p = Σ F over accepted octants, cosθ/π · (1 − (1 − p)⁸)/p in
    /// them and cosθ/π · (1 − p)⁷ elsewhere.
    pub fn pdf(cell: &Cell, threshold: f32, normal: Vec3, direction: Vec3) -> f32 {
        let accepted = |octant: u32| accepts(cell, threshold, octant);
        let p: f32 = (0..8).filter(|&a| accepted(a)).map(|a| octant_share(normal, a)).sum::<f32>().min(1.0);
        let cosine = normal.dot(direction).max(0.0) * FRAC_1_PI;
        let rejected = 1.0 - p;
        let (two, four) = (rejected * rejected, rejected * rejected * rejected * rejected);
        if accepted(octant_of(direction)) {
            // (1 − r⁸)/(1 − r) without the cancellation.
            cosine * (1.0 + rejected) * (1.0 + two) * (1.0 + four)
        } else {
            cosine * rejected * two * four
        }
    }
}
