//! The table that guides paths: cells on surfaces, found by position and normal, each with its learnt distribution over
//! directions. Flat rows of four words, the same on the CPU and on the GPU. GPU twin: kernels/guiding/table.wesl

use super::octant::{LEAST, octant_of, octant_shares, octant_wholes, propose_in_octant};
use super::quadtree::{find_leaf, leaf_density, leaf_number, octant_coordinates, ticket_direction};
use crate::gpu_struct;
use crate::sampling::BELOW_ONE;
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

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
        /// Row of the first word that a cell has learnt; before it lies the index.
        words_at: u32,
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
        _pad0: u32,
    }
}

/// Marks a row of the index that leads to eight finer rows.
pub const FINER: u32 = 1 << 31;
/// Bits of a row of the index that number its cell.
pub const CELL_BITS: u32 = 24;
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
    /// Row of the index that tells of the cell.
    pub row: u32,
}

impl GuideUniforms {
    /// Rows of the index that belong to the base grid.
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
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cell {
    pub index: u32,
    /// Its first word in the table. Adaptive: of its tickets; behind them lies the map of its leaves, before them the slot
    /// of its first leaf below an octant.
    pub at: u32,
    /// Adaptive: it has 2^log_tickets tickets.
    pub log_tickets: u32,
    /// Octant and Bansal: mean radiance that arrives through each octant.
    pub octants: [f32; 8],
    /// Irradiance of what direct light does not account for; octant and Bansal: ΣQ, which nothing but trust depends on.
    pub irradiance: f32,
    /// Share of guided directions, relative to the table's; 0 before the cell has learnt.
    pub trust: f32,
}

impl Cell {
    /// As the index tells of it.
    pub fn row(&self) -> [u32; 4] {
        let number = self.index | self.log_tickets << CELL_BITS;
        [self.at, number, self.irradiance.to_bits(), self.trust.to_bits()]
    }
}

/// Position in units of cells, put into the grid; whatever it is, it ends up inside.
fn grid_position(uniforms: &GuideUniforms, position: Vec3) -> Vec3 {
    let size = Vec3::new(uniforms.cells_x as f32, uniforms.cells_y as f32, uniforms.cells_z as f32);
    ((position - uniforms.origin) * uniforms.inverse_size).clamp(Vec3::ZERO, size)
}

impl GuideTable {
    /// Word `index` of those from row `first` on.
    #[inline]
    fn word_from(&self, first: u32, index: u32) -> u32 {
        self.rows.as_flattened()[(4 * first + index) as usize]
    }

    /// Word `index` of what the cells have learnt.
    #[inline]
    pub fn table_word(&self, index: u32) -> u32 {
        self.word_from(self.uniforms.words_at, index)
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
        let (mut row, [mut first, mut number, ..]) = (base, self.rows[base as usize]);
        for _ in 0..MAX_CELL_LEVELS {
            if number == NO_CELL || number & FINER == 0 {
                break;
            }
            row = first + eighth;
            [first, number, ..] = self.rows[row as usize];
            eighth = next_eighth(&mut inside);
        }
        let cell = if number == NO_CELL { NO_CELL } else { number & ((1 << CELL_BITS) - 1) };
        CellPlace { cell, base, eighth, row }
    }

    /// The cell that a row of the index tells of.
    pub fn cell(&self, row: u32) -> Cell {
        let [at, number, irradiance, trust] = self.rows[row as usize];
        let octants = match self.uniforms.sectors {
            1 => std::array::from_fn(|a| f32::from_bits(self.table_word(at + a as u32))),
            _ => [0.0; 8],
        };
        Cell {
            index: number & ((1 << CELL_BITS) - 1),
            at,
            log_tickets: number >> CELL_BITS,
            octants,
            irradiance: f32::from_bits(irradiance),
            trust: f32::from_bits(trust),
        }
    }

    /// All cells, in the order of their numbers.
    pub fn cells(&self) -> Vec<Cell> {
        let mut row_of = vec![NO_CELL; self.uniforms.cell_count as usize];
        for (row, [_, number, ..]) in (0..).zip(&self.rows[..self.uniforms.words_at as usize]) {
            if number & FINER == 0 {
                row_of[(number & ((1 << CELL_BITS) - 1)) as usize] = row;
            }
        }
        row_of.into_iter().map(|row| self.cell(row)).collect()
    }

    /// The learnt estimate of a pixel's radiance, 0 before there is one.
    pub fn pixel_estimate(&self, pixel: u32) -> f32 {
        f32::from_bits(self.word_from(self.uniforms.pixels_at, pixel))
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

    /// Density of `direction` by the map of the cell's leaves, and its slot.
    #[inline]
    pub fn density(table: &GuideTable, cell: &Cell, direction: Vec3) -> GuidedDensity {
        let (octant, p) = (octant_of(direction), octant_coordinates(direction));
        let leaf = find_leaf(|i| table.table_word(i), cell.at + (1 << cell.log_tickets), octant, p);
        let slot = leaf_slot(table, cell, leaf_number(leaf));
        GuidedDensity { pdf: leaf_density(leaf, cell.log_tickets), slot }
    }

    fn leaf_slot(table: &GuideTable, cell: &Cell, number: u32) -> u32 {
        match number {
            octant @ 0..8 => 8 * cell.index + octant,
            _ => table.table_word(cell.at - 1) + number - 8,
        }
    }

    /// A direction with that density, and the density: by one of the cell's tickets, all of which are as likely.
    #[inline]
    pub fn sample(table: &GuideTable, cell: &Cell, u: Vec2) -> (Vec3, f32) {
        let tickets = 1 << cell.log_tickets;
        let draw = u.x * tickets as f32;
        let drawn = (draw as u32).min(tickets - 1);
        let ticket = table.table_word(cell.at + drawn);
        let direction = ticket_direction(ticket, Vec2::new(draw - drawn as f32, u.y));
        (direction, leaf_density(ticket, cell.log_tickets))
    }
}

/// Eight octants with the cosine: the octant guide.
pub mod octants {
    use super::*;

    /// Σ Q_a·w_a. By the octants' shares of the cosine lobe: the mean radiance weighted by the cosine, whose product with the albedo
    /// is what the surface sends back. By what their proposals come to: what a proposal is worth.
    pub fn radiance(cell: &Cell, weights: &[f32; 8]) -> f32 {
        (0..8).map(|a| cell.octants[a] * weights[a]).sum()
    }

    /// Density and slot of `direction`, which has that density in the cosine lobe; `proposed` is what a proposal is worth. A
    /// proposal that is kept has density cosθ/π · Q_a / proposed; one that is not, of which there are 1 − mean/proposed, makes room
    /// for a direction of the cosine lobe.
    pub fn density(cell: &Cell, mean: f32, proposed: f32, cosine: f32, direction: Vec3) -> GuidedDensity {
        let octant = octant_of(direction);
        let slot = 8 * cell.index + octant;
        if proposed <= 0.0 {
            return GuidedDensity { pdf: 0.0, slot };
        }
        let q = cell.octants[octant as usize];
        GuidedDensity { pdf: cosine * (q + (proposed - mean).max(0.0)) / proposed, slot }
    }

    /// A proposal: strips of the unit square along u.x choose the octant.
    pub fn proposal(cell: &Cell, normal: Vec3, proposed: f32, u: Vec2) -> Vec3 {
        let wholes = octant_wholes(normal);
        let weights: [f32; 8] = std::array::from_fn(|a| cell.octants[a] * wholes[a]);
        let (octant, rest) = choose_octant(&weights, proposed, u.x);
        propose_in_octant(normal, octant, Vec2::new(rest, u.y))
    }
}

/// The octant at `choice` of the distribution `weights` / `total`, and where in it `choice` lies, in [0, 1).
fn choose_octant(weights: &[f32; 8], total: f32, choice: f32) -> (u32, f32) {
    let [a, b, c, d, e, f, g, h] = *weights;
    let (low, high) = ([a + b, c + d], [e + f, g + h]);
    let mut aim = choice * total;
    let upper = in_second(&mut aim, low[0] + low[1], high[0] + high[1]);
    let (pairs, four) = if upper { (high, [e, f, g, h]) } else { (low, [a, b, c, d]) };
    let second = in_second(&mut aim, pairs[0], pairs[1]);
    let two = if second { [four[2], four[3]] } else { [four[0], four[1]] };
    let odd = in_second(&mut aim, two[0], two[1]);
    let octant = 4 * u32::from(upper) + 2 * u32::from(second) + u32::from(odd);
    (octant, (aim / two[usize::from(odd)].max(LEAST)).clamp(0.0, BELOW_ONE))
}

/// Whether `aim` lies in the second of two strips; never in an empty one, unless both are. Then it is counted from there on.
fn in_second(aim: &mut f32, first: f32, second: f32) -> bool {
    let chosen = *aim >= first && second > 0.0;
    *aim -= if chosen { first } else { 0.0 };
    chosen
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
        let shares = octant_shares(normal);
        let p = (0..8).filter(|&a| accepted(a)).map(|a| shares[a as usize]).sum::<f32>().min(1.0);
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
