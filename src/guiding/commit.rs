//! The commit: sums of a pass → what is known; without quadtrees, also how that lies in the table. Tickets are shares of all
//! that their cell knows, so each commit changes them all: the learner lays them out (`guiding/layout.rs`). This is the CPU
//! engine's; GPU twin: kernels/guiding/commit.wesl, which does the same operations on f32.
//!
//! How exact it is: a 64-bit sum becomes an f32 with a relative error of 1.2·10⁻⁷ at most (each word is rounded, and their
//! sum), and the blend adds five roundings of 6·10⁻⁸. That is far below the noise of what is learnt; it is the same in every
//! run, since sums are whole numbers. GPUs may divide less exactly and fuse products into sums, so tables of different
//! adapters differ in their last digits.

use super::lessons::{Lessons, VISIT_UNIT};
use super::state::{CellPart, CellState, GuideState, NodeState, Row};
use super::table::Cell;
use super::{GuideMode, GuideUniforms};
use rayon::prelude::*;

const TWO_TO_32: f32 = 4_294_967_296.0;
/// Visits with which a cell's guide is trusted half.
pub const TRUSTED_VISITS: f32 = 256.0;
/// exp(−80) of anything is nothing; less than that might not be a number of an adapter's.
const MOST_FORGOTTEN: f32 = 80.0;
/// Words of a cell without quadtrees in the table.
pub const OCTANT_WORDS: u32 = 8;
/// Cells that a thread takes at once, at least.
pub(super) const CELLS_A_THREAD: usize = 64;

/// Takes in a pass's lessons. Adaptive: how often each eighth of each cell was met; else nothing, but the cells lie in the
/// table's `rows` as they are known now.
pub fn commit(
    mode: GuideMode,
    uniforms: &GuideUniforms,
    lessons: &Lessons,
    state: &mut GuideState,
    rows: &mut [Row],
) -> Vec<[f32; 8]> {
    let commit = Commit { mode, uniforms, lessons };
    let cells = state.parts().into_par_iter().with_min_len(CELLS_A_THREAD);
    let met = cells.map(|mut part| commit.commit_cell(&mut part));
    if mode == GuideMode::Adaptive {
        return met.collect();
    }
    met.for_each(drop);
    for (index, cell) in (0..).zip(&state.cells) {
        lay_out_cell(mode, uniforms, index, cell, state.trees[index as usize].row, rows);
    }
    Vec::new()
}

/// The sum as an f32, by its words as the GPU has them.
fn sum_of(sum: u64) -> f32 {
    (sum >> 32) as u32 as f32 * TWO_TO_32 + sum as u32 as f32
}

/// What was known, of whose weight `kept` is left, with the sum of a pass; `weight` is that of both. In this order no step
/// is too large or too small for an f32 where the result is not.
fn blend(known: f32, kept: f32, units: f32, weight: f32, radiance_of_unit: f32) -> f32 {
    known * (kept / weight) + units / weight * radiance_of_unit
}

/// The sum of a row, from its first number on.
fn sum_of_row([x, y, z, w]: [f32; 4]) -> f32 {
    x + y + z + w
}

/// The sum of two rows.
fn sum_of_rows(values: &[f32; 8]) -> f32 {
    let [a, b, c, d, e, f, g, h] = *values;
    sum_of_row([a, b, c, d]) + sum_of_row([e, f, g, h])
}

/// How often a cell was met.
struct Met {
    eighths: [f32; 8],
    /// In all.
    visits: f32,
    /// What is left of the cell's weight, and that with the visits.
    kept: f32,
    weight: f32,
}

/// What committing needs.
struct Commit<'a> {
    mode: GuideMode,
    uniforms: &'a GuideUniforms,
    lessons: &'a Lessons,
}

impl Commit<'_> {
    /// The value of a slot, in units.
    fn value_at(&self, slot: usize) -> f32 {
        sum_of(self.lessons.values[slot])
    }

    /// A counter of visits.
    fn visits_at(&self, counter: usize) -> f32 {
        sum_of(self.lessons.visits[counter]) * (1.0 / VISIT_UNIT)
    }

    /// Radiance per unit. Units are powers of two, so their exponent tells, without a division that a GPU may round as it
    /// likes.
    fn radiance_of_unit(&self) -> f32 {
        f32::from_bits(0x7f00_0000 - self.uniforms.unit.to_bits())
    }

    /// Commits a pass's lessons about a cell. Adaptive: how often its eighths were met.
    fn commit_cell(&self, part: &mut CellPart) -> [f32; 8] {
        match self.mode {
            GuideMode::Adaptive => {
                self.blend_leaves(part);
                return self.commit_quadtrees(part);
            }
            GuideMode::Octant => self.commit_octants(part),
            _ => self.commit_bansal(part),
        }
        [0.0; 8]
    }

    /// Q ← mean(T) weighted by the cosine over the density, over this pass and what earlier ones are still worth.
    fn commit_octants(&self, part: &mut CellPart) {
        let (cell, unit) = (&mut *part.cell, self.radiance_of_unit());
        for a in 0..8 {
            let (value, visits) = (self.value_at(8 * part.index + a), self.visits_at(8 * part.index + a));
            if visits > 0.0 {
                let kept = self.uniforms.memory * cell.visits[a];
                cell.octants[a] = blend(cell.octants[a], kept, value, kept + visits, unit);
                cell.visits[a] = kept + visits;
            }
        }
    }

    /// n updates Q ← (1 − α)·Q + α·T at once, n visits.
    fn commit_bansal(&self, part: &mut CellPart) {
        for (a, known) in part.cell.octants.iter_mut().enumerate() {
            let (value, visits) = (self.value_at(8 * part.index + a), self.visits_at(8 * part.index + a));
            if visits > 0.0 {
                let mean = value / visits * self.radiance_of_unit();
                *known = updated(*known, mean, visits * self.uniforms.memory);
            }
        }
    }

    fn met_of(&self, part: &CellPart) -> Met {
        let eighths: [f32; 8] = std::array::from_fn(|eighth| self.visits_at(8 * part.index + eighth));
        let visits = sum_of_rows(&eighths);
        let kept = self.uniforms.memory * part.cell.visits[0];
        Met { eighths, visits, kept, weight: kept + visits }
    }

    /// Leaves blend. Where the cell was not met, nothing changes.
    fn blend_leaves(&self, part: &mut CellPart) {
        let (met, unit) = (self.met_of(part), self.radiance_of_unit());
        if met.visits > 0.0 {
            let first_slot = 8 * self.uniforms.cell_count as usize + 4 * part.trees.first_node as usize;
            for (known, slot) in part.nodes.as_flattened_mut().iter_mut().zip(first_slot..) {
                *known = blend(*known, met.kept, self.value_at(slot), met.weight, unit);
            }
        }
    }

    /// Nodes, and octants that have one, add up what lies below them, deepest first: the nodes of a cell lie breadth first.
    /// How often the cell's eighths were met.
    fn commit_quadtrees(&self, part: &mut CellPart) -> [f32; 8] {
        let (met, unit) = (self.met_of(part), self.radiance_of_unit());
        if met.visits <= 0.0 {
            return met.eighths;
        }
        for i in (0..part.nodes.len()).rev().filter(|&i| part.children[i] & 15 != 0) {
            part.nodes[i] = std::array::from_fn(|q| {
                energy_below(part.nodes[i][q], part.nodes, child_of(part.children[i], 4, q as u32))
            });
        }
        part.cell.octants = std::array::from_fn(|a| {
            let value = self.value_at(8 * part.index + a);
            let leaf = blend(part.cell.octants[a], met.kept, value, met.weight, unit);
            energy_below(leaf, part.nodes, child_of(part.trees.roots, 8, a as u32))
        });
        part.cell.visits = [met.weight; 8];
        met.eighths
    }
}

/// (1 − α)ⁿ · known + (1 − (1 − α)ⁿ) · mean, where `forgotten` is −n · ln(1 − α). The second share is a series where it is
/// small, since the difference would lose digits.
fn updated(known: f32, mean: f32, forgotten: f32) -> f32 {
    let x = forgotten.min(MOST_FORGOTTEN);
    let tail = 1.0 - x * 0.25 * (1.0 - x * 0.2 * (1.0 - x * (1.0 / 6.0)));
    let series = x * (1.0 - x * 0.5 * (1.0 - x * (1.0 / 3.0) * tail));
    let kept = if x < 0.25 { 1.0 - series } else { (-x).exp() };
    let rest = if x < 0.25 { series } else { 1.0 - kept };
    kept * known + rest * mean
}

/// The energy of a node of a cell; `leaf` where there is none.
fn energy_below(leaf: f32, nodes: &[NodeState], child: Option<usize>) -> f32 {
    child.map_or(leaf, |child| sum_of_row(nodes[child]))
}

/// Position of child `i` of a node or cell whose mask has `bits` bits, None if it is a leaf.
pub(super) fn child_of(children: u32, bits: u32, i: u32) -> Option<usize> {
    let mask = children & ((1 << bits) - 1);
    let before = (mask & ((1 << i) - 1)).count_ones();
    (mask >> i & 1 == 1).then_some(((children >> bits) + before) as usize)
}

/// Lays out a cell without quadtrees: its row of the index, and its two rows of octants.
fn lay_out_cell(
    mode: GuideMode,
    uniforms: &GuideUniforms,
    index: u32,
    cell: &CellState,
    row: u32,
    rows: &mut [Row],
) {
    let at = OCTANT_WORDS * index;
    rows[row as usize] = cell_row(mode, cell, Cell { index, at, ..Default::default() });
    let first = (uniforms.words_at + at / 4) as usize;
    let octants: [Row; 2] = bytemuck::cast(cell.octants);
    rows[first..first + 2].copy_from_slice(&octants);
}

/// How the index tells of a cell; `place` says which it is and where its words are.
pub(super) fn cell_row(mode: GuideMode, cell: &CellState, place: Cell) -> Row {
    let irradiance = sum_of_rows(&cell.octants);
    let visits = if mode == GuideMode::Adaptive { cell.visits[0] } else { sum_of_rows(&cell.visits) };
    let trust = match mode {
        _ if irradiance <= 0.0 => 0.0,
        GuideMode::Adaptive | GuideMode::Octant => visits / (visits + TRUSTED_VISITS),
        _ => 1.0,
    };
    Cell { irradiance, trust, ..place }.row()
}
