//! What is known of all cells, flat: numbers that a pass changes, and what the trees look like, which changes between passes.
//! The GPU's buffers `guide_state` and `guide_trees` hold the same (kernels/guiding/commit.wesl).

use super::GuideUniforms;
use bytemuck::{Pod, Zeroable};
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

/// Where a cell's row of the index and its quadtrees are: four words.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct CellTrees {
    /// Octants with a quadtree: a bit each. Their roots are the first of the cell's nodes.
    pub roots: u32,
    /// Number of the cell's first node.
    pub first_node: u32,
    /// How many nodes it has, breadth first, so that children lie next to each other.
    pub nodes: u32,
    /// The row of the index that leads to the cell; where several do, one of them.
    pub row: u32,
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

/// What of an engine's table is not what the learner has: each includes what comes before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stale {
    /// Estimates of the pixels alone.
    #[default]
    Pixels,
    /// All rows of the table.
    Rows,
    /// What is known, too, since cells or trees changed their shape.
    State,
}

/// What an engine gets before a pass.
#[derive(Clone, Debug)]
pub struct GuideUpdate<'a> {
    pub uniforms: GuideUniforms,
    /// All rows of the table; None where all but the pixels are as the engine's last commit left them.
    pub rows: Option<Vec<Row>>,
    /// What is known; None where it is as the engine's last commit left it. Never without rows.
    pub state: Option<&'a GuideState>,
    /// Estimates of the pixels' luminances, for learnt roulette.
    pub pixels: &'a [f32],
}

impl GuideState {
    /// Adds a cell behind the others, to which a row of the index leads.
    pub(super) fn push(
        &mut self,
        row: u32,
        cell: CellState,
        roots: u32,
        nodes: &[NodeState],
        children: &[u32],
    ) {
        let trees = CellTrees { roots, first_node: self.nodes.len() as u32, nodes: nodes.len() as u32, row };
        self.cells.push(cell);
        self.trees.push(trees);
        self.nodes.extend_from_slice(nodes);
        self.children.extend_from_slice(children);
    }

    /// Adds a copy of a cell behind the others, to which a row of the index leads.
    pub(super) fn push_copy(&mut self, row: u32, cell: usize) {
        let trees = self.trees[cell];
        self.cells.push(self.cells[cell]);
        self.trees.push(CellTrees { first_node: self.nodes.len() as u32, row, ..trees });
        self.nodes.extend_from_within(trees.range());
        self.children.extend_from_within(trees.range());
    }

    /// A cell with its quadtrees.
    pub(super) fn cell(&self, number: usize) -> KnownCell<'_> {
        let trees = self.trees[number];
        let (nodes, children) = (&self.nodes[trees.range()], &self.children[trees.range()]);
        KnownCell { cell: &self.cells[number], trees, nodes, children }
    }

    /// All cells, each with what a commit changes of its quadtrees.
    pub(super) fn parts(&mut self) -> Vec<CellPart<'_>> {
        let (mut nodes, mut children) = (self.nodes.as_mut_slice(), self.children.as_slice());
        let cells = self.cells.iter_mut().zip(&self.trees).enumerate();
        let part = |(index, (cell, &trees)): (usize, (_, &CellTrees))| {
            let count = trees.nodes as usize;
            CellPart {
                index,
                cell,
                trees,
                nodes: nodes.split_off_mut(..count).unwrap_or_default(),
                children: children.split_off(..count).unwrap_or_default(),
            }
        };
        cells.map(part).collect()
    }
}

/// A cell with its quadtrees.
#[derive(Clone, Copy)]
pub(super) struct KnownCell<'a> {
    pub cell: &'a CellState,
    pub trees: CellTrees,
    pub nodes: &'a [NodeState],
    pub children: &'a [u32],
}

/// A cell with all that its commit changes.
pub(super) struct CellPart<'a> {
    pub index: usize,
    pub cell: &'a mut CellState,
    pub trees: CellTrees,
    pub nodes: &'a mut [NodeState],
    pub children: &'a [u32],
}
