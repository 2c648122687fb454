//! Which way of tracing pays: a guide costs time per ray, and roulette trades rays for noise. The first samples, which do
//! without, and the passes that learn tell, by noise × cost, and all of them are part of the image.
//!
//! Cost is counted in rays, not in seconds, so that the same seed decides alike. (But for a budget of time, by which it depends
//! on the clock whether a guide is tried at all.)

use super::{EngineKind, Estimators, RenderOptions};
use crate::guiding::GuideMode;
use crate::random::Sampler;
use crate::transport::roulette::Roulette;

/// A way of tracing paths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strategy {
    /// Whether the table takes part: guides directions, decides roulette, learns.
    pub informed: bool,
    pub roulette: Roulette,
    /// Survival in roulette is this times what it would be.
    pub roulette_scale: f32,
    /// Whether learnt roulette goes by what was learnt; else paths end by throughput there, too.
    pub ripe: bool,
}

/// A pass to be traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pass {
    pub strategy: Strategy,
    /// Samples of each pixel after which it ends, counted from the start; `u32::MAX` for the last.
    pub end: u32,
    /// Whether it teaches.
    pub learning: bool,
}

impl Pass {
    /// Whether it is the last and does without the table, which did not pay.
    pub fn gives_up(&self) -> bool {
        self.end == u32::MAX && !self.strategy.informed
    }

    /// Whether its paths teach the table.
    pub fn teaches(&self) -> bool {
        self.learning && self.strategy.informed
    }
}

/// Samples per pixel of the first pass that learns. One of 2 before it made tables no better (docs/GUIDING.md).
const FIRST_PASS: u32 = 4;
/// The same where rays walk for long: a pass takes as long as its longest path, 45 ms in still-life, so that passes of few samples
/// cost what many would; and interior's tables came out as good.
const FIRST_PASS_OF_LONG_WALKS: u32 = 16;
/// Shape tests that a ray's way stands for, from which on it is long: 256 shapes in a hierarchy.
const LONG_WALK: usize = 128;
/// Samples per pixel without the table, before it is tried: what it must be better than.
const PRELUDE: u32 = 16;
/// Samples per pixel of the first pass that goes by what was learnt in roulette, before that is compared with paths that end by
/// throughput: few, since where it is worse it is so by much.
const TASTE: u32 = 16;
/// After so many samples per pixel the last pass is compared with the prelude. (Before that it can't be told: at 32, door-ajar's guide
/// was 1.1 times better and bansal-room-5's 1.2 times worse.)
const CHECKS: [u32; 2] = [128, 256];
/// Relative variance of a plain sample below which a guide is not worth its while where samples are stratified: they then
/// converge faster than their variance tells, and a guide's choices break the strata up. Measured: cornell-box, whose
/// variance is 0.65, is 1.7 times as efficient without; many-lights, with 1.04 to 1.2, is 2.1 times as efficient with a guide.
const SMOOTH: f64 = 0.8;
/// Mean rays of a plain path below which it is not worth its while there, either: little light comes by way of other surfaces, and
/// what noise there is strata take away.
const SHORT: f64 = 2.5;
/// Samples per pixel in all, times a plain sample's relative variance, below which a guide that has everything to learn is not
/// tried: what that costs is not won back. Measured on a CPU, which learns from few pixels: bansal-room-5 had 0.73 of plain
/// tracing's efficiency at 1,100 and 0.93 at 3,400, door-ajar 3.5 times at 12,500.
const ENOUGH: f64 = 3000.0;
/// How many times more a guided sample's variance counts where samples are stratified, for the same reason: what it loses by
/// breaking strata up. Measured: on bansal-room-5 (H100, 4 s) variance and cost promise 1.5 times the efficiency of plain
/// tracing, and it is 1.37 times; on glossy-box 1.2 times, and it is 1.27.
const STRATA_LOSS: f64 = 1.1;
/// Scale of plain tracing's roulette, if none is asked for: the best of 1, 4, 16 and off on most scenes (docs/GUIDING.md).
const PLAIN_SCALE: f32 = 4.0;

/// What a ray costs, in units of one that meets no shape.
#[derive(Clone, Copy, Debug)]
struct CostModel {
    /// A plain ray.
    plain: f64,
    /// A ray whose path asks the table.
    informed: f64,
    /// A sample besides its rays.
    sample: f64,
}

impl CostModel {
    /// From measured times per ray: on an H100 0.034 ns and 0.84 ps per shape test, 0.025 ns for the table when nothing more is
    /// learnt (0.022 to 0.03 on six scenes); on two cores of a CPU, where most of a usual
    /// render teaches, 147 ns, 0.9 ns and 190 ns (docs/GUIDING.md, Cost).
    fn new(engine: EngineKind, tests: usize) -> CostModel {
        let (test, table) = match engine {
            EngineKind::Cpu => (0.006, 1.3),
            _ => (0.025, 0.75),
        };
        let plain = 1.0 + test * tests as f64;
        CostModel { plain, informed: plain + table, sample: 0.3 }
    }

    fn of(&self, strategy: &Strategy, rays: f64) -> f64 {
        self.sample + rays * if strategy.informed { self.informed } else { self.plain }
    }
}

/// The strategy that does without the table, None if it is not to be tried.
pub fn plain_strategy(options: &RenderOptions, estimators: Estimators) -> Option<Strategy> {
    let tried = options.guide.trial && estimators.guide != GuideMode::Off;
    let roulette = match estimators.roulette {
        Roulette::Off => Roulette::Off,
        _ => Roulette::Throughput,
    };
    let roulette_scale = options.roulette_scale.unwrap_or(PLAIN_SCALE);
    tried.then_some(Strategy { informed: false, roulette, roulette_scale, ripe: false })
}

/// Decides the passes of a render.
#[derive(Clone, Debug)]
pub struct Planner {
    informed: Judged,
    /// None if it is out of question.
    plain: Option<Judged>,
    /// The informed one as it was in the last pass that ended paths by throughput, as long as roulette by what was learnt is
    /// to be compared with it. Scenes of mirrors and glass need that: a cell's mean does not know which way they send a path
    /// (bansal-exp-2: 4.4 times the variance of a sample, 0.7 of its cost).
    unripe: Option<Judged>,
    /// Of roulette by what was learnt.
    roulette_scale: f32,
    /// Samples per pixel from which on roulette goes by what was learnt; `u32::MAX` where it never does.
    ripens: u32,
    /// The next of [`CHECKS`].
    check: usize,
    learning_samples: u32,
    first_pass: u32,
    stratified: bool,
    /// [`ENOUGH`], or nothing where a guide was loaded.
    enough: f64,
    costs: CostModel,
}

/// A strategy, the relative variance of its samples and that times their cost, when it was last judged.
#[derive(Clone, Copy, Debug)]
struct Judged {
    strategy: Strategy,
    variance: f64,
    rays: f64,
    noise_cost: f64,
}

impl Judged {
    fn new(strategy: Strategy) -> Judged {
        Judged { strategy, variance: f64::INFINITY, rays: f64::INFINITY, noise_cost: f64::INFINITY }
    }
}

impl Planner {
    pub fn new(
        options: &RenderOptions,
        estimators: Estimators,
        engine: EngineKind,
        tests_per_ray: usize,
    ) -> Planner {
        let Estimators { roulette, roulette_scale, .. } = estimators;
        let tests = tests_per_ray * if estimators.direct_light { 2 } else { 1 };
        let plain = plain_strategy(options, estimators);
        let mature = options.guide.mature_samples;
        let ripens = match (roulette, &options.guide_table, plain) {
            (Roulette::Learnt, Some(_), None) => 0, // What was loaded has been learnt already.
            (Roulette::Learnt, Some(_), Some(_)) => mature,
            // What fewer samples taught never gets better than it was when the last pass began.
            (Roulette::Learnt, None, _) if options.guide.lessons().next_power_of_two() >= mature => mature,
            _ => u32::MAX,
        };
        Planner {
            informed: Judged::new(Strategy { informed: true, roulette, roulette_scale, ripe: false }),
            plain: plain.map(Judged::new),
            unripe: None,
            roulette_scale,
            ripens,
            check: 0,
            learning_samples: options.guide.lessons(),
            first_pass: if tests_per_ray >= LONG_WALK { FIRST_PASS_OF_LONG_WALKS } else { FIRST_PASS },
            stratified: estimators.sampler == Sampler::Stratified,
            enough: if options.guide_table.is_some() { 0.0 } else { ENOUGH },
            costs: CostModel::new(engine, tests),
        }
    }

    /// The first pass: the prelude, if there is a choice. Even without a lesson the informed one has something to find out:
    /// the estimates of the pixels.
    pub fn first(&self) -> Pass {
        match self.plain {
            Some(plain) => Pass { strategy: plain.strategy, end: PRELUDE, learning: false },
            None => self.learn_on(0),
        }
    }

    /// Takes in what a pass was worth: the variance of a sample, the rays of a path.
    pub fn judge(&mut self, pass: &Pass, variance: f64, rays: f64) {
        let judged = match &mut self.plain {
            Some(plain) if !pass.strategy.informed => plain,
            _ => &mut self.informed,
        };
        (judged.variance, judged.rays) = (variance, rays);
        let loss = if self.stratified && pass.strategy.informed { STRATA_LOSS } else { 1.0 };
        judged.strategy = pass.strategy;
        judged.noise_cost = loss * variance * self.costs.of(&pass.strategy, rays);
        if pass.strategy.informed && !pass.strategy.ripe && self.plain.is_some() {
            self.unripe = Some(self.informed);
        }
    }

    /// The pass after `samples` samples per pixel, of so many as are expected in all.
    pub fn next(&mut self, samples: u32, expected: Option<u32>) -> Pass {
        self.choose_roulette();
        let plain = self.plain;
        let plain = plain.filter(|plain| self.guide_is_given_up(plain, samples, expected));
        match plain {
            Some(plain) => Pass { strategy: plain.strategy, end: u32::MAX, learning: false },
            None => self.learn_on(samples),
        }
    }

    /// Whether what is known after so many samples speaks against the guide.
    fn guide_is_given_up(&mut self, plain: &Judged, samples: u32, expected: Option<u32>) -> bool {
        if samples <= PRELUDE {
            let too_few = expected.is_some_and(|expected| f64::from(expected) * plain.variance < self.enough);
            return too_few || self.stratified && (plain.variance < SMOOTH || plain.rays < SHORT);
        }
        match CHECKS.get(self.check) {
            Some(&at) if samples >= at => {
                self.check += 1;
                self.informed.noise_cost > plain.noise_cost
            }
            _ => false,
        }
    }

    /// Leaves roulette by what was learnt, if paths that ended by throughput did better with fewer lessons. Asked once.
    fn choose_roulette(&mut self) {
        if !self.informed.strategy.ripe {
            return;
        }
        let better = |unripe: &Judged| unripe.noise_cost < self.informed.noise_cost;
        if let Some(unripe) = self.unripe.take().filter(better) {
            self.informed = unripe;
            self.ripens = u32::MAX;
        }
    }

    /// The informed strategy after `samples` samples per pixel.
    fn informed_at(&self, samples: u32) -> Strategy {
        let Strategy { roulette, .. } = self.informed.strategy;
        let ripe = samples >= self.ripens;
        // Where there is a choice, paths end by throughput as they do in plain tracing.
        let plain = self.plain.filter(|_| roulette == Roulette::Learnt && !ripe);
        let roulette_scale = plain.map_or(self.roulette_scale, |plain| plain.strategy.roulette_scale);
        Strategy { informed: true, roulette, roulette_scale, ripe }
    }

    /// Passes that learn, then one without end.
    fn learn_on(&self, samples: u32) -> Pass {
        let prelude = if self.plain.is_some() { PRELUDE } else { 0 };
        // Each pass doubles the samples that taught, and once those are as many as the prelude's, all.
        let counted = if samples < 2 * prelude { samples - prelude } else { samples };
        let learning = counted < self.learning_samples;
        let end = if learning { samples.saturating_add(counted.max(self.first_pass)) } else { u32::MAX };
        // What is to be compared ends there, even if nothing is to be learnt until then.
        let check = self.plain.and(CHECKS.get(self.check)).map_or(u32::MAX, |&at| at);
        let strategy = self.informed_at(samples);
        let roulette = match strategy.ripe {
            true => self.unripe.map_or(u32::MAX, |_| samples.saturating_add(TASTE)),
            // With a loaded guide there may be nothing left to learn.
            false if !learning => self.ripens,
            false => u32::MAX,
        };
        Pass { strategy, end: end.min(check).min(roulette), learning }
    }
}

#[cfg(test)]
#[path = "strategy_tests.rs"]
mod tests;
