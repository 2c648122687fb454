//! The CPU engine: the transport functions over rayon. Also what renders where there is no GPU.

use super::cpu_levels::trace_all;
use super::strategy::{Pass, Strategy};
use super::{CancelToken, Engine, EngineKind, Estimators, RenderError, RenderStats};
use crate::accel::Search;
use crate::film::{Film, PixelSum};
use crate::guiding::commit::commit;
use crate::guiding::{Committed, GuideState, GuideTable, GuideUpdate, LessonLayout, LessonSums};
use crate::scene::compiled::{CompiledScene, Uniforms};
use crate::transport::guide::Guidance;
use crate::transport::path::Transport;
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;
use std::time::Instant;

pub struct CpuEngine {
    scene: CompiledScene,
    uniforms: Uniforms,
    estimators: Estimators,
    strategy: Strategy,
    guide: Option<CpuGuide>,
    stats: RenderStats,
}

/// What guides paths, and what they teach.
#[derive(Default)]
struct CpuGuide {
    table: GuideTable,
    sums: LessonSums,
    /// What is known.
    state: GuideState,
}

/// How long a step should take, in seconds.
const STEP_SECONDS: f64 = 0.25;
/// How many paths a thread traces before it adds them to the film.
const PATHS_AT_ONCE: u32 = 4096;

impl CpuEngine {
    pub fn new(scene: CompiledScene, uniforms: Uniforms, estimators: Estimators) -> Self {
        let stats = RenderStats {
            engine: EngineKind::Cpu.to_string(),
            device: format!("{} threads", rayon::current_num_threads()),
            ..Default::default()
        };
        let strategy = Strategy {
            informed: estimators.learns(),
            roulette: estimators.roulette,
            roulette_scale: estimators.roulette_scale,
            ripe: false,
        };
        CpuEngine { scene, uniforms, estimators, strategy, guide: None, stats }
    }

    /// The table's rows and what is known.
    #[cfg(test)]
    pub(super) fn guide(&self) -> Option<(&[crate::guiding::state::Row], &GuideState)> {
        self.guide.as_ref().map(|guide| (guide.table.rows.as_slice(), &guide.state))
    }

    /// One pass: the samples `range` of every pixel, rows in parallel.
    fn pass(&self, range: &Range<u32>, film: &mut Film, cancel: &CancelToken) -> Spent {
        let width = self.uniforms.width as usize;
        let uniforms = Uniforms {
            pixel_count: self.uniforms.width * self.uniforms.height,
            first_sample: range.start,
            sample_count: range.end - range.start,
            ..self.uniforms
        };
        let search = Search::new(&self.scene);
        let transport = Transport {
            scene: &self.scene,
            search: &search,
            uniforms: &uniforms,
            sampler: self.estimators.sampler,
            direct_light: self.estimators.direct_light && self.scene.has_light_to_sample(),
            roulette: self.strategy.roulette,
            places: if self.strategy.informed { self.estimators.places() } else { 1 },
            guidance: self.guide.as_ref().filter(|_| self.strategy.informed).map(|guide| Guidance {
                mode: self.estimators.table_mode(),
                table: &guide.table,
                sums: &guide.sums,
            }),
        };
        let rows = film.pixels_mut().par_chunks_mut(width).enumerate();
        let spent = rows.map(|(row, pixels)| {
            let samples = uniforms.sample_count;
            let group = (PATHS_AT_ONCE / samples.max(1)).max(1) as usize;
            let mut spent = Spent::default();
            if cancel.is_cancelled() {
                return spent;
            }
            for (number, pixels) in pixels.chunks_mut(group).enumerate() {
                let first = (row * width + number * group) as u32;
                for begin in (0..samples).step_by(PATHS_AT_ONCE as usize) {
                    let end = samples.min(begin.saturating_add(PATHS_AT_ONCE));
                    spent = spent.and(trace_group(&transport, pixels, first, begin..end));
                }
            }
            spent
        });
        spent.reduce(Spent::default, Spent::and)
    }
}

/// What tracing took, and what it lost.
#[derive(Clone, Copy, Default)]
struct Spent {
    rays: u64,
    /// Samples that the film could not count.
    lost: u64,
}

impl Spent {
    fn and(self, other: Spent) -> Spent {
        Spent { rays: self.rays + other.rays, lost: self.lost + other.lost }
    }
}

/// Some samples of neighbouring pixels, the first of which is number `first`, added to their sums in the order of the
/// samples.
fn trace_group(transport: &Transport, pixels: &mut [PixelSum], first: u32, samples: Range<u32>) -> Spent {
    let of_pixel =
        |pixel| samples.clone().map(move |sample| sample * transport.uniforms.pixel_count + first + pixel);
    let paths: Vec<u32> = (0..pixels.len() as u32).flat_map(of_pixel).collect();
    let mut radiance = vec![Vec3::ZERO; paths.len()];
    let rays = trace_all(transport, &paths, &mut radiance);
    let mut lost = 0;
    for (pixel, samples) in pixels.iter_mut().zip(radiance.chunks(samples.len())) {
        samples.iter().for_each(|&sample| lost += u64::from(!pixel.add_traced(sample)));
    }
    Spent { rays, lost }
}

impl Engine for CpuEngine {
    fn kind(&self) -> EngineKind {
        EngineKind::Cpu
    }

    fn device(&self) -> String {
        self.stats.device.clone()
    }

    fn render(
        &mut self,
        range: Range<u32>,
        film: &mut Film,
        cancel: &CancelToken,
    ) -> Result<(), RenderError> {
        let start = Instant::now();
        let pixels = self.uniforms.width * self.uniforms.height;
        // Paths of a pass, and their places, are numbered in 32 bits.
        let longest = (u32::MAX / pixels / self.estimators.places()).max(1);
        let mut sample = range.start;
        while sample < range.end && !cancel.is_cancelled() {
            let end = range.end.min(sample.saturating_add(longest));
            let spent = self.pass(&(sample..end), film, cancel);
            self.stats.rays += spent.rays;
            self.stats.lost_samples += spent.lost;
            self.stats.paths += u64::from(pixels) * u64::from(end - sample);
            sample = end;
        }
        self.stats.seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    fn set_pass(&mut self, pass: &Pass) -> Result<(), RenderError> {
        self.strategy = pass.strategy;
        self.uniforms.roulette_scale = pass.strategy.roulette_scale;
        Ok(())
    }

    fn set_guide(&mut self, update: GuideUpdate) -> Result<(), RenderError> {
        let guide = self.guide.get_or_insert_default();
        if let Some(state) = update.state {
            guide.state.clone_from(state);
        }
        // Sums of the pass before may have been left.
        guide.sums = LessonSums::new(LessonLayout::new(&update.uniforms));
        guide.table.update(update);
        Ok(())
    }

    fn commit(&mut self) -> Result<Committed, RenderError> {
        let Some(guide) = &mut self.guide else { return Ok(Committed::default()) };
        let lessons = guide.sums.take();
        let (mode, table) = (self.estimators.table_mode(), &mut guide.table);
        let met = commit(mode, &table.uniforms, &lessons, &mut guide.state, &mut table.rows);
        let (cells, nodes) = (guide.state.cells.clone(), guide.state.nodes.clone());
        Ok(Committed { cells, nodes, met, missing: lessons.missing })
    }

    fn step_samples(&self) -> u32 {
        if self.stats.paths == 0 {
            return 1;
        }
        let pixels = f64::from(self.uniforms.width) * f64::from(self.uniforms.height);
        let per_sample = self.stats.seconds / (self.stats.paths as f64 / pixels);
        (STEP_SECONDS / per_sample.max(1e-9)).clamp(1.0, 4096.0) as u32
    }

    fn stats(&self) -> RenderStats {
        self.stats.clone()
    }
}
