//! Refinement between passes: trees grow where light comes from, cells are cut where paths meet them often. On the host, a
//! dozen times in a render.

use super::GuideMode;
use super::commit::{CELLS_A_THREAD, child_of};
use super::learner::{INDEX_BYTES, Learner, MOST_CELLS_IN_ALL, MOST_NODES};
use super::state::{CellState, CellTrees, GuideState, NodeState};
use super::table::{FINER, MAX_CELL_LEVELS};
use rayon::prelude::*;

/// Share of a cell's irradiance above which a leaf is cut, and below which four are joined.
const SPLIT_SHARE: f32 = 0.005;
/// Visits that a leaf should rest on before it is cut, so that trees do not learn noise.
const SPLIT_SUPPORT: f32 = 64.0;
/// Visits in one pass above which a cell is cut, for a pass of one sample per pixel; grows with the square root of the
/// pass, so that cells grow finer and better known.
const SPLIT_VISITS: f64 = 20000.0;

impl Learner {
    /// Refines trees and cells by what they know and how often their eighths were `met` in a pass of `samples` samples per
    /// pixel, and makes cells at `missing` ones; whether anything changed its shape.
    pub(super) fn refine(&mut self, met: &[[f32; 8]], missing: &[u32], samples: u32) -> bool {
        let regrown = self.refine_trees(met);
        let made = self.make_cells(missing);
        let limit = SPLIT_VISITS * f64::from(samples.max(1)).sqrt();
        self.cut_cells(met, limit) || made || regrown
    }

    /// Grows and prunes the trees of cells that were met; whether any changed its shape.
    fn refine_trees(&mut self, met: &[[f32; 8]]) -> bool {
        let depth = self.options.depth;
        // A level at most is added to each tree in a pass, so there are never more than MOST_NODES.
        if depth == 0 || self.nodes() >= MOST_NODES / 4 || self.bytes() > self.options.memory {
            return false;
        }
        let state = &self.state;
        let regrown: Vec<Option<Trees>> = met
            .par_iter()
            .enumerate()
            .with_min_len(CELLS_A_THREAD)
            .map(|(cell, met)| if visits(met) > 0.0 { refined(state, cell, depth) } else { None })
            .collect();
        if regrown.iter().all(Option::is_none) {
            return false;
        }
        self.state.regrow(&regrown);
        true
    }

    /// Cuts cells that were met more than `limit` times into those of their eighths that hold surfaces; whether there were any.
    fn cut_cells(&mut self, met: &[[f32; 8]], limit: f64) -> bool {
        debug_assert!(met.is_empty() || self.mode() == GuideMode::Adaptive);
        let mut bytes = self.bytes();
        let words = self.index.len();
        for (cell, met) in met.iter().enumerate() {
            let often = f64::from(visits(met)) > limit;
            let full = bytes > self.options.memory || self.cells() + 8 > MOST_CELLS_IN_ALL;
            if !often || self.levels[cell] >= MAX_CELL_LEVELS || full {
                continue;
            }
            let parts: Vec<u32> = (0..8).filter(|&eighth| met[eighth as usize] > 0.0).collect();
            self.levels[cell] += 1;
            self.state.cells[cell].visits.iter_mut().for_each(|v| *v /= parts.len().max(1) as f32);
            let copies = parts.len().saturating_sub(1) as u64;
            bytes += 8 * INDEX_BYTES + copies * self.cell_bytes(cell);
            let block = self.index.len() as u32;
            let parent = self.state.trees[cell].row as usize;
            self.index[parent] = FINER | block;
            // The cell itself becomes the first of its parts, and stands in for those that hold no surface.
            self.index.extend([cell as u32; 8]);
            self.state.trees[cell].row = block + parts.first().copied().unwrap_or(0);
            for part in parts.into_iter().skip(1) {
                self.state.push_copy(block + part, cell);
                self.enter_cell(block + part, self.levels[cell]);
            }
        }
        self.index.len() > words
    }
}

/// How often a cell was met.
fn visits(met: &[f32; 8]) -> f32 {
    met.iter().sum()
}

impl GuideState {
    /// Puts trees of new shapes in place, cell by cell. Copies are made in parallel, into memory that is new to each thread:
    /// there may be tens of megabytes.
    fn regrow(&mut self, regrown: &[Option<Trees>]) {
        let mut trees = Vec::with_capacity(self.trees.len());
        let mut count = 0;
        for (old, new) in self.trees.iter().zip(regrown) {
            let (roots, nodes) =
                new.as_ref().map_or((old.roots, old.nodes), |t| (t.roots, t.nodes.len() as u32));
            trees.push(CellTrees { roots, first_node: count, nodes, ..*old });
            count += nodes;
        }
        let (mut nodes, mut children) = (vec![[0.0; 4]; count as usize], vec![0; count as usize]);
        let (mut free_nodes, mut free_children) = (nodes.as_mut_slice(), children.as_mut_slice());
        let places: Vec<_> = trees
            .iter()
            .map(|cell| {
                let range = ..cell.nodes as usize;
                let nodes = free_nodes.split_off_mut(range).unwrap_or_default();
                (nodes, free_children.split_off_mut(range).unwrap_or_default())
            })
            .collect();
        places.into_par_iter().enumerate().with_min_len(CELLS_A_THREAD).for_each(
            |(cell, (nodes, children))| {
                let range = self.trees[cell].range();
                match &regrown[cell] {
                    Some(trees) => {
                        nodes.copy_from_slice(&trees.nodes);
                        children.copy_from_slice(&trees.children);
                    }
                    None => {
                        nodes.copy_from_slice(&self.nodes[range.clone()]);
                        children.copy_from_slice(&self.children[range]);
                    }
                }
            },
        );
        (self.nodes, self.children, self.trees) = (nodes, children, trees);
    }
}

/// A cell's trees in a new shape.
struct Trees {
    roots: u32,
    nodes: Vec<NodeState>,
    children: Vec<u32>,
}

/// Leaves that hold much of the cell's irradiance cut, one level at a time, and those that hold little joined; None if the
/// trees keep their shape.
fn refined(state: &GuideState, cell: usize, depth: u32) -> Option<Trees> {
    let (CellState { octants, visits }, trees) = (state.cells[cell], state.trees[cell]);
    let (old, old_children) = (&state.nodes[trees.range()], &state.children[trees.range()]);
    let total: f32 = octants.iter().sum();
    let limit = SPLIT_SHARE.max(SPLIT_SUPPORT / visits[0].max(1.0)) * total;
    /// A node to be emitted: the one that it was, or the energy of the leaf that it was.
    type Source = (Option<usize>, f32, u32);
    let mut queue: Vec<Source> = Vec::with_capacity(2 * old.len());
    let mut roots = 0;
    for (a, &energy) in octants.iter().enumerate() {
        if energy > limit && depth > 0 {
            roots |= 1 << a;
            queue.push((child_of(trees.roots, 8, a as u32), energy, 1));
        }
    }
    let mut new = Trees {
        roots,
        nodes: Vec::with_capacity(2 * old.len()),
        children: Vec::with_capacity(2 * old.len()),
    };
    let mut next = 0;
    while next < queue.len() {
        let (was, energy, level) = queue[next];
        next += 1;
        let energies = was.map_or([0.25 * energy; 4], |i| old[i]);
        let first = queue.len() as u32;
        let mut mask = 0;
        for (q, &energy) in energies.iter().enumerate() {
            // A leaf that was cut just now is not cut further before it has learnt.
            if energy > limit && level < depth && was.is_some() {
                mask |= 1 << q;
                let child = was.and_then(|i| child_of(old_children[i], 4, q as u32));
                queue.push((child, energy, level + 1));
            }
        }
        new.nodes.push(energies);
        new.children.push(first << 4 | mask);
    }
    (new.roots != trees.roots || new.children != old_children).then_some(new)
}
