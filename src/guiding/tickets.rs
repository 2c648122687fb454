//! How the quadtrees of a cell lie in the table: each leaf gets its share of the cell's tickets, by which directions are
//! drawn, and its squares on the map, by which the leaf of a direction is found ([`super::quadtree`]).

use super::commit::child_of;
use super::quadtree::{BLOCK_WORDS, FINER_BLOCK, LEAF_BITS, map_word, ticket};
use super::state::KnownCell;

/// Tickets per leaf at least, and of a cell at least and at most, as powers of two. A leaf's share is rounded to whole
/// tickets, so more of them are more faithful, and take more memory (docs/GUIDING.md has what was measured).
const LOG_TICKETS_PER_LEAF: u32 = 2;
const LEAST_LOG_TICKETS: u32 = 4;
const MOST_LOG_TICKETS: u32 = 11;
/// Nodes of a cell at most, so that the map can number its leaves.
pub(super) const MOST_CELL_NODES: usize = (1 << LEAF_BITS) / 4 - 2;
const OCTANTS: u32 = 8;

/// How many words of each kind a cell has in the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CellSize {
    pub(super) log_tickets: u32,
    blocks: u32,
}

impl CellSize {
    pub(super) fn of(cell: &KnownCell) -> CellSize {
        let roots = (cell.trees.roots & 255).count_ones();
        let mut depths = vec![0u8; roots as usize];
        // An octant has a block, and so has each node whose squares would be finer than those of the block above it.
        let (mut leaves, mut blocks) = (OCTANTS - roots, OCTANTS);
        for (at, children) in cell.children.iter().enumerate() {
            let depth = depths[at];
            let children = (children & 15).count_ones();
            blocks += u32::from(depth > 0 && depth.is_multiple_of(2));
            leaves += 4 - children;
            depths.extend(std::iter::repeat_n(depth + 1, children as usize));
        }
        let log_tickets = leaves.next_power_of_two().ilog2() + LOG_TICKETS_PER_LEAF;
        CellSize { log_tickets: log_tickets.clamp(LEAST_LOG_TICKETS, MOST_LOG_TICKETS), blocks }
    }

    /// The number of its first leaf below an octant; tickets; the map.
    pub(super) fn words(&self) -> usize {
        1 + (1 << self.log_tickets) + (BLOCK_WORDS * self.blocks) as usize
    }
}

/// A leaf of a cell's quadtrees.
struct Leaf {
    octant: u32,
    depth: u32,
    /// Its place on the grid of squares of its size.
    square: [u32; 2],
    energy: f32,
    /// Its number in the cell: octants first, then the quarters of nodes.
    number: u32,
}

/// Fills a cell's words, all of them 0 before. `node_slot` is the slot of its first node's first quarter.
pub(super) fn lay_out(cell: &KnownCell, size: CellSize, node_slot: u32, words: &mut [u32]) {
    let (first, words) = words.split_at_mut(1);
    first[0] = node_slot;
    let (tickets, map) = words.split_at_mut(1 << size.log_tickets);
    let mut map = Map { words: map, blocks: OCTANTS };
    let leaves = leaves(cell);
    let energy: f64 = leaves.iter().map(|leaf| f64::from(leaf.energy)).sum();
    // Whatever is known, all tickets are given, so that their densities are those with which directions are drawn: to the
    // leaves' areas where nothing is.
    let weight = |leaf: &Leaf| match energy > 0.0 {
        true => f64::from(leaf.energy) / energy,
        false => 0.125 * 0.25f64.powi(leaf.depth as i32),
    };
    let (mut sum, mut drawn) = (0.0, 0);
    for leaf in &leaves {
        // Sums are rounded, so no leaf is more than a ticket off, and shares do not drift.
        sum += weight(leaf);
        let end = ((tickets.len() as f64 * sum + 0.5) as usize).clamp(drawn, tickets.len());
        let count = (end - drawn) as u32;
        tickets[drawn..end].fill(ticket(count, leaf.depth, leaf.square, leaf.octant));
        map.draw(leaf, map_word(count, leaf.depth, leaf.number));
        drawn = end;
    }
}

/// The map while it is drawn.
struct Map<'a> {
    words: &'a mut [u32],
    blocks: u32,
}

impl Map<'_> {
    /// Puts a leaf on all squares that it covers, and blocks above where they are missing.
    fn draw(&mut self, leaf: &Leaf, word: u32) {
        let [x, y] = leaf.square;
        let mut block = BLOCK_WORDS * leaf.octant;
        // The depth of the block's squares.
        let mut depth = 2;
        while leaf.depth > depth {
            let shift = leaf.depth - depth;
            let at = (block + (x >> shift & 3) + 4 * (y >> shift & 3)) as usize;
            if self.words[at] & FINER_BLOCK == 0 {
                self.words[at] = FINER_BLOCK | self.blocks;
                self.blocks += 1;
            }
            block = BLOCK_WORDS * (self.words[at] & !FINER_BLOCK);
            depth += 2;
        }
        let shift = depth - leaf.depth;
        let (x, y, side) = (x << shift & 3, y << shift & 3, 1 << shift);
        for row in y..y + side {
            let at = (block + x + 4 * row) as usize;
            self.words[at..at + side as usize].fill(word);
        }
    }
}

/// The leaves of a cell, octant by octant, neighbours close to each other.
fn leaves(cell: &KnownCell) -> Vec<Leaf> {
    let mut leaves = Vec::with_capacity(8 + 3 * cell.nodes.len());
    for octant in 0..OCTANTS {
        let energy = cell.cell.octants[octant as usize];
        let whole = Leaf { octant, depth: 0, square: [0; 2], energy, number: octant };
        match child_of(cell.trees.roots, 8, octant) {
            Some(root) => add_leaves(cell, root, &whole, &mut leaves),
            None => leaves.push(whole),
        }
    }
    leaves
}

/// Adds the leaves below a node in place of the leaf that its square would be.
fn add_leaves(cell: &KnownCell, node: usize, whole: &Leaf, leaves: &mut Vec<Leaf>) {
    for quarter in 0..4 {
        let leaf = Leaf {
            octant: whole.octant,
            depth: whole.depth + 1,
            square: [2 * whole.square[0] + (quarter & 1), 2 * whole.square[1] + (quarter >> 1)],
            energy: cell.nodes[node][quarter as usize],
            number: OCTANTS + 4 * node as u32 + quarter,
        };
        match child_of(cell.children[node], 4, quarter) {
            Some(child) => add_leaves(cell, child, &leaf, leaves),
            None => leaves.push(leaf),
        }
    }
}
