//! The guide on the GPU: its table, what is known, and what is learnt lie there from pass to pass. At a pass's end a kernel
//! commits the sums; the host reads what is known then, refines it, and sends back what is stale: of guides without quadtrees
//! nothing as long as no cell is made, of those with them the table, and what is known where its shape changed.

use super::RenderError;
use super::gpu_film::GpuFilm;
use crate::gpu::error::GpuError;
use crate::gpu::kernel::Kernel;
use crate::gpu::stage::{CELLS_AT_ONCE, GRID_WIDTH, Stage};
use crate::guiding::state::{CELL_STATE_ROWS, CellState, CellTrees, Committed, NodeState};
use crate::guiding::{GuideMode, GuideUniforms, GuideUpdate, LessonLayout};
use rayon::prelude::*;
use std::mem::size_of_val;
use wgpu::{BufferUsages, CommandEncoder};

/// What a pass's end needs of the table that is in place.
#[derive(Debug, Default)]
pub struct GpuLessons {
    /// How the sums of what is learnt lie in their buffer.
    layout: LessonLayout,
    cells: u32,
    nodes: u32,
    /// What is known comes to the host here. Kept from pass to pass: new ones cost page faults.
    staging: Option<wgpu::Buffer>,
    pending: Option<Commit>,
}

impl GpuFilm {
    /// Puts a guide in place and clears the sums; true if bind groups must be made anew.
    pub fn set_guide(&mut self, update: &GuideUpdate) -> Result<bool, RenderError> {
        if !self.is_bound("guide_rows") {
            return Ok(false);
        }
        let uniforms = &update.uniforms;
        self.lessons.layout = LessonLayout::new(uniforms);
        (self.lessons.cells, self.lessons.nodes) = (uniforms.cell_count, uniforms.node_count);
        let grown = self.reserve_guide(update)?;
        self.write_guide("guide", 0, uniforms);
        match &update.rows {
            Some(rows) => self.write_guide_slice("guide_rows", 0, rows),
            None => {
                self.write_guide_slice("guide_rows", 16 * u64::from(uniforms.pixels_at), update.pixels);
            }
        }
        if let Some(state) = update.state {
            self.write_guide_slice("guide_state", 0, &state.cells);
            self.write_guide_slice("guide_state", size_of_val(&*state.cells) as u64, &state.nodes);
            self.write_guide_slice("guide_trees", 0, &state.trees);
            self.write_guide_slice("guide_trees", size_of_val(&*state.trees) as u64, &state.children);
        }
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        encoder.clear_buffer(self.buffers.get("lessons"), 0, None);
        self.gpu.queue.submit([encoder.finish()]);
        self.stats.buffers = self.buffers.bytes();
        self.gpu.check()?;
        Ok(grown)
    }

    /// Makes the buffers large enough; true if any was replaced.
    fn reserve_guide(&mut self, update: &GuideUpdate) -> Result<bool, RenderError> {
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let pixel_rows = update.pixels.len().div_ceil(4) as u64;
        let trees =
            size_of::<CellTrees>() as u64 * u64::from(self.lessons.cells) + 4 * u64::from(self.lessons.nodes);
        let wanted = [
            (
                "guide_rows",
                16 * (u64::from(update.uniforms.pixels_at) + pixel_rows),
                storage | BufferUsages::COPY_SRC,
            ),
            ("guide", size_of::<GuideUniforms>() as u64, storage),
            ("lessons", 4 * self.lessons.layout.words(), storage | BufferUsages::COPY_SRC),
            ("guide_state", self.lessons.state_bytes(self.met_bytes()), storage | BufferUsages::COPY_SRC),
            ("guide_trees", trees, storage),
        ];
        let mut grown = false;
        for (name, bytes, usage) in wanted {
            if self.buffers.size(name).is_none_or(|size| size < bytes) {
                // Tables grow from pass to pass: room to spare keeps the buffers for some passes.
                let room = if name == "guide" { bytes } else { bytes + bytes / 2 };
                let room = room.min(self.gpu.summary.max_binding.max(bytes));
                self.buffers.create(&self.gpu, name, room, usage)?;
                grown = true;
            }
        }
        Ok(grown)
    }

    fn write_guide<T: bytemuck::Pod>(&self, name: &str, offset: u64, value: &T) {
        self.write_guide_slice(name, offset, std::slice::from_ref(value));
    }

    fn write_guide_slice<T: bytemuck::Pod>(&self, name: &str, offset: u64, values: &[T]) {
        self.gpu.queue.write_buffer(self.buffers.get(name), offset, bytemuck::cast_slice(values));
    }

    /// Bytes of what was met, behind what is known.
    fn met_bytes(&self) -> u64 {
        let adaptive = self.guide_mode() == Some(GuideMode::Adaptive);
        if adaptive { 32 * u64::from(self.lessons.cells) } else { 0 }
    }

    /// The kind of table, of the kernels in use or the others.
    fn guide_mode(&self) -> Option<GuideMode> {
        let spares = self.spares.iter().map(|(key, _)| key.guide);
        [self.key.guide].into_iter().chain(spares).flatten().next()
    }

    /// Only kernels of passes that teach have it, but tables are put in place before others, too.
    fn commit_kernel(&self) -> &Kernel {
        let spares = self.spares.iter().map(|(_, kernels)| kernels);
        let all = [&self.kernels].into_iter().chain(spares);
        all.flat_map(|kernels| kernels.get(&Stage::Commit))
            .next()
            .expect("every guide has a kernel that commits")
    }

    /// Records the commit of the sums as they are.
    fn record_commit(&self, encoder: &mut CommandEncoder) {
        let kernel = self.commit_kernel();
        let bind = kernel.bind(&self.gpu, &self.buffers, &[]);
        let groups = self.lessons.cells.div_ceil(CELLS_AT_ONCE);
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&kernel.pipeline);
        pass.set_bind_group(0, &bind, &[]);
        pass.dispatch_workgroups(groups.min(GRID_WIDTH), groups.div_ceil(GRID_WIDTH), 1);
    }

    /// Has the GPU commit what was learnt since the guide was put in place, and send what is known then on its way to the host.
    pub fn begin_commit(&mut self) {
        if !self.is_bound("guide_rows") || self.lessons.pending.is_some() {
            return;
        }
        let (known, layout) = (self.lessons.state_bytes(self.met_bytes()), self.lessons.layout);
        let missing = 4 * u64::from(layout.missing);
        let staging = match self.lessons.staging.take() {
            Some(staging) if staging.size() >= known + missing => staging,
            _ => self.staging(known + missing + known / 2),
        };
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        self.record_commit(&mut encoder);
        encoder.copy_buffer_to_buffer(self.buffers.get("guide_state"), 0, &staging, 0, known);
        let missing_at = 4 * layout.words() - missing;
        encoder.copy_buffer_to_buffer(self.buffers.get("lessons"), missing_at, &staging, known, missing);
        let submission = self.gpu.queue.submit([encoder.finish()]);
        staging.map_async(wgpu::MapMode::Read, ..known + missing, |_| ());
        self.lessons.pending = Some(Commit { submission, staging, known, bytes: known + missing });
    }

    /// Commits what was learnt since the guide was put in place, unless that has begun, and fetches what is known then.
    pub fn commit(&mut self) -> Result<Committed, RenderError> {
        self.begin_commit();
        let Some(commit) = self.lessons.pending.take() else { return Ok(Committed::default()) };
        self.gpu.wait_for(commit.submission)?;
        let view = commit.staging.slice(..commit.bytes).get_mapped_range();
        let view = view.map_err(|e| GpuError::DeviceLost {
            adapter: self.gpu.summary.name.clone(),
            reason: e.to_string(),
        })?;
        let committed = self.lessons.committed(&view, commit.known);
        drop(view);
        commit.staging.unmap();
        self.lessons.staging = Some(commit.staging);
        Ok(committed)
    }
}

/// A commit on its way, and the bytes that it brings back: those of what is known, and all.
#[derive(Debug)]
struct Commit {
    submission: wgpu::SubmissionIndex,
    staging: wgpu::Buffer,
    known: u64,
    bytes: u64,
}

impl GpuLessons {
    /// Bytes of what is known, with `met` bytes of what was met.
    fn state_bytes(&self, met: u64) -> u64 {
        16 * u64::from(CELL_STATE_ROWS * self.cells + self.nodes) + met
    }

    /// From the bytes of the state, of which there are `known`, and of the marks of missing cells.
    fn committed(&self, bytes: &[u8], known: u64) -> Committed {
        let (known, missing) = bytes.split_at(known as usize);
        let (cells, known) = known.split_at(size_of::<CellState>() * self.cells as usize);
        let (nodes, met) = known.split_at(size_of::<NodeState>() * self.nodes as usize);
        Committed {
            cells: bytemuck::pod_collect_to_vec(cells),
            nodes: collected(nodes),
            met: bytemuck::pod_collect_to_vec(met),
            missing: bytemuck::pod_collect_to_vec(missing),
        }
    }
}

/// Bytes per thread.
const COPIED_AT_ONCE: usize = 1 << 18;

/// Rows out of bytes, of which there may be tens of megabytes.
fn collected(bytes: &[u8]) -> Vec<NodeState> {
    let mut rows = vec![[0.0; 4]; bytes.len() / size_of::<NodeState>()];
    let copied: &mut [u8] = bytemuck::cast_slice_mut(&mut rows);
    let parts = copied.par_chunks_mut(COPIED_AT_ONCE).zip(bytes.par_chunks(COPIED_AT_ONCE));
    parts.for_each(|(to, from)| to.copy_from_slice(from));
    rows
}
