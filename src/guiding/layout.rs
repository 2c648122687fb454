//! How what is known lies in the table: the index, a row per word of it, then cell after cell what it has learnt, then the
//! estimates of the pixels. The host's work; where nothing but numbers change, and there are no quadtrees, a commit writes
//! them in place ([`super::commit`]).

use super::GuideMode;
use super::commit::{OCTANT_WORDS, cell_row};
use super::state::{GuideState, KnownCell, Row};
use super::table::{Cell, FINER, NO_CELL};
use super::tickets::{CellSize, lay_out};
use rayon::prelude::*;

/// Where each cell's words are.
pub(super) struct Layout<'a> {
    mode: GuideMode,
    index: &'a [u32],
    state: &'a GuideState,
    /// Adaptive: of all cells; else none.
    sizes: Vec<CellSize>,
    /// Where the words of each cell begin, and where the last of them ends.
    places: Vec<u32>,
}

/// Words of a cell behind the index.
pub(super) fn words_of(mode: GuideMode, cell: &KnownCell) -> u32 {
    if mode == GuideMode::Adaptive { CellSize::of(cell).words() as u32 } else { OCTANT_WORDS }
}

impl<'a> Layout<'a> {
    pub(super) fn new(mode: GuideMode, index: &'a [u32], state: &'a GuideState) -> Layout<'a> {
        let cells = (0..state.cells.len()).into_par_iter().with_min_len(64);
        let sizes: Vec<CellSize> = match mode {
            GuideMode::Adaptive => cells.map(|cell| CellSize::of(&state.cell(cell))).collect(),
            _ => Vec::new(),
        };
        let words = |cell: usize| sizes.get(cell).map_or(OCTANT_WORDS, |size| size.words() as u32);
        let mut places = vec![0];
        let mut end = 0;
        places.extend((0..state.cells.len()).map(|cell| {
            end += words(cell);
            end
        }));
        Layout { mode, index, state, sizes, places }
    }

    /// The row behind the index.
    pub(super) fn words_at(&self) -> u32 {
        self.index.len() as u32
    }

    /// The row behind all that cells have learnt.
    pub(super) fn pixels_at(&self) -> u32 {
        self.words_at() + self.places[self.state.cells.len()].div_ceil(4)
    }

    /// All rows of the table.
    pub(super) fn rows(&self, pixels: &[f32]) -> Vec<Row> {
        // All zeros: pages are first touched by the threads that fill them.
        let mut rows = vec![[0u32; 4]; self.pixels_at() as usize + pixels.len().div_ceil(4)];
        for (row, &word) in rows.iter_mut().zip(self.index) {
            *row = match word {
                NO_CELL => [NO_CELL; 4],
                _ if word & FINER != 0 => [word & !FINER, FINER, 0, 0],
                cell => self.cell_row(cell),
            };
        }
        self.fill_words(rows[self.index.len()..].as_flattened_mut());
        put_pixels(&mut rows[self.pixels_at() as usize..], pixels);
        rows
    }

    /// How the index tells of a cell.
    fn cell_row(&self, index: u32) -> Row {
        let first = self.places[index as usize];
        // Before an adaptive cell's tickets comes a word of another kind.
        let (at, log_tickets) =
            self.sizes.get(index as usize).map_or((first, 0), |size| (first + 1, size.log_tickets));
        let place = Cell { index, at, log_tickets, ..Default::default() };
        cell_row(self.mode, &self.state.cells[index as usize], place)
    }

    /// Fills in what cells have besides their rows of the index.
    fn fill_words(&self, mut words: &mut [u32]) {
        let mut places = Vec::with_capacity(self.state.cells.len());
        for ends in self.places.windows(2) {
            places.push(words.split_off_mut(..(ends[1] - ends[0]) as usize).unwrap_or_default());
        }
        let first_slot = 8 * self.state.cells.len() as u32;
        places.into_par_iter().enumerate().with_min_len(16).for_each(|(number, words)| {
            let cell = self.state.cell(number);
            match self.sizes.get(number) {
                Some(&size) => lay_out(&cell, size, first_slot + 4 * cell.trees.first_node, words),
                None => words.copy_from_slice(&cell.cell.octants.map(f32::to_bits)),
            }
        });
    }
}

/// Puts estimates of the pixels' luminances in place, four to a row.
pub(super) fn put_pixels(rows: &mut [Row], pixels: &[f32]) {
    for (word, pixel) in rows.as_flattened_mut().iter_mut().zip(pixels) {
        *word = pixel.to_bits();
    }
}
