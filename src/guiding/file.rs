//! What was learnt, as a file: docs/GUIDE_FORMAT.md. Files are data from anywhere: damaged, truncated or lying ones are
//! errors, never a panic, and never take memory out of proportion to their own size.

use super::learner::{Learner, LearnerError, MOST_CELLS_IN_ALL, MOST_NODES, fixed_point_unit};
use super::quadtree::MAX_DEPTH;
use super::state::{CellState, GuideState, NodeState};
use super::table::{FINER, GuideTable, GuideUniforms, MAX_CELL_LEVELS, NO_CELL};
use super::tickets::MOST_CELL_NODES;
use super::{GuideMode, GuideOptions};
use crate::film::{Draft, ImageError};
use crate::math::fnv1a;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// First bytes of every file.
const MAGIC: &[u8; 8] = b"QTGUIDE\n";
/// The version that is written and read.
pub const VERSION: u32 = 1;
/// Modes by their number in files, from 1.
const MODES: [GuideMode; 4] =
    [GuideMode::Bansal, GuideMode::BansalReweighted, GuideMode::Octant, GuideMode::Adaptive];
/// Words of a cell: eight values, eight visits, roots, level, number of nodes, its word of the index.
const CELL_WORDS: usize = 20;
/// Words of a node: four energies, children.
const NODE_WORDS: usize = 5;
/// Energies above this are damage; below, no sum of them is infinite.
const LARGEST_ENERGY: f32 = 1e36;

/// Why a file of what was learnt could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum GuideFileError {
    #[error(transparent)]
    Write(#[from] ImageError),
    #[error("cannot read \"{}\": {source}; check the name, and that it is a readable file", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("cannot read \"{}\": {reason}; save it anew with --save-guide", path.display())]
    Damaged { path: PathBuf, reason: String },
    #[error(
        "cannot read \"{}\": it has version {version} of the format, this program knows {VERSION}; use a newer qtracer or save it anew with --save-guide",
        path.display()
    )]
    Newer { path: PathBuf, version: u32 },
}

/// What is wrong with the bytes.
#[derive(Debug, PartialEq)]
enum Fault {
    Damaged(String),
    Newer(u32),
}

impl Fault {
    fn in_file(self, path: &Path) -> GuideFileError {
        match self {
            Fault::Damaged(reason) => GuideFileError::Damaged { path: path.into(), reason },
            Fault::Newer(version) => GuideFileError::Newer { path: path.into(), version },
        }
    }
}

fn damaged<T>(reason: impl Into<String>) -> Result<T, Fault> {
    Err(Fault::Damaged(reason.into()))
}

/// Reads little-endian numbers, never beyond the end.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8], Fault> {
        match self.0.split_at_checked(count) {
            Some((head, tail)) => {
                self.0 = tail;
                Ok(head)
            }
            None => damaged("it ends too early"),
        }
    }

    fn u32(&mut self) -> Result<u32, Fault> {
        Ok(word(self.bytes(4)?))
    }

    fn u64(&mut self) -> Result<u64, Fault> {
        Ok(u64::from(self.u32()?) | u64::from(self.u32()?) << 32)
    }

    fn f32(&mut self) -> Result<f32, Fault> {
        Ok(f32::from_bits(self.u32()?))
    }

    /// A section: its name, its length in bytes, that many bytes, which are whole items of `words` words.
    fn section(&mut self, name: &str, words: usize) -> Result<impl Iterator<Item = Vec<u32>> + 'a, Fault> {
        if self.bytes(4)? != name.as_bytes() {
            return damaged(format!("its section {name} is missing"));
        }
        let length = self.u64()?;
        match usize::try_from(length) {
            Ok(length) if length <= self.0.len() && length % (4 * words) == 0 => {
                let items = self.bytes(length)?.chunks_exact(4 * words);
                Ok(items.map(|item| item.chunks_exact(4).map(word).collect()))
            }
            _ => damaged(format!("its section {name} says that it has {length} bytes")),
        }
    }
}

fn word(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte))
}

fn put(out: &mut Vec<u8>, words: impl IntoIterator<Item = u32>) {
    words.into_iter().for_each(|word| out.extend(word.to_le_bytes()));
}

fn put_section(out: &mut Vec<u8>, name: &str, words: impl Iterator<Item = u32>) {
    out.extend(name.as_bytes());
    let length_at = out.len();
    out.extend([0; 8]);
    put(out, words);
    let length = (out.len() - length_at - 8) as u64;
    out[length_at..length_at + 8].copy_from_slice(&length.to_le_bytes());
}

impl Learner {
    /// Fingerprint of the scene that it learns about, 0 if that was never told.
    pub fn scene(&self) -> u64 {
        self.scene
    }

    /// Tells it which scene it learns about.
    pub fn set_scene(&mut self, fingerprint: u64) {
        self.scene = fingerprint;
    }

    /// Lessons taken in.
    pub fn passes(&self) -> u32 {
        self.passes
    }

    /// Samples per pixel that taught.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// The choices with which it learns.
    pub fn options(&self) -> &GuideOptions {
        &self.options
    }

    /// Edge of a base cell.
    pub fn cell_size(&self) -> f32 {
        1.0 / self.grid.inverse_size
    }

    /// The table as it stands, to be looked at.
    pub fn snapshot(&self) -> GuideTable {
        self.table(false, &[])
    }

    /// A learner that goes on from here with other options; its cells stay where they are. `brightest` is the largest
    /// radiance that anything emits in the scene that it meets now.
    pub fn resumed(&self, options: GuideOptions, brightest: f32) -> Result<Learner, LearnerError> {
        if options.mode != self.mode() {
            return Err(LearnerError::Mode { learnt: self.mode(), wanted: options.mode });
        }
        let bytes = self.bytes();
        if bytes > options.memory {
            return Err(LearnerError::LearntMemory { bytes, limit: options.memory });
        }
        let grid = GuideUniforms {
            unit: fixed_point_unit(brightest),
            mixture: options.mixture,
            threshold: options.threshold,
            discount: options.discount,
            ..self.grid
        };
        Ok(Learner { options, grid, ..self.clone() })
    }

    /// Writes what was learnt. The target is replaced only by a complete file.
    pub fn save(&self, path: &Path) -> Result<(), GuideFileError> {
        let mut draft = Draft::new(path)?;
        let written = draft.writer.write_all(&self.to_bytes()).and_then(|()| draft.publish());
        written.map_err(|source| ImageError::Write { path: path.into(), source })?;
        Ok(())
    }

    /// Whether [`Learner::save`] can work, to be asked before hours of rendering. Leaves nothing behind.
    pub fn check_writable(path: &Path) -> Result<(), GuideFileError> {
        Ok(Draft::new(path).map(drop)?)
    }

    /// Reads what was learnt before. Options that the file does not say have their defaults; see [`Learner::resumed`].
    pub fn load(path: &Path) -> Result<Learner, GuideFileError> {
        let bytes = read_file(path).map_err(|source| GuideFileError::Read { path: path.into(), source })?;
        from_bytes(&bytes).map_err(|fault| fault.in_file(path))
    }

    /// Reads the bytes of such a file.
    pub fn from_bytes(bytes: &[u8]) -> Result<Learner, GuideFileError> {
        from_bytes(bytes).map_err(|fault| fault.in_file(Path::new("memory")))
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        let mode = MODES.iter().position(|&mode| mode == self.mode()).map_or(0, |at| at as u32 + 1);
        put(&mut out, [VERSION, mode]);
        out.extend(self.scene.to_le_bytes());
        out.extend(self.samples.to_le_bytes());
        let u = &self.grid;
        put(&mut out, [self.passes]);
        put(&mut out, u.origin.to_array().map(f32::to_bits));
        put(
            &mut out,
            [u.inverse_size.to_bits(), u.lift.to_bits(), u.cells_x, u.cells_y, u.cells_z, u.sectors],
        );
        put_section(&mut out, "INDX", self.index.iter().copied());
        put_section(&mut out, "CELL", (0..self.cells()).flat_map(|cell| self.cell_words(cell)));
        let nodes = self.state.nodes.iter().zip(&self.state.children);
        put_section(&mut out, "NODE", nodes.flat_map(node_words));
        let checksum = fnv1a([out.as_slice()]);
        out.extend(checksum.to_le_bytes());
        out
    }

    fn cell_words(&self, number: usize) -> [u32; CELL_WORDS] {
        let (cell, trees) = (&self.state.cells[number], &self.state.trees[number]);
        let mut words = [0; CELL_WORDS];
        words[..8].copy_from_slice(&cell.octants.map(f32::to_bits));
        words[8..16].copy_from_slice(&cell.visits.map(f32::to_bits));
        words[16..].copy_from_slice(&[trees.roots, self.levels[number], trees.nodes, trees.row]);
        words
    }
}

/// Devices and pipes may have no end.
fn read_file(path: &Path) -> io::Result<Vec<u8>> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(io::Error::other("it is no regular file"));
    }
    std::fs::read(path)
}

fn node_words((energies, &children): (&NodeState, &u32)) -> [u32; NODE_WORDS] {
    let [a, b, c, d] = energies.map(f32::to_bits);
    [a, b, c, d, children]
}

fn from_bytes(bytes: &[u8]) -> Result<Learner, Fault> {
    if !bytes.starts_with(MAGIC) {
        return damaged("it is no file of what a guide has learnt");
    }
    let mut reader = Reader(&bytes[MAGIC.len()..]);
    let version = reader.u32()?;
    match version {
        VERSION => (),
        0 => return damaged("it has no version"),
        newer => return Err(Fault::Newer(newer)),
    }
    let (body, checksum) = match bytes.split_last_chunk::<8>() {
        Some((body, checksum)) if body.len() >= MAGIC.len() + 4 => (body, u64::from_le_bytes(*checksum)),
        _ => return damaged("it ends too early"),
    };
    if fnv1a([body]) != checksum {
        return damaged("it is damaged or cut short: its checksum is wrong");
    }
    let mut reader = Reader(&body[MAGIC.len() + 4..]);
    let learner = read_body(&mut reader)?;
    match reader.0 {
        [] => Ok(learner),
        rest => damaged(format!("{} bytes follow its last section", rest.len())),
    }
}

fn read_body(reader: &mut Reader) -> Result<Learner, Fault> {
    let number = reader.u32()?;
    let Some(&mode) = number.checked_sub(1).and_then(|at| MODES.get(at as usize)) else {
        return damaged(format!("it has an unknown kind of guide, {number}"));
    };
    let (scene, samples, passes) = (reader.u64()?, reader.u64()?, reader.u32()?);
    let options = GuideOptions { mode, ..Default::default() };
    let grid = read_grid(reader, &options)?;
    let index: Vec<u32> = reader.section("INDX", 1)?.flatten().collect();
    let levels = levels(&index, &grid)?;
    let cells: Vec<Vec<u32>> = reader.section("CELL", CELL_WORDS)?.collect();
    let mut nodes = reader.section("NODE", NODE_WORDS)?;
    let mut learner = Learner {
        options,
        grid,
        levels: cells.iter().map(|words| words[17]).collect(),
        state: GuideState::default(),
        index,
        passes,
        samples,
        scene,
    };
    for (number, words) in cells.iter().enumerate() {
        read_cell(words, &mut nodes, mode, &mut learner.state)?;
        let word = words[19] as usize;
        if learner.index.get(word) != Some(&(number as u32)) || levels[word] != words[17] {
            return damaged(format!("cell {number} is not where it says"));
        }
    }
    if nodes.next().is_some() {
        return damaged("it has nodes that belong to no cell");
    }
    check_counts(&learner)?;
    Ok(learner)
}

fn read_grid(reader: &mut Reader, options: &GuideOptions) -> Result<GuideUniforms, Fault> {
    let mut origin = [0.0; 3];
    for axis in &mut origin {
        *axis = reader.f32()?;
    }
    let uniforms = GuideUniforms {
        origin: origin.into(),
        inverse_size: reader.f32()?,
        lift: reader.f32()?,
        cells_x: reader.u32()?,
        cells_y: reader.u32()?,
        cells_z: reader.u32()?,
        sectors: reader.u32()?,
        unit: fixed_point_unit(1.0),
        mixture: options.mixture,
        threshold: options.threshold,
        discount: options.discount,
        ..Default::default()
    };
    let sectors = if options.mode == GuideMode::Adaptive { 6 } else { 1 };
    let scale = uniforms.inverse_size;
    let sane = uniforms.origin.is_finite()
        && scale.is_normal()
        && scale > 0.0
        && uniforms.lift.is_finite()
        && uniforms.lift >= 0.0
        && [uniforms.cells_x, uniforms.cells_y, uniforms.cells_z].iter().all(|&cells| cells > 0)
        && uniforms.sectors == sectors;
    if sane { Ok(uniforms) } else { damaged("its grid makes no sense") }
}

/// How many cuts lead to each word of the index. Cut cells lead strictly forward, each to eight words of its own.
fn levels(index: &[u32], uniforms: &GuideUniforms) -> Result<Vec<u32>, Fault> {
    let sides = [uniforms.cells_x, uniforms.cells_y, uniforms.cells_z, uniforms.sectors];
    let base = sides.iter().try_fold(1u32, |product, &side| product.checked_mul(side));
    let base = match base.map(|base| base as usize) {
        Some(base) if base <= index.len() && (index.len() - base).is_multiple_of(8) => base,
        _ => return damaged("its index does not fit its grid"),
    };
    const UNREACHED: u32 = u32::MAX;
    let mut levels = vec![UNREACHED; index.len()];
    levels[..base].fill(0);
    for (at, &word) in index.iter().enumerate() {
        let level = levels[at];
        if level == UNREACHED || (word == NO_CELL && at >= base) {
            return damaged(format!("word {at} of its index leads nowhere or is led to by none"));
        }
        if word == NO_CELL || word & FINER == 0 {
            continue;
        }
        let block = (word & !FINER) as usize;
        let whole = block > at && block >= base && (block - base).is_multiple_of(8) && block < index.len();
        if !whole || level >= MAX_CELL_LEVELS || levels[block] != UNREACHED {
            return damaged(format!("word {at} of its index leads astray"));
        }
        levels[block..block + 8].fill(level + 1);
    }
    Ok(levels)
}

fn energies<const N: usize>(words: &[u32]) -> Result<[f32; N], Fault> {
    let values: [f32; N] = std::array::from_fn(|i| f32::from_bits(words[i]));
    let sane = |value: &f32| (0.0..=LARGEST_ENERGY).contains(value);
    if values.iter().all(sane) { Ok(values) } else { damaged("it has energies that are none") }
}

fn read_cell(
    words: &[u32],
    nodes: &mut impl Iterator<Item = Vec<u32>>,
    mode: GuideMode,
    state: &mut GuideState,
) -> Result<(), Fault> {
    let (roots, count) = (words[16], words[18]);
    let cell = CellState { octants: energies(&words[..8])?, visits: energies(&words[8..16])? };
    if count as usize > MOST_CELL_NODES {
        return damaged("it has a cell with too many nodes");
    }
    let (mut known, mut children) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let Some(words) = nodes.next() else { return damaged("it has too few nodes") };
        known.push(energies(&words)?);
        children.push(words[4]);
    }
    if !is_breadth_first(roots, &children) || (mode != GuideMode::Adaptive && count > 0) {
        return damaged("its quadtrees make no sense");
    }
    state.push(words[19], cell, roots, &known, &children);
    Ok(())
}

/// Whether each node but the roots follows its parent, in the order in which parents lie, and none lies too deep.
fn is_breadth_first(roots: u32, children: &[u32]) -> bool {
    if roots >> 8 != 0 {
        return false;
    }
    let mut depths = vec![1; roots.count_ones() as usize];
    for (at, &children) in children.iter().enumerate() {
        let Some(&depth) = depths.get(at) else { return false };
        if (children >> 4) as usize != depths.len() || depth > MAX_DEPTH {
            return false;
        }
        depths.extend(std::iter::repeat_n(depth + 1, (children & 15).count_ones() as usize));
    }
    depths.len() == children.len()
}

/// Every cell that the index names exists, and slots can be numbered in 31 bits.
fn check_counts(learner: &Learner) -> Result<(), Fault> {
    let cells = learner.cells();
    let named = learner.index.iter().filter(|&&word| word & FINER == 0);
    if named.clone().any(|&cell| cell as usize >= cells) {
        return damaged("its index names cells that it does not have");
    }
    // Kernels of the other guides look for no finer cells.
    if learner.mode() != GuideMode::Adaptive
        && learner.index.iter().any(|&word| word != NO_CELL && word & FINER != 0)
    {
        return damaged("its index has finer cells, which its guide never makes");
    }
    // A commit keeps one row of the index per cell up to date, where it writes any.
    if learner.mode() != GuideMode::Adaptive && named.count() != cells {
        return damaged("its index names cells twice");
    }
    match 8 * cells as u64 + 4 * learner.nodes() as u64 {
        slots if slots < 1 << 31 && learner.nodes() < MOST_NODES && cells <= MOST_CELLS_IN_ALL => Ok(()),
        _ => damaged("it has too many cells"),
    }
}

#[cfg(test)]
#[path = "file_tests.rs"]
mod tests;
