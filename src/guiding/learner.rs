//! The learner: what was learnt, between passes. Engines commit the lessons of a pass to it; here cells are made where paths
//! meet surfaces, and what is known is laid out for the next pass.

use super::commit::commit;
use super::layout::{Layout, put_pixels, words_of};
use super::lessons::{LessonLayout, Lessons};
use super::state::{CellState, Committed, GuideState, GuideUpdate, Stale};
use super::table::{CELL_BITS, GuideTable, GuideUniforms, NO_CELL};
use super::{GuideMode, GuideOptions};
use glam::Vec3;
use rayon::prelude::*;

/// Base cells along the longest side, where nothing else is asked for.
const BASE_CELLS: f32 = 16.0;
/// Base cells along any side at most.
const MOST_CELLS: f32 = 128.0;
/// Bytes of a row of the index, and of a pass's mark for it.
pub(super) const INDEX_BYTES: u64 = 16 + 4;
/// Bytes of a cell and of a quadtree node in the sums of a pass.
const CELL_SUM_BYTES: u64 = 2 * 64;
const NODE_SUM_BYTES: u64 = 32;
/// Bytes of a cell and of a quadtree node in what is known, the trees' words included.
const CELL_STATE_BYTES: u64 = 64 + 16;
const NODE_STATE_BYTES: u64 = 16 + 4;
/// Adaptive: bytes of how often a cell was met in a pass.
const MET_BYTES: u64 = 32;
/// Fixed-point units per unit of radiance, as a power of two below the brightest emitter.
const UNIT_BITS: i32 = 36;

/// Quadtree nodes that are learnt about at most, and cells that a row of the index can number.
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

/// Everything that was learnt, between passes.
#[derive(Clone, Debug, PartialEq)]
pub struct Learner {
    pub(super) options: GuideOptions,
    /// But for what [`Learner::uniforms`] derives.
    pub(super) grid: GuideUniforms,
    /// A word for each row of the table's index: the number of a cell, the first of eight finer words, or none.
    pub(super) index: Vec<u32>,
    /// Cuts of a base cell that led to each cell.
    pub(super) levels: Vec<u32>,
    pub(super) state: GuideState,
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
        let grid = GuideUniforms {
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
        let bytes = INDEX_BYTES * u64::from(grid.base_words());
        if bytes > options.memory {
            return Err(LearnerError::Memory { bytes, limit: options.memory });
        }
        let index = vec![NO_CELL; grid.base_words() as usize];
        Ok(Learner {
            options,
            grid,
            index,
            levels: Vec::new(),
            state: GuideState::default(),
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
        LessonLayout::new(&self.counted())
    }

    /// What it knows.
    pub fn state(&self) -> &GuideState {
        &self.state
    }

    /// Cells that exist.
    pub fn cells(&self) -> usize {
        self.state.cells.len()
    }

    /// Quadtree nodes that exist.
    pub fn nodes(&self) -> usize {
        self.state.nodes.len()
    }

    /// Makes a cell, without knowledge, at each surface point's base cell that `missing` marks; whether there were any.
    pub fn make_cells(&mut self, missing: &[u32]) -> bool {
        let before = self.cells();
        for (word, &missed) in missing.iter().enumerate() {
            if missed != 0 && self.index[word] == NO_CELL && self.cells() < MOST_CELLS_IN_ALL {
                self.state.push(word as u32, CellState::default(), 0, &[], &[]);
                self.enter_cell(word as u32, 0);
            }
        }
        self.cells() > before
    }

    /// Has a word of the index lead to the last cell.
    pub(super) fn enter_cell(&mut self, word: u32, level: u32) {
        self.index[word as usize] = self.levels.len() as u32;
        self.levels.push(level);
    }

    /// Takes in what a pass of `samples` samples per pixel taught, as the CPU engine commits it.
    pub fn learn(&mut self, lessons: &Lessons, samples: u32) {
        let mut table = self.table(true, &[]);
        let met = commit(self.mode(), &table.uniforms, lessons, &mut self.state, &mut table.rows);
        self.refine(&met, &lessons.missing, samples);
        self.count_pass(samples);
    }

    /// Takes in what an engine committed after a pass of `samples` samples per pixel; what of its table is not as it should be
    /// then.
    pub fn take_in(&mut self, committed: Committed, samples: u32) -> Stale {
        self.state.cells = committed.cells;
        self.state.nodes = committed.nodes;
        self.count_pass(samples);
        match self.refine(&committed.met, &committed.missing, samples) {
            true => Stale::State,
            // Every ticket of a cell depends on all its energies.
            false if self.mode() == GuideMode::Adaptive => Stale::Rows,
            false => Stale::Pixels,
        }
    }

    fn count_pass(&mut self, samples: u32) {
        self.passes += 1;
        self.samples += u64::from(samples);
    }

    /// Bytes of the table, its sums and what is known, but for the estimates of the pixels.
    pub fn bytes(&self) -> u64 {
        self.table_bytes() + self.sums_bytes() + self.state_bytes()
    }

    /// Bytes of the table, but for the estimates of the pixels.
    pub fn table_bytes(&self) -> u64 {
        let words: u64 = (0..self.cells()).into_par_iter().map(|cell| self.table_words(cell)).sum();
        16 * self.index.len() as u64 + 4 * words
    }

    /// Words of a cell in the table.
    fn table_words(&self, cell: usize) -> u64 {
        u64::from(words_of(self.mode(), &self.state.cell(cell)))
    }

    /// Bytes of the sums of a pass.
    pub fn sums_bytes(&self) -> u64 {
        4 * self.layout().words()
    }

    /// Bytes of what is known, and of how often cells were met.
    pub fn state_bytes(&self) -> u64 {
        self.cell_state_bytes() * self.cells() as u64 + NODE_STATE_BYTES * self.nodes() as u64
    }

    /// … of a cell without its nodes.
    fn cell_state_bytes(&self) -> u64 {
        CELL_STATE_BYTES + if self.mode() == GuideMode::Adaptive { MET_BYTES } else { 0 }
    }

    /// Bytes of a cell: in the table, in the sums of a pass, in what is known.
    pub(super) fn cell_bytes(&self, cell: usize) -> u64 {
        let nodes = (NODE_SUM_BYTES + NODE_STATE_BYTES) * u64::from(self.state.trees[cell].nodes);
        4 * self.table_words(cell) + CELL_SUM_BYTES + self.cell_state_bytes() + nodes
    }

    /// The grid with the numbers of cells and nodes.
    fn counted(&self) -> GuideUniforms {
        let (cell_count, node_count) = (self.cells() as u32, self.nodes() as u32);
        GuideUniforms { cell_count, node_count, ..self.grid }
    }

    /// The numbers of the next pass.
    fn uniforms(&self, layout: &Layout, learning: bool) -> GuideUniforms {
        let alpha = self.options.alpha;
        let memory = match self.mode() {
            // Any visit is beyond that, and no number of them too large for an f32.
            mode if mode.is_bansal() => (-f64::from(-alpha.unwrap_or(1e-4)).ln_1p()).min(1e20) as f32,
            _ => 1.0 - alpha.unwrap_or(0.75),
        };
        let (words_at, pixels_at) = (layout.words_at(), layout.pixels_at());
        GuideUniforms { words_at, pixels_at, learning: learning.into(), memory, ..self.counted() }
    }

    /// What an engine needs for the next pass where so much of its table is `stale`. `pixels` are estimates of the pixels'
    /// luminances, for learnt roulette.
    pub fn update<'a>(&'a self, learning: bool, stale: Stale, pixels: &'a [f32]) -> GuideUpdate<'a> {
        let layout = Layout::new(self.mode(), &self.index, &self.state);
        GuideUpdate {
            uniforms: self.uniforms(&layout, learning),
            rows: (stale >= Stale::Rows).then(|| layout.rows(pixels)),
            state: (stale >= Stale::State).then_some(&self.state),
            pixels,
        }
    }

    /// The table for the next pass, as the CPU engine has it.
    pub fn table(&self, learning: bool, pixels: &[f32]) -> GuideTable {
        let mut table = GuideTable::default();
        table.update(self.update(learning, Stale::State, pixels));
        table
    }
}

impl GuideTable {
    /// The table of the next pass.
    pub fn update(&mut self, update: GuideUpdate) {
        self.uniforms = update.uniforms;
        match update.rows {
            Some(rows) => self.rows = rows,
            None => put_pixels(&mut self.rows[update.uniforms.pixels_at as usize..], update.pixels),
        }
    }
}
