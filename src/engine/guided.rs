//! A guided render: passes of doubling size, a lesson after each. Every pass is unbiased, so all of them are kept, weighted
//! by how noisy they are.

use super::{Engine, Estimators, RenderError, RenderOptions};
use crate::accel::ShapeLanes;
use crate::film::{CombinedFilm, Film, Image, luminance};
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
/// Least estimate of a pixel, relative to the image's mean.
const DARKEST: f64 = 1e-3;

/// What a guided render keeps besides the film.
pub struct Guided {
    learner: Learner,
    /// Samples of each pixel after which the pass ends; `u32::MAX` for the last.
    pass_end: u32,
    learning_samples: u32,
    /// The film as it was when the pass began.
    before: Film,
    combined: CombinedFilm,
    estimates: Vec<f32>,
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
            before: Film::new(uniforms.width, uniforms.height),
            combined: CombinedFilm::default(),
            estimates,
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
        let pass = film.since(&self.before);
        self.estimates = estimates(film);
        self.combined.add(&pass, &self.estimates);
        self.before = film.clone();
        self.learner.learn(&engine.take_lessons()?, pass.samples().0 as u32);
        let learning = self.pass_end < self.learning_samples;
        self.pass_end = if learning { self.pass_end.saturating_mul(2) } else { u32::MAX };
        engine.set_guide(self.learner.table(learning, &self.estimates))
    }

    /// `image` made of all passes by their weights.
    pub fn combine(&self, film: &Film, image: Image) -> Image {
        let mut combined = self.combined.clone();
        let pass = film.since(&self.before);
        if pass.samples().1 > 0 {
            combined.add(&pass, &estimates(film));
        }
        combined.put_into(image)
    }

    #[allow(dead_code)]
    pub fn learner(&self) -> &Learner {
        &self.learner
    }
}

/// Mean luminance around each pixel, over as many neighbours as it takes to trust it.
fn estimates(film: &Film) -> Vec<f32> {
    let (width, height) = (film.width() as usize, film.height() as usize);
    let samples = film.samples().0.max(1) as f64;
    let radius = (((ESTIMATE_SAMPLES / samples).sqrt() - 1.0) / 2.0).ceil().clamp(0.0, 16.0) as usize;
    let mut table = vec![0.0f64; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = 0.0;
        for x in 0..width {
            row += luminance(film.pixels()[y * width + x].mean());
            table[(y + 1) * (width + 1) + x + 1] = table[y * (width + 1) + x + 1] + row;
        }
    }
    let darkest = DARKEST * table[table.len() - 1] / (width * height) as f64;
    let mut estimates = vec![0.0; width * height];
    estimates.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        let (top, bottom) = (y.saturating_sub(radius), (y + radius + 1).min(height));
        for (x, estimate) in row.iter_mut().enumerate() {
            let (left, right) = (x.saturating_sub(radius), (x + radius + 1).min(width));
            let at = |y: usize, x: usize| table[y * (width + 1) + x];
            let sum = at(bottom, right) - at(top, right) - at(bottom, left) + at(top, left);
            *estimate = (sum / ((bottom - top) * (right - left)) as f64).max(darkest) as f32;
        }
    });
    estimates
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
