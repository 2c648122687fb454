//! A guided render: passes, a lesson after each. Every pass is unbiased, so all of them are kept, weighted by how noisy
//! they are.

use super::pilot::pilot;
use super::strategy::{Pass, Planner};
use super::{Budget, Engine, Estimators, RenderError, RenderOptions};
use crate::film::{CombinedFilm, Film, Image, rough_luminances};
use crate::guiding::{GuideMode, GuideOptions, Learner, Stale};
use crate::random::Sampler;
use crate::scene::compiled::{CompiledScene, Uniforms};
use crate::transport::roulette::Roulette;
use std::time::Instant;

/// Samples that an estimate of a pixel's luminance should rest on, its neighbours' included.
const ESTIMATE_SAMPLES: f64 = 512.0;

/// What `earlier` samples, from before the guide was given up, count of what their noise says when `later` ones have followed, where
/// samples are stratified. Later ones converge faster than independent ones, so the few from before would be more of the error
/// than it says: as if by an eighth of a power (strata took 0.4 to 0.83 of the noise of scenes that come here, in 4 s of an H100). By
/// numbers alone, so that it does not depend on any noise.
fn faded(earlier: u32, later: u32) -> f64 {
    (f64::from(earlier) / f64::from(later.max(1))).sqrt().sqrt().sqrt().min(1.0)
}

/// What a guided render keeps besides the film.
pub struct Guided {
    learner: Learner,
    /// What of the engine's table is not what the learner has.
    stale: Stale,
    planner: Planner,
    pass: Pass,
    combined: CombinedFilm,
    first_sample: u32,
    stratified: bool,
    /// What the engine had spent when the pass began: samples of each pixel, rays.
    spent: (u32, u64),
    pixels: f64,
    /// Whether any pass asked the table.
    informed: bool,
    budget: Budget,
    /// From when on speed is measured, and the samples by then: after the first step, which is slow, since everything is new.
    measured_from: (Instant, u32),
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
        let guide = GuideOptions { memory: guide.memory.min(engine.largest_guide()), ..guide };
        let mut learner = pilot(guide, options.guide_table.as_deref(), scene, uniforms)?;
        learner.set_scene(scene.light_fingerprint());
        let planner = Planner::new(options, estimators, engine.kind(), scene.tests_per_ray());
        let pass = planner.first();
        let pixels = uniforms.width * uniforms.height;
        engine.set_pass(&pass)?;
        engine.set_guide(learner.update(pass.learning, Stale::State, &vec![0.0; pixels as usize]))?;
        Ok(Some(Guided {
            learner,
            stale: Stale::Pixels,
            planner,
            pass,
            combined: CombinedFilm::new(&Film::new(uniforms.width, uniforms.height)),
            first_sample: options.first_sample,
            stratified: estimators.sampler == Sampler::Stratified,
            spent: (0, 0),
            pixels: f64::from(pixels),
            informed: pass.strategy.informed,
            budget: options.budget,
            measured_from: (Instant::now(), 0),
        }))
    }

    /// The sample at which the pass ends.
    pub fn end(&self) -> u32 {
        self.first_sample.saturating_add(self.pass.end)
    }

    /// Samples of each pixel that there will be when the budget is spent, if it tells, by speed and noise so far.
    fn expected(&self, samples: u32, film: &Film) -> Option<u32> {
        let (since, before) = self.measured_from;
        let rate = f64::from(samples - before) / since.elapsed().as_secs_f64();
        let error = self.budget.error.map_or(0.0, |_| film.relative_error());
        self.budget.expected(samples, rate, error)
    }

    /// Ends the pass if all its samples, of which there are `samples` by now, are in the film.
    pub fn conclude_pass(
        &mut self,
        samples: u32,
        film: &Film,
        engine: &mut dyn Engine,
    ) -> Result<(), RenderError> {
        if samples < self.pass.end {
            if self.measured_from.1 == 0 {
                self.measured_from = (Instant::now(), samples);
            }
            return Ok(());
        }
        let expected = self.expected(samples, film);
        if self.pass.teaches() {
            engine.begin_commit();
        }
        let estimates = rough_luminances(film, ESTIMATE_SAMPLES);
        self.combined.judge(film, &estimates);
        let rays = engine.stats().rays;
        let taken = samples - self.spent.0;
        let rays_per_path = (rays - self.spent.1) as f64 / (f64::from(taken) * self.pixels);
        if self.pass.teaches() {
            self.stale = self.stale.max(self.learner.take_in(engine.commit()?, taken));
        }
        self.planner.judge(&self.pass, self.combined.variance(), rays_per_path);
        let next = self.planner.next(samples, expected);
        // What goes on as it was is one pass: all its samples are alike. So is plain tracing after the prelude.
        if next.strategy != self.pass.strategy || self.pass.teaches() {
            self.combined.add_pass(film);
        }
        self.pass = next;
        self.informed |= next.strategy.informed;
        self.spent = (samples, rays);
        engine.set_pass(&self.pass)?;
        if self.pass.strategy.informed {
            // An estimate of 0 is none: paths end by throughput.
            let known = if self.pass.strategy.ripe { estimates } else { vec![0.0; estimates.len()] };
            let stale = std::mem::take(&mut self.stale);
            engine.set_guide(self.learner.update(self.pass.learning, stale, &known))?;
        }
        Ok(())
    }

    /// `image` made of all passes by their weights.
    pub fn combine(&self, film: &Film, image: Image) -> Image {
        self.combined.put_into(image, film, &rough_luminances(film, ESTIMATE_SAMPLES), self.share(film))
    }

    /// The relative error of that image.
    pub fn relative_error(&self, film: &Film) -> f64 {
        self.combined.relative_error(film, &rough_luminances(film, ESTIMATE_SAMPLES), self.share(film))
    }

    /// What passes that have ended count of what their noise says.
    fn share(&self, film: &Film) -> f64 {
        if !(self.stratified && self.pass.gives_up()) {
            return 1.0;
        }
        let earlier = self.spent.0;
        let later = film.pixels().first().map_or(0, |pixel| pixel.count).saturating_sub(u64::from(earlier));
        faded(earlier, later.try_into().unwrap_or(u32::MAX))
    }

    /// How paths ended, if no pass so far asked the table: with a trial that may be all there is.
    pub fn plain_so_far(&self) -> Option<Roulette> {
        (!self.informed).then_some(self.pass.strategy.roulette)
    }

    /// What was learnt so far.
    pub fn learner(&self) -> &Learner {
        &self.learner
    }
}

#[cfg(test)]
#[path = "guided_tests.rs"]
mod tests;
