//! The learner: lessons of a pass → the next table. Cells are made where paths meet surfaces and cut where they meet them
//! often; quadtrees are cut where light comes from. On the host: there are a dozen passes in a render.

use super::lessons::{LessonLayout, Lessons, VISIT_UNIT};
use super::table::{CELL_BITS, Cell, FINER, GuideTable, GuideUniforms, MAX_CELL_LEVELS, NO_CELL};
use super::tickets::{CellSize, lay_out};
use super::{GuideMode, GuideOptions};
use glam::Vec3;
use rayon::prelude::*;

/// Base cells along the longest side, where nothing else is asked for.
const BASE_CELLS: f32 = 16.0;
/// Base cells along any side at most.
const MOST_CELLS: f32 = 128.0;
/// Share of a cell's irradiance above which a leaf is cut, and below which four are joined.
const SPLIT_SHARE: f32 = 0.005;
/// Visits that a leaf should rest on before it is cut, so that trees do not learn noise.
const SPLIT_SUPPORT: f32 = 64.0;
/// Visits in one pass above which a cell is cut, for a pass of one sample per pixel; grows with the square root of the
/// pass, so that cells grow finer and better known.
const SPLIT_VISITS: f64 = 20000.0;
/// Visits with which a cell's guide is trusted half.
const TRUSTED_VISITS: f32 = 256.0;
/// Bytes of a row of the index, and of a pass's mark for it.
pub(super) const INDEX_BYTES: u64 = 16 + 4;
/// Fixed-point units per unit of radiance, as a power of two below the brightest emitter.
const UNIT_BITS: i32 = 36;

/// Quadtree nodes and cells that a table can number.
pub(super) const MOST_NODES: usize = 1 << 24;
pub(super) const MOST_CELLS_IN_ALL: usize = 1 << CELL_BITS;

/// Why a learner can't be made or go on.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LearnerError {
    #[error(
        "guiding would need {bytes} bytes for its base grid, more than the {limit} allowed; choose larger cells (--guide-cell) or allow more memory (--guide-memory)"
    )]
    Memory { bytes: u64, limit: u64 },
    #[error(
        "what was learnt before takes {bytes} bytes, more than the {limit} allowed; allow more memory (--guide-memory) or learn anew"
    )]
    LearntMemory { bytes: u64, limit: u64 },
    #[error(
        "what was learnt before is for guide {learnt}, but {wanted} is asked for; choose guide {learnt} or learn anew"
    )]
    Mode { learnt: GuideMode, wanted: GuideMode },
}

/// What a cell knows, in the order in which it lies in the table.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct CellState {
    /// Per octant: adaptive irradiance, else mean radiance.
    pub(super) octants: [f32; 8],
    /// Weight of what was learnt: per octant, except adaptive, where all are the cell's.
    pub(super) visits: [f32; 8],
    /// Octants with a quadtree: a bit each, below the position of the first in `nodes`.
    pub(super) roots: u32,
    /// Breadth first, so that children lie next to each other.
    pub(super) nodes: Vec<NodeState>,
    /// Cuts of a base cell that led here.
    pub(super) level: u32,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct NodeState {
    pub(super) energies: [f32; 4],
    /// As in [`Node`], relative to the cell's first node.
    pub(super) children: u32,
}

/// Position of child `i` of a node or cell whose mask has `bits` bits.
pub(super) fn child_of(children: u32, bits: u32, i: u32) -> Option<usize> {
    let mask = children & ((1 << bits) - 1);
    let before = (mask & ((1 << i) - 1)).count_ones();
    (mask >> i & 1 == 1).then_some(((children >> bits) + before) as usize)
}

/// Everything that was learnt, between passes.
#[derive(Clone, Debug, PartialEq)]
pub struct Learner {
    pub(super) options: GuideOptions,
    pub(super) uniforms: GuideUniforms,
    /// As in the table.
    pub(super) index: Vec<u32>,
    /// Which word of the index leads to each cell.
    pub(super) word_of: Vec<u32>,
    pub(super) cells: Vec<CellState>,
    /// Where each cell's nodes begin in the table that is out.
    pub(super) first_node: Vec<u32>,
    pub(super) passes: u32,
    /// Samples per pixel that taught.
    pub(super) samples: u64,
    /// Fingerprint of the scene that it learns about.
    pub(super) scene: u64,
}

/// Fixed-point units per unit of radiance where nothing is brighter than `brightest`.
pub(super) fn fixed_point_unit(brightest: f32) -> f32 {
    // No more than f32 holds: radiance is then below what anyone could see.
    (UNIT_BITS as f32 - brightest.max(1e-30).log2().ceil()).min(126.0).exp2()
}

impl Learner {
    /// A learner for surface points between `low` and `high`. `brightest` is the largest radiance that anything emits.
    pub fn new(
        options: GuideOptions,
        low: Vec3,
        high: Vec3,
        brightest: f32,
    ) -> Result<Learner, LearnerError> {
        let bansal = options.mode.is_bansal();
        let (low, high) = if bansal { (Vec3::splat(-15.0), Vec3::splat(15.0)) } else { (low, high) };
        let extent = (high - low).max_element().max(1e-6);
        let wanted = options.cell_size.unwrap_or(if bansal { 0.5 } else { extent / BASE_CELLS });
        let size = wanted.max(extent / MOST_CELLS);
        let margin = if bansal { 0.0 } else { 0.03 * size };
        let cells = |extent: f32| ((extent + 2.0 * margin) / size).ceil().max(1.0) as u32;
        let [x, y, z] = (high - low).to_array().map(cells);
        let sectors = if options.mode == GuideMode::Adaptive { 6 } else { 1 };
        let uniforms = GuideUniforms {
            origin: low - margin,
            inverse_size: 1.0 / size,
            cells_x: x,
            cells_y: y,
            cells_z: z,
            sectors,
            unit: fixed_point_unit(brightest),
            mixture: options.mixture,
            lift: if bansal { 0.0 } else { 0.037 * size },
            threshold: options.threshold,
            discount: options.discount,
            ..Default::default()
        };
        let bytes = INDEX_BYTES * u64::from(uniforms.base_words());
        if bytes > options.memory {
            return Err(LearnerError::Memory { bytes, limit: options.memory });
        }
        let index = vec![NO_CELL; uniforms.base_words() as usize];
        Ok(Learner {
            options,
            uniforms,
            index,
            word_of: Vec::new(),
            cells: Vec::new(),
            first_node: Vec::new(),
            passes: 0,
            samples: 0,
            scene: 0,
        })
    }

    pub fn mode(&self) -> GuideMode {
        self.options.mode
    }

    /// How the sums of a pass with the current table are laid out.
    pub fn layout(&self) -> LessonLayout {
        LessonLayout::new(&self.uniforms)
    }

    /// Cells that exist.
    pub fn cells(&self) -> usize {
        self.cells.len()
    }

    /// Quadtree nodes that exist.
    pub fn nodes(&self) -> usize {
        self.cells.iter().map(|cell| cell.nodes.len()).sum()
    }

    /// Makes a cell, without knowledge, at each surface point's base cell that `missing` marks.
    pub fn make_cells(&mut self, missing: &[u32]) {
        for (word, &missed) in missing.iter().enumerate() {
            if missed != 0 && self.index[word] == NO_CELL {
                self.add_cell(word as u32, CellState::default());
            }
        }
    }

    fn add_cell(&mut self, word: u32, state: CellState) {
        self.index[word as usize] = self.cells.len() as u32;
        self.word_of.push(word);
        self.cells.push(state);
    }

    /// Takes in what a pass of `samples` samples per pixel taught.
    pub fn learn(&mut self, lessons: &Lessons, samples: u32) {
        // A level at most is added to each tree in a pass, so numbers of nodes stay within their 24 bits.
        let refines =
            self.options.depth > 0 && self.nodes() < MOST_NODES / 4 && self.bytes() <= self.options.memory;
        let pass = Pass { options: &self.options, uniforms: &self.uniforms, lessons, refines };
        let first_node = &self.first_node;
        let visits: Vec<f64> = self
            .cells
            .par_iter_mut()
            .enumerate()
            .with_min_len(64)
            .map(|(i, cell)| pass.update(cell, i, first_node[i] as usize))
            .collect();
        self.make_cells(&lessons.missing);
        if self.options.mode == GuideMode::Adaptive {
            self.cut_cells(lessons, &visits, SPLIT_VISITS * f64::from(samples.max(1)).sqrt());
        }
        self.passes += 1;
        self.samples += u64::from(samples);
    }

    /// Cuts cells that were met more than `limit` times into those of their eighths that hold surfaces.
    fn cut_cells(&mut self, lessons: &Lessons, visits: &[f64], limit: f64) {
        let mut bytes = self.bytes();
        for (cell, &count) in visits.iter().enumerate() {
            let full = bytes > self.options.memory || self.cells.len() + 8 > MOST_CELLS_IN_ALL;
            if count <= limit || self.cells[cell].level >= MAX_CELL_LEVELS || full {
                continue;
            }
            let met = &lessons.visits[8 * cell..8 * cell + 8];
            let parts: Vec<u32> = (0..8).filter(|&eighth| met[eighth as usize] > 0).collect();
            let state = &mut self.cells[cell];
            state.level += 1;
            state.visits.iter_mut().for_each(|v| *v /= parts.len().max(1) as f32);
            let state = state.clone();
            let copies = parts.len().saturating_sub(1) as u64;
            bytes += 8 * INDEX_BYTES + copies * self.cell_bytes(&state);
            let block = self.index.len() as u32;
            let parent = self.word_of[cell] as usize;
            self.index[parent] = FINER | block;
            // The cell itself becomes the first of its parts, and stands in for those that hold no surface.
            self.index.extend([cell as u32; 8]);
            self.word_of[cell] = block + parts.first().copied().unwrap_or(0);
            for part in parts.into_iter().skip(1) {
                self.add_cell(block + part, state.clone());
            }
        }
    }

    /// Bytes of the table and its sums, but for the estimates of the pixels.
    pub fn bytes(&self) -> u64 {
        self.table_bytes() + self.sums_bytes()
    }

    /// Bytes of the table, but for the estimates of the pixels.
    pub fn table_bytes(&self) -> u64 {
        let words: u64 = self.cells.par_iter().map(|cell| self.table_words(cell)).sum();
        16 * self.index.len() as u64 + 4 * words
    }

    /// Words of a cell in the table.
    fn table_words(&self, cell: &CellState) -> u64 {
        if self.options.mode == GuideMode::Adaptive { CellSize::of(cell).words() as u64 } else { 8 }
    }

    /// Bytes of a cell in the table and in the sums of a pass.
    fn cell_bytes(&self, cell: &CellState) -> u64 {
        4 * self.table_words(cell) + 128 + 32 * cell.nodes.len() as u64
    }

    /// Bytes of the sums of a pass.
    pub fn sums_bytes(&self) -> u64 {
        let counts = GuideUniforms {
            cell_count: self.cells.len() as u32,
            node_count: self.nodes() as u32,
            ..self.uniforms
        };
        4 * LessonLayout::new(&counts).words()
    }

    /// The table for the next pass. `pixels` are estimates of the pixels' luminances, for learnt roulette.
    pub fn table(&mut self, learning: bool, pixels: &[f32]) -> GuideTable {
        self.number_nodes();
        let adaptive = self.options.mode == GuideMode::Adaptive;
        let sizes: Vec<CellSize> = match adaptive {
            true => self.cells.par_iter().with_min_len(64).map(CellSize::of).collect(),
            false => Vec::new(),
        };
        let words_of = |cell: usize| if adaptive { sizes[cell].words() } else { 8 };
        let ends: Vec<usize> = (0..self.cells.len())
            .scan(0, |end, cell| {
                *end += words_of(cell);
                Some(*end)
            })
            .collect();
        let uniforms = &mut self.uniforms;
        uniforms.words_at = self.index.len() as u32;
        uniforms.pixels_at = uniforms.words_at + ends.last().unwrap_or(&0).div_ceil(4) as u32;
        uniforms.learning = learning.into();
        // All zeros: pages are first touched by the threads that fill them.
        let mut rows = vec![[0u32; 4]; uniforms.pixels_at as usize + pixels.len().div_ceil(4)];
        for (row, &word) in rows.iter_mut().zip(&self.index) {
            *row = match word {
                NO_CELL => [NO_CELL; 4],
                _ if word & FINER != 0 => [word & !FINER, FINER, 0, 0],
                cell => {
                    let first = ends[cell as usize] - words_of(cell as usize);
                    self.index_row(cell, first as u32, sizes.get(cell as usize))
                }
            };
        }
        self.fill_words(&mut rows[self.index.len()..], words_of, &sizes);
        for (word, pixel) in
            rows[self.uniforms.pixels_at as usize..].as_flattened_mut().iter_mut().zip(pixels)
        {
            *word = pixel.to_bits();
        }
        GuideTable { uniforms: self.uniforms, rows }
    }

    /// Fills in what cells have besides their rows of the index.
    fn fill_words(&self, rows: &mut [[u32; 4]], words_of: impl Fn(usize) -> usize, sizes: &[CellSize]) {
        let mut open = rows.as_flattened_mut();
        let mut places = Vec::with_capacity(self.cells.len());
        for (i, cell) in self.cells.iter().enumerate() {
            let (own, rest) = open.split_at_mut(words_of(i));
            places.push((cell, self.first_node[i], sizes.get(i), own));
            open = rest;
        }
        let nodes_at = 8 * self.uniforms.cell_count;
        places.into_par_iter().with_min_len(16).for_each(|(cell, first_node, size, own)| match size {
            Some(&size) => lay_out(cell, size, nodes_at + 4 * first_node, own),
            None => own.copy_from_slice(&cell.octants.map(f32::to_bits)),
        });
    }

    /// Numbers cells and nodes for the next pass.
    fn number_nodes(&mut self) {
        let mut nodes = 0;
        self.first_node.clear();
        for cell in &self.cells {
            self.first_node.push(nodes);
            nodes += cell.nodes.len() as u32;
        }
        self.uniforms.cell_count = self.cells.len() as u32;
        self.uniforms.node_count = nodes;
    }

    /// How the index tells of a cell whose words begin at `first`.
    fn index_row(&self, index: u32, first: u32, size: Option<&CellSize>) -> [u32; 4] {
        let cell = &self.cells[index as usize];
        let irradiance: f32 = cell.octants.iter().sum();
        let visits = if size.is_some() { cell.visits[0] } else { cell.visits.iter().sum() };
        let trust = match self.options.mode {
            _ if irradiance <= 0.0 => 0.0,
            GuideMode::Adaptive | GuideMode::Octant => visits / (visits + TRUSTED_VISITS),
            _ => 1.0,
        };
        // Before an adaptive cell's tickets comes a word of another kind.
        let (at, log_tickets) = size.map_or((first, 0), |size| (first + 1, size.log_tickets));
        Cell { index, at, log_tickets, irradiance, trust, ..Default::default() }.row()
    }
}

/// What updating a cell needs.
struct Pass<'a> {
    options: &'a GuideOptions,
    uniforms: &'a GuideUniforms,
    lessons: &'a Lessons,
    /// Whether trees may change their shape.
    refines: bool,
}

impl Pass<'_> {
    fn value(&self, slot: usize) -> f64 {
        self.lessons.values[slot] as f64 / f64::from(self.uniforms.unit)
    }

    fn visits(&self, at: usize) -> f64 {
        self.lessons.visits[at] as f64 / f64::from(VISIT_UNIT)
    }

    /// Takes in one cell's lessons; its visits in this pass.
    fn update(&self, cell: &mut CellState, index: usize, first_node: usize) -> f64 {
        match self.options.mode {
            GuideMode::Adaptive => self.update_quadtrees(cell, index, first_node),
            GuideMode::Octant => self.update_octants(cell, index),
            _ => self.update_bansal(cell, index),
        }
    }

    /// Q ← mean(T) weighted by the cosine over the density, over this pass and what earlier ones are still worth.
    fn update_octants(&self, cell: &mut CellState, index: usize) -> f64 {
        let memory = 1.0 - self.options.alpha.unwrap_or(0.75);
        let mut all = 0.0;
        for a in 0..8 {
            let (value, weight) = (self.value(8 * index + a) as f32, self.visits(8 * index + a) as f32);
            let kept = memory * cell.visits[a];
            if weight > 0.0 {
                cell.octants[a] = (kept * cell.octants[a] + value) / (kept + weight);
                cell.visits[a] = kept + weight;
            }
            all += f64::from(weight);
        }
        all
    }

    /// n updates Q ← (1 − α)·Q + α·T at once.
    fn update_bansal(&self, cell: &mut CellState, index: usize) -> f64 {
        let alpha = f64::from(self.options.alpha.unwrap_or(1e-4));
        let mut all = 0.0;
        for a in 0..8 {
            let visits = self.visits(8 * index + a);
            if visits > 0.0 {
                let kept = (visits * (-alpha).ln_1p()).exp();
                let mean = self.value(8 * index + a) / visits;
                cell.octants[a] = (kept * f64::from(cell.octants[a]) + (1.0 - kept) * mean) as f32;
            }
            all += visits;
        }
        all
    }

    fn update_quadtrees(&self, cell: &mut CellState, index: usize, first_node: usize) -> f64 {
        let visits: f64 = (0..8).map(|eighth| self.visits(8 * index + eighth)).sum();
        if visits <= 0.0 {
            return 0.0;
        }
        let memory = 1.0 - self.options.alpha.unwrap_or(0.75);
        let kept = memory * cell.visits[0];
        let old = kept / (kept + visits as f32);
        let new = (1.0 - f64::from(old)) / visits;
        cell.visits = [kept + visits as f32; 8];
        let blend = |energy: &mut f32, slot: usize| *energy = *energy * old + (self.value(slot) * new) as f32;
        let node_slots = 8 * self.uniforms.cell_count as usize + 4 * first_node;
        // Leaves learn; nodes add up what lies below them, deepest first.
        for i in (0..cell.nodes.len()).rev() {
            for q in 0..4 {
                let below = child_of(cell.nodes[i].children, 4, q as u32)
                    .map(|child| cell.nodes[child].energies.iter().sum());
                let energy = &mut cell.nodes[i].energies[q];
                match below {
                    Some(sum) => *energy = sum,
                    None => blend(energy, node_slots + 4 * i + q),
                }
            }
        }
        for a in 0..8 {
            match child_of(cell.roots, 8, a as u32) {
                Some(root) => cell.octants[a] = cell.nodes[root].energies.iter().sum(),
                None => blend(&mut cell.octants[a], 8 * index + a),
            }
        }
        if self.refines {
            refine(cell, self.options.depth);
        }
        visits
    }
}

/// Cuts leaves that hold much of the cell's irradiance, one level at a time, and joins those that hold little.
fn refine(cell: &mut CellState, depth: u32) {
    let total: f32 = cell.octants.iter().sum();
    let limit = SPLIT_SHARE.max(SPLIT_SUPPORT / cell.visits[0].max(1.0)) * total;
    let old = std::mem::take(&mut cell.nodes);
    /// A node to be emitted: the one that it was, or the energy of the leaf that it was.
    type Source = (Option<usize>, f32, u32);
    let mut queue: Vec<Source> = Vec::new();
    let mut nodes: Vec<NodeState> = Vec::new();
    let mut mask = 0;
    for a in 0..8 {
        if cell.octants[a] > limit && depth > 0 {
            mask |= 1 << a;
            queue.push((child_of(cell.roots, 8, a as u32), cell.octants[a], 1));
        }
    }
    cell.roots = mask;
    let mut next = 0;
    while next < queue.len() {
        let (was, energy, level) = queue[next];
        next += 1;
        let energies = was.map_or([0.25 * energy; 4], |i| old[i].energies);
        let first = queue.len() as u32;
        let mut mask = 0;
        for (q, &energy) in energies.iter().enumerate() {
            // A leaf that was cut just now is not cut further before it has learnt.
            if energy > limit && level < depth && was.is_some() {
                mask |= 1 << q;
                let child = was.and_then(|i| child_of(old[i].children, 4, q as u32));
                queue.push((child, energy, level + 1));
            }
        }
        nodes.push(NodeState { energies, children: first << 4 | mask });
    }
    cell.nodes = nodes;
}
