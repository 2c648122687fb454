//! What is known of all cells, flat: numbers that a pass changes, and what the trees look like, which changes between passes.
//! The GPU's buffers `guide_state` and `guide_trees` hold the same (kernels/guiding/commit.wesl).

use super::commit::{CELLS_A_THREAD, cell_rows, lay_out_nodes};
use super::table::CELL_ROWS;
use super::{GuideMode, GuideUniforms};
use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;
use std::ops::Range;

/// A row of a table or of a state.
pub type Row = [u32; 4];

/// What a cell knows: four rows.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct CellState {
    /// Per octant: adaptive irradiance, else mean radiance.
    pub octants: [f32; 8],
    /// Weight of what was learnt: per octant, except adaptive, where all are the cell's.
    pub visits: [f32; 8],
}

/// What a quadtree node knows: the energies of its quarters, a row.
pub type NodeState = [f32; 4];

/// Rows of a [`CellState`].
pub const CELL_STATE_ROWS: u32 = 4;

/// Where a cell's quadtrees are: three words.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct CellTrees {
    /// Octants with a quadtree: a bit each. Their roots are the first of the cell's nodes.
    pub roots: u32,
    /// Number of the cell's first node.
    pub first_node: u32,
    /// How many nodes it has, breadth first, so that children lie next to each other.
    pub nodes: u32,
}

impl CellTrees {
    /// The cell's nodes among those of all cells.
    pub fn range(&self) -> Range<usize> {
        self.first_node as usize..(self.first_node + self.nodes) as usize
    }
}

/// What is known of all cells, in the order in which they lie in the table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GuideState {
    pub cells: Vec<CellState>,
    /// Cell after cell.
    pub nodes: Vec<NodeState>,
    pub trees: Vec<CellTrees>,
    /// Per node its quarters that are nodes, a bit each, below the position of the first of them, counted from the cell's
    /// first node.
    pub children: Vec<u32>,
}

/// What a pass's commit leaves for the host: what is known now, and where cells should be made and cut.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Committed {
    pub cells: Vec<CellState>,
    pub nodes: Vec<NodeState>,
    /// Adaptive: per cell, how often each eighth of it was met in the pass.
    pub met: Vec<[f32; 8]>,
    /// Per base cell and sector: whether a surface point was met there without a cell.
    pub missing: Vec<u32>,
}

/// What an engine gets before a pass.
#[derive(Clone, Copy, Debug)]
pub struct GuideUpdate<'a> {
    pub uniforms: GuideUniforms,
    /// The index and what is known; None where both are as the engine's last commit left them.
    pub anew: Option<(&'a [u32], &'a GuideState)>,
    /// Estimates of the pixels' luminances, for learnt roulette.
    pub pixels: &'a [f32],
}

impl GuideState {
    /// Adds a cell behind the others.
    pub(super) fn push(&mut self, cell: CellState, roots: u32, nodes: &[NodeState], children: &[u32]) {
        let trees = CellTrees { roots, first_node: self.nodes.len() as u32, nodes: nodes.len() as u32 };
        self.cells.push(cell);
        self.trees.push(trees);
        self.nodes.extend_from_slice(nodes);
        self.children.extend_from_slice(children);
    }

    /// Adds a copy of a cell behind the others.
    pub(super) fn push_copy(&mut self, cell: usize) {
        let trees = self.trees[cell];
        self.cells.push(self.cells[cell]);
        self.trees.push(CellTrees { first_node: self.nodes.len() as u32, ..trees });
        self.nodes.extend_from_within(trees.range());
        self.children.extend_from_within(trees.range());
    }

    /// Each cell with its nodes and their places in a table's rows of cells and of nodes.
    pub(super) fn parts<'a>(&'a mut self, rows: &'a mut TableRows<'_>) -> Vec<CellPart<'a>> {
        let (mut nodes, mut children) = (self.nodes.as_mut_slice(), self.children.as_slice());
        let (cell_rows, _) = rows.cells.as_chunks_mut();
        let mut node_rows = &mut *rows.nodes;
        let cells = self.cells.iter_mut().zip(&self.trees).zip(cell_rows).enumerate();
        cells
            .map(|(index, ((cell, &trees), cell_rows))| {
                let count = trees.nodes as usize;
                CellPart {
                    index,
                    cell,
                    trees,
                    nodes: nodes.split_off_mut(..count).unwrap_or_default(),
                    children: children.split_off(..count).unwrap_or_default(),
                    cell_rows,
                    node_rows: node_rows.split_off_mut(..count).unwrap_or_default(),
                }
            })
            .collect()
    }

    /// How all cells and nodes lie in a table.
    pub fn lay_out(&self, mode: GuideMode, rows: &mut TableRows) {
        let (cells, _) = rows.cells.as_chunks_mut();
        let known = self.cells.par_iter().zip(&self.trees).with_min_len(CELLS_A_THREAD);
        known.zip(cells).for_each(|((cell, trees), rows)| *rows = cell_rows(mode, cell, trees));
        let mut node_rows = &mut *rows.nodes;
        let part =
            |trees: &CellTrees| (*trees, node_rows.split_off_mut(..trees.nodes as usize).unwrap_or_default());
        let parts: Vec<(CellTrees, &mut [Row])> = self.trees.iter().map(part).collect();
        parts.into_par_iter().with_min_len(CELLS_A_THREAD).for_each(|(trees, rows)| {
            let range = trees.range();
            lay_out_nodes(&self.nodes[range.clone()], &self.children[range], trees.first_node, rows);
        });
    }
}

/// Rows of a table that a commit writes.
pub struct TableRows<'a> {
    /// [`CELL_ROWS`] each.
    pub cells: &'a mut [Row],
    pub nodes: &'a mut [Row],
}

impl<'a> TableRows<'a> {
    /// Those of a table's rows.
    pub fn of(uniforms: &GuideUniforms, rows: &'a mut [Row]) -> TableRows<'a> {
        let rows = &mut rows[uniforms.cells_at as usize..];
        let (cells, rows) = rows.split_at_mut((CELL_ROWS * uniforms.cell_count) as usize);
        TableRows { cells, nodes: &mut rows[..uniforms.node_count as usize] }
    }
}

/// A cell with all that its commit changes.
pub(super) struct CellPart<'a> {
    pub index: usize,
    pub cell: &'a mut CellState,
    pub trees: CellTrees,
    pub nodes: &'a mut [NodeState],
    pub children: &'a [u32],
    pub cell_rows: &'a mut [Row; CELL_ROWS as usize],
    pub node_rows: &'a mut [Row],
}
