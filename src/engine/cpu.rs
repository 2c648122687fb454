//! The CPU engine: the transport functions over rayon. Also what renders where there is no GPU.

use super::strategy::{Pass, Strategy};
use super::{CancelToken, Engine, EngineKind, Estimators, RenderError, RenderStats};
use crate::accel::ShapeLanes;
use crate::film::Film;
use crate::guiding::{GuideTable, LessonLayout, LessonSums, Lessons};
use crate::scene::compiled::{CompiledScene, Uniforms};
use crate::transport::guide::Guidance;
use crate::transport::path::Transport;
use rayon::prelude::*;
use std::ops::Range;
use std::time::Instant;

pub struct CpuEngine {
    scene: CompiledScene,
    lanes: ShapeLanes,
    uniforms: Uniforms,
    estimators: Estimators,
    strategy: Strategy,
    guide: Option<(GuideTable, LessonSums)>,
    stats: RenderStats,
}

/// How long a step should take, in seconds.
const STEP_SECONDS: f64 = 0.25;

impl CpuEngine {
    pub fn new(scene: CompiledScene, uniforms: Uniforms, estimators: Estimators) -> Self {
        let stats = RenderStats {
            engine: EngineKind::Cpu.to_string(),
            device: format!("{} threads", rayon::current_num_threads()),
            ..Default::default()
        };
        let lanes = ShapeLanes::new(&scene);
        let strategy = Strategy {
            informed: estimators.learns(),
            roulette: estimators.roulette,
            roulette_scale: estimators.roulette_scale,
        };
        CpuEngine { scene, lanes, uniforms, estimators, strategy, guide: None, stats }
    }

    /// One pass: the samples `range` of every pixel, rows in parallel. How many rays that took.
    fn pass(&self, range: &Range<u32>, film: &mut Film, cancel: &CancelToken) -> u64 {
        let width = self.uniforms.width as usize;
        let uniforms = Uniforms {
            pixel_count: self.uniforms.width * self.uniforms.height,
            first_sample: range.start,
            sample_count: range.end - range.start,
            ..self.uniforms
        };
        let transport = Transport {
            scene: &self.scene,
            lanes: &self.lanes,
            uniforms: &uniforms,
            sampler: self.estimators.sampler,
            direct_light: self.estimators.direct_light && !self.scene.lights.is_empty(),
            roulette: self.strategy.roulette,
            places: if self.strategy.informed { self.estimators.places() } else { 1 },
            guidance: self.guide.as_ref().filter(|_| self.strategy.informed).map(|(table, sums)| Guidance {
                mode: self.estimators.table_mode(),
                table,
                sums,
            }),
        };
        let rows = film.pixels_mut().par_chunks_mut(width).enumerate();
        let rays = rows.map(|(row, pixels)| {
            let mut rays = 0;
            if cancel.is_cancelled() {
                return rays;
            }
            for (column, pixel) in pixels.iter_mut().enumerate() {
                for sample in 0..uniforms.sample_count {
                    let index = (row * width + column) as u32;
                    let (radiance, traced) = transport.trace(sample * uniforms.pixel_count + index);
                    pixel.add(radiance);
                    rays += u64::from(traced);
                }
            }
            rays
        });
        rays.sum()
    }
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
            self.stats.rays += self.pass(&(sample..end), film, cancel);
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

    fn set_guide(&mut self, table: GuideTable) -> Result<(), RenderError> {
        let sums = LessonSums::new(LessonLayout::new(&table.uniforms));
        self.guide = Some((table, sums));
        Ok(())
    }

    fn take_lessons(&mut self) -> Result<Lessons, RenderError> {
        Ok(self.guide.as_mut().map(|(_, sums)| sums.take()).unwrap_or_default())
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
