//! A guided render: passes of doubling size, a lesson after each. Every pass is unbiased, so all of them are kept, weighted
//! by how noisy they are.

use super::{Engine, Estimators, RenderError, RenderOptions};
use crate::accel::ShapeLanes;
use crate::film::{CombinedFilm, Film, Image, rough_luminances};
use crate::guiding::{GuideMode, GuideOptions, GuideTable, Learner, LessonLayout, LessonSums};
use crate::math::luminance as luminance_of;
use crate::scene::compiled::{CompiledScene, Uniforms};
use crate::transport::guide::Guidance;
use crate::transport::path::Transport;
use glam::Vec3;
use rayon::prelude::*;

/// Samples per pixel of the first pass.
const FIRST_PASS: u32 = 2;
/// Paths that find out where surfaces are.
const PILOT_PATHS: u32 = 4096;
/// Samples that an estimate of a pixel's luminance should rest on, its neighbours' included.
const ESTIMATE_SAMPLES: f64 = 512.0;

/// What a guided render keeps besides the film.
pub struct Guided {
    learner: Learner,
    /// Samples of each pixel after which the pass ends; `u32::MAX` for the last.
    pass_end: u32,
    learning_samples: u32,
    pass_begin: u32,
    combined: CombinedFilm,
    first_sample: u32,
}

impl Guided {
    /// Finds out where surfaces are, and gives the engine an empty table. None if nothing is to be learnt.
    pub fn start(
        options: &RenderOptions,
        estimators: Estimators,
        scene: &CompiledScene,
        uniforms: &Uniforms,
        engine: &mut dyn Engine,
    ) -> Result<Option<Guided>, RenderError> {
        if !estimators.learns() {
            return Ok(None);
        }
        let guide = match estimators.guide {
            GuideMode::Off => {
                GuideOptions { mode: GuideMode::Adaptive, mixture: 0.0, depth: 0, ..options.guide }
            }
            _ => options.guide,
        };
        let mut learner = pilot(guide, scene, uniforms)?;
        let estimates = vec![0.0; (uniforms.width * uniforms.height) as usize];
        engine.set_guide(learner.table(true, &estimates))?;
        Ok(Some(Guided {
            learner,
            pass_end: FIRST_PASS,
            learning_samples: guide.learning_samples,
            pass_begin: 0,
            combined: CombinedFilm::new(&Film::new(uniforms.width, uniforms.height)),
            first_sample: options.first_sample,
        }))
    }

    /// The sample at which the pass ends.
    pub fn end(&self) -> u32 {
        self.first_sample.saturating_add(self.pass_end)
    }

    /// Ends the pass if all its samples, of which there are `samples` by now, are in the film.
    pub fn conclude_pass(
        &mut self,
        samples: u32,
        film: &Film,
        engine: &mut dyn Engine,
    ) -> Result<(), RenderError> {
        if samples < self.pass_end {
            return Ok(());
        }
        let t0 = std::time::Instant::now();
        let estimates = rough_luminances(film, ESTIMATE_SAMPLES);
        let t1 = std::time::Instant::now();
        self.combined.end_pass(film, &estimates);
        let t2 = std::time::Instant::now();
        let lessons = engine.take_lessons()?;
        let t3 = std::time::Instant::now();
        self.learner.learn(&lessons, samples - self.pass_begin);
        let t4 = std::time::Instant::now();
        let learning = self.pass_end < self.learning_samples;
        self.pass_begin = samples;
        self.pass_end = if learning { self.pass_end.saturating_mul(2) } else { u32::MAX };
        let table = self.learner.table(learning, &estimates);
        let t5 = std::time::Instant::now();
        let n = table.rows.len();
        engine.set_guide(table)?;
        let t6 = std::time::Instant::now();
        if std::env::var("QT_TRACE").is_ok() {
            let ms = |a: std::time::Instant, b: std::time::Instant| (b - a).as_secs_f64() * 1e3;
            eprintln!(
                "pass to {} est {:.1} comb {:.1} take {:.1} learn {:.1} table {:.1} set {:.1} ms; cells {} nodes {} rows {n} gpu {:.3}",
                samples,
                ms(t0, t1),
                ms(t1, t2),
                ms(t2, t3),
                ms(t3, t4),
                ms(t4, t5),
                ms(t5, t6),
                self.learner.cells(),
                self.learner.nodes(),
                engine.stats().gpu_seconds
            );
        }
        Ok(())
    }

    /// `image` made of all passes by their weights.
    pub fn combine(&self, film: &Film, image: Image) -> Image {
        self.combined.put_into(image, film, &rough_luminances(film, ESTIMATE_SAMPLES))
    }

    pub fn learner(&self) -> &Learner {
        &self.learner
    }
}

/// Traces a few paths on the CPU, the same whatever the engine: the learner's grid covers the surface points that they
/// meet, and has a cell wherever they did. A scene's bounds would not do: walls may be spheres of radius 2000.
fn pilot(options: GuideOptions, scene: &CompiledScene, uniforms: &Uniforms) -> Result<Learner, RenderError> {
    let pixels = uniforms.width * uniforms.height;
    let uniforms = Uniforms { pixel_count: pixels, seed: uniforms.seed ^ 0x9e37_79b9, ..*uniforms };
    let lanes = ShapeLanes::new(scene);
    let transport = Transport { guidance: None, ..Transport::plain(scene, &lanes, &uniforms) };
    let paths = |transport: &Transport| -> Vec<Vec3> {
        (0..PILOT_PATHS).into_par_iter().flat_map_iter(|i| surface_points(transport, pixels, i)).collect()
    };
    let points = paths(&transport);
    let [low, high] = extent(&points);
    let brightest = scene.materials.iter().map(|m| luminance_of(m.emission)).fold(0.0, f32::max);
    let brightest = brightest.max(luminance_of(scene.environment));
    let mut learner = Learner::new(options, low, high, brightest)?;
    let table: GuideTable = learner.table(true, &[]);
    let mut sums = LessonSums::new(LessonLayout::new(&table.uniforms));
    let guidance = Guidance { mode: options.mode, table: &table, sums: &sums };
    paths(&Transport { guidance: Some(guidance), ..transport });
    learner.make_cells(&sums.take().missing);
    Ok(learner)
}

/// Points at which the `i`-th pilot path leaves surfaces.
fn surface_points(transport: &Transport, pixels: u32, i: u32) -> Vec<Vec3> {
    let pixel = (u64::from(i) * u64::from(pixels) / u64::from(PILOT_PATHS)) as u32;
    let mut points = Vec::new();
    let mut ray = transport.generate(pixel);
    let mut trail = Default::default();
    while let outcome = transport.step(&ray, &trail)
        && let Some(next) = outcome.ray
    {
        points.push(next.origin);
        (ray, trail) = (next, outcome.trail);
    }
    points
}

/// Corners of the box that holds the points, those few apart that lie far out: an open scene's ground ends somewhere.
fn extent(points: &[Vec3]) -> [Vec3; 2] {
    let mut low = Vec3::ZERO;
    let mut high = Vec3::ONE;
    for axis in 0..3 {
        let mut values: Vec<f32> = points.iter().map(|p| p[axis]).filter(|v| v.is_finite()).collect();
        if values.is_empty() {
            continue;
        }
        values.sort_by(f32::total_cmp);
        let at = |share: f64| values[((values.len() - 1) as f64 * share) as usize];
        let (inner_low, inner_high) = (at(0.01), at(0.99));
        let reach = inner_high - inner_low;
        low[axis] = at(0.0).max(inner_low - reach);
        high[axis] = at(1.0).min(inner_high + reach);
    }
    [low, high]
}
