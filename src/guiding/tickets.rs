//! How the quadtrees of a cell lie in the table: each leaf gets its share of the cell's tickets, by which directions are
//! drawn, and its squares on the map, by which the leaf of a direction is found ([`super::quadtree`]).

use super::learner::{CellState, NodeState, child_of};
use super::quadtree::{BLOCK_WORDS, FINER_BLOCK, TICKET_BITS, ticket};

/// Tickets per leaf at least, and of a cell at least and at most, as powers of two. A leaf's share is rounded to whole
/// tickets, so more of them are more faithful, and take more memory (docs/GUIDING.md has what was measured).
const LOG_TICKETS_PER_LEAF: u32 = 1;
const LEAST_LOG_TICKETS: u32 = 4;
const MOST_LOG_TICKETS: u32 = 11;
const OCTANTS: u32 = 8;

/// A cell's words in the table.
pub(super) struct CellWords {
    pub(super) log_tickets: u32,
    /// Tickets, then the map.
    pub(super) words: Vec<u32>,
    /// For each word the slot that learns what it says a density of.
    pub(super) slots: Vec<u32>,
}

/// A leaf of a cell's quadtrees.
struct Leaf {
    octant: u32,
    depth: u32,
    /// Its place on the grid of squares of its size.
    square: [u32; 2],
    energy: f32,
    slot: u32,
}

/// Words of such a cell in the table.
pub(super) fn cell_words(cell: &CellState) -> u64 {
    // Each node two levels below another block's has a block of its own.
    let mut depths = vec![0u32; cell.roots.count_ones().min(OCTANTS) as usize];
    let mut leaves = u64::from(OCTANTS - (cell.roots & 255).count_ones());
    let mut blocks = u64::from(OCTANTS);
    for (at, node) in cell.nodes.iter().enumerate() {
        let depth = depths[at];
        let children = (node.children & 15).count_ones();
        blocks += u64::from(depth > 0 && depth.is_multiple_of(2));
        leaves += u64::from(4 - children);
        depths.extend(std::iter::repeat_n(depth + 1, children as usize));
    }
    (1 << log_tickets(leaves)) + u64::from(BLOCK_WORDS) * blocks
}

fn log_tickets(leaves: u64) -> u32 {
    let fitting = leaves.next_power_of_two().ilog2() + LOG_TICKETS_PER_LEAF;
    fitting.clamp(LEAST_LOG_TICKETS, MOST_LOG_TICKETS)
}

/// Lays a cell out. `octant_slot` and `node_slot` are the slots of its first octant and of its first node.
pub(super) fn lay_out(cell: &CellState, octant_slot: u32, node_slot: u32) -> CellWords {
    let leaves = leaves(cell, octant_slot, node_slot);
    let log_tickets = log_tickets(leaves.len() as u64);
    let tickets = 1usize << log_tickets;
    let map = tickets + (BLOCK_WORDS * OCTANTS) as usize;
    let mut laid = CellWords { log_tickets, words: vec![0; map], slots: vec![0; map] };
    let total: f64 = leaves.iter().map(|leaf| f64::from(leaf.energy)).sum();
    let (mut sum, mut drawn) = (0.0, 0);
    for leaf in &leaves {
        // Rounded sums: no leaf is more than a ticket off, and none drifts.
        sum += f64::from(leaf.energy);
        let end = if total > 0.0 { (tickets as f64 * (sum / total) + 0.5) as usize } else { 0 };
        let end = end.clamp(drawn, tickets);
        let word = ticket((end - drawn) as u32, leaf.depth, leaf.square, leaf.octant);
        laid.words[drawn..end].fill(word);
        laid.slots[drawn..end].fill(leaf.slot);
        laid.draw_on_map(leaf, word & ((1 << (TICKET_BITS + 3)) - 1));
        drawn = end;
    }
    laid
}

impl CellWords {
    /// Puts a leaf on all the map's squares that it covers, and blocks above where they are missing.
    fn draw_on_map(&mut self, leaf: &Leaf, word: u32) {
        let [x, y] = leaf.square;
        let map = 1usize << self.log_tickets;
        let mut block = map + (BLOCK_WORDS * leaf.octant) as usize;
        // The depth of the block's squares.
        let mut depth = 2;
        while leaf.depth > depth {
            let shift = leaf.depth - depth;
            let at = block + ((x >> shift & 3) + 4 * (y >> shift & 3)) as usize;
            if self.words[at] & FINER_BLOCK == 0 {
                self.words[at] = FINER_BLOCK | ((self.words.len() - map) as u32 / BLOCK_WORDS);
                self.words.resize(self.words.len() + BLOCK_WORDS as usize, 0);
                self.slots.resize(self.words.len(), 0);
            }
            block = map + (BLOCK_WORDS * (self.words[at] & !FINER_BLOCK)) as usize;
            depth += 2;
        }
        let shift = depth - leaf.depth;
        let (x, y, side) = (x << shift & 3, y << shift & 3, 1 << shift);
        for row in y..y + side {
            let at = block + (x + 4 * row) as usize;
            self.words[at..at + side as usize].fill(word);
            self.slots[at..at + side as usize].fill(leaf.slot);
        }
    }
}

/// The leaves of a cell, octant by octant, neighbours close to each other.
fn leaves(cell: &CellState, octant_slot: u32, node_slot: u32) -> Vec<Leaf> {
    let mut leaves = Vec::with_capacity(8 + 3 * cell.nodes.len());
    for octant in 0..OCTANTS {
        let energy = cell.octants[octant as usize];
        let whole = Leaf { octant, depth: 0, square: [0; 2], energy, slot: octant_slot + octant };
        match child_of(cell.roots, 8, octant) {
            Some(root) => add_leaves(cell, root, &whole, node_slot, &mut leaves),
            None => leaves.push(whole),
        }
    }
    leaves
}

/// Adds the leaves below a node in place of the leaf that its square would be.
fn add_leaves(cell: &CellState, node: usize, whole: &Leaf, node_slot: u32, leaves: &mut Vec<Leaf>) {
    let NodeState { energies, children } = cell.nodes[node];
    for quarter in 0..4 {
        let leaf = Leaf {
            octant: whole.octant,
            depth: whole.depth + 1,
            square: [2 * whole.square[0] + (quarter & 1), 2 * whole.square[1] + (quarter >> 1)],
            energy: energies[quarter as usize],
            slot: node_slot + 4 * node as u32 + quarter,
        };
        match child_of(children, 4, quarter) {
            Some(child) => add_leaves(cell, child, &leaf, node_slot, leaves),
            None => leaves.push(leaf),
        }
    }
}
