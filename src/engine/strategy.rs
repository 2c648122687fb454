//! Which way of tracing pays: a guide costs time per ray, and roulette trades rays for noise. Trials of a few samples tell,
//! by noise × cost, and every one of them is part of the image.
//!
//! Cost is counted in rays, not in seconds, so that the same seed always decides alike.

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
}

/// A pass to be traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pass {
    pub strategy: Strategy,
    /// Samples of each pixel after which it ends, counted from the start; `u32::MAX` for the last.
    pub end: u32,
    /// Whether it teaches.
    pub learning: bool,
    /// Whether it only tries a strategy.
    pub trial: bool,
}

impl Pass {
    /// Whether it is the last and does without the table: trials spoke against it.
    pub fn gives_up(&self) -> bool {
        self.end == u32::MAX && !self.strategy.informed
    }

    /// Whether its paths teach the table.
    pub fn teaches(&self) -> bool {
        self.learning && self.strategy.informed
    }
}

/// Samples per pixel of the first pass.
const FIRST_PASS: u32 = 2;
/// Trials after so many samples per pixel, and samples of each. The first is before roulette goes by what was learnt, and
/// asks only whether the scene is smooth; a guide that is far off at the second is given up there.
const TRIALS: [(u32, u32); 3] = [(64, 8), (128, 8), (256, 16)];
/// At the second trial: how many times worse than plain tracing a guide may be to be given the third.
const HOPELESS: f64 = 1.25;
/// … and how much better it must be to be spared it.
const CLEARLY_BETTER: f64 = 0.5;
/// Relative variance of a plain sample below which a guide is not worth its while where samples are stratified: they then
/// converge faster than their variance tells, and a guide's choices break the strata up. Measured: cornell-box, whose
/// variance is 1.8, is 1.7 times as efficient without; bansal-room-5, with 5.6, 1.15 times as efficient with a guide.
const SMOOTH: f64 = 3.0;
/// Mean rays of a plain path below which it is not worth its while there, either: little light comes by way of other surfaces, and
/// what noise there is strata take away. Measured: surfaces, 2.2 rays, is 2 times as efficient without, although its guided
/// samples vary half as much.
const SHORT: f64 = 2.5;
/// How many times more a guided sample's variance counts where samples are stratified, for the same reason: what it loses by
/// breaking strata up. Measured: on bansal-room-5 (H100, 4 s) variance and cost promise 1.5 times the efficiency of plain
/// tracing, and it is 1.22 times.
const STRATA_LOSS: f64 = 1.2;
/// Plain tracing's roulette: the best of 1, 4, 16 and off on most scenes (docs/GUIDING.md).
const PLAIN: Strategy = Strategy { informed: false, roulette: Roulette::Throughput, roulette_scale: 4.0 };

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
    /// From measured times per ray: on an H100 0.034 ns and 0.84 ps per shape test, 0.032 ns for the table; on a CPU 60 ns,
    /// 3 ns and 240 ns.
    fn new(engine: EngineKind, tests: usize) -> CostModel {
        let (test, table) = match engine {
            EngineKind::Cpu => (0.05, 4.0),
            _ => (0.025, 0.95),
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
    tried.then_some(match estimators.roulette {
        Roulette::Off => Strategy { roulette: Roulette::Off, ..PLAIN },
        _ => PLAIN,
    })
}

/// Decides the passes of a render.
#[derive(Clone, Debug)]
pub struct Planner {
    informed: Judged,
    /// None once it is out of question.
    plain: Option<Judged>,
    /// The next trial, or the one going on.
    round: usize,
    trying: bool,
    learning_samples: u32,
    stratified: bool,
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
        Planner {
            informed: Judged::new(Strategy { informed: true, roulette, roulette_scale }),
            plain: plain_strategy(options, estimators).map(Judged::new),
            round: 0,
            trying: false,
            learning_samples: options.guide.learning_samples,
            stratified: estimators.sampler == Sampler::Stratified,
            costs: CostModel::new(engine, tests),
        }
    }

    /// The first pass. Even without a lesson there is something to be found out: the estimates of the pixels.
    pub fn first(&mut self) -> Pass {
        let learning = self.learning_samples > 0;
        Pass { strategy: self.informed.strategy, end: FIRST_PASS, learning, trial: false }
    }

    /// Takes in what a pass was worth: the variance of a sample, the rays of a path.
    pub fn judge(&mut self, pass: &Pass, variance: f64, rays: f64) {
        let judged = match &mut self.plain {
            Some(plain) if !pass.strategy.informed => plain,
            _ => &mut self.informed,
        };
        (judged.variance, judged.rays) = (variance, rays);
        let loss = if self.stratified && pass.strategy.informed { STRATA_LOSS } else { 1.0 };
        judged.noise_cost = loss * variance * self.costs.of(&pass.strategy, rays);
    }

    /// The pass after `samples` samples per pixel.
    pub fn next(&mut self, samples: u32) -> Pass {
        if self.trying {
            self.trying = false;
            if self.guide_is_given_up() {
                let strategy = self.plain.map_or(PLAIN, |plain| plain.strategy);
                return Pass { strategy, end: u32::MAX, learning: false, trial: false };
            }
            self.round += 1;
        }
        match (self.plain, TRIALS.get(self.round)) {
            (Some(plain), Some(&(from, count))) if samples >= from => {
                self.trying = true;
                Pass { strategy: plain.strategy, end: samples + count, learning: false, trial: true }
            }
            _ => self.learn_on(samples),
        }
    }

    /// Whether the trial that just ended speaks against the guide. One that speaks clearly for it is the last.
    fn guide_is_given_up(&mut self) -> bool {
        let Some(plain) = self.plain else { return false };
        let ratio = self.informed.noise_cost / plain.noise_cost;
        if self.stratified && (plain.variance < SMOOTH || plain.rays < SHORT) {
            return true;
        }
        if self.round == 0 {
            return false;
        }
        let last = self.round + 1 == TRIALS.len();
        if !last && ratio <= CLEARLY_BETTER {
            self.plain = None;
        }
        ratio > if last { 1.0 } else { HOPELESS }
    }

    /// Passes of doubling size while learning goes on, then one without end.
    fn learn_on(&self, samples: u32) -> Pass {
        let learning = samples < self.learning_samples;
        let doubled = samples.saturating_add(1).checked_next_power_of_two().unwrap_or(u32::MAX);
        // A pass that would be short is not worth a lesson.
        let short = f64::from(doubled) < 1.4 * f64::from(samples);
        let end = if short { doubled.saturating_mul(2) } else { doubled };
        let end = if learning { end } else { u32::MAX };
        // A trial that is to come comes, even if nothing is to be learnt until then.
        let trial = self.plain.and(TRIALS.get(self.round)).map(|&(from, _)| from);
        let end = trial.filter(|&from| from > samples).map_or(end, |from| end.min(from));
        Pass { strategy: self.informed.strategy, end, learning, trial: false }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::guiding::GuideOptions;

    fn planner(trial: bool, sampler: Sampler) -> Planner {
        let guide = GuideOptions { mode: GuideMode::Adaptive, trial, ..Default::default() };
        let estimators = Estimators {
            direct_light: true,
            roulette: Roulette::Learnt,
            roulette_scale: 2.5,
            split: 1,
            sampler,
            max_bounces: 64,
            guide: GuideMode::Adaptive,
        };
        let options = RenderOptions { guide, ..Default::default() };
        Planner::new(&options, estimators, EngineKind::Wavefront, 10)
    }

    /// The passes up to the last, where a sample's variance is as told, informed and plain, with the same rays.
    fn passes(planner: Planner, informed: f64, plain: f64) -> Vec<Pass> {
        passes_of(planner, informed, plain, 5.0)
    }
    fn passes_of(mut planner: Planner, informed: f64, plain: f64, rays: f64) -> Vec<Pass> {
        let mut passes = vec![planner.first()];
        while let Some(pass) = passes.last().copied().filter(|pass| pass.end < u32::MAX) {
            planner.judge(&pass, if pass.strategy.informed { informed } else { plain }, rays);
            passes.push(planner.next(pass.end));
        }
        passes
    }

    #[test]
    fn without_a_trial_passes_double_until_learning_ends() {
        let passes = passes(planner(false, Sampler::Independent), 100.0, 1.0);
        let ends: Vec<u32> = passes.iter().map(|pass| pass.end).collect();
        assert_eq!(ends, [2, 4, 8, 16, 32, 64, 128, 256, 512, u32::MAX]);
        assert!(passes[..9].iter().all(|pass| pass.teaches()) && !passes[9].teaches());
    }

    #[test]
    fn a_guide_that_does_not_pay_is_given_up_as_soon_as_it_is_compared() {
        let passes = passes(planner(true, Sampler::Independent), 100.0, 10.0);
        let [.., trial, last] = passes[..] else { panic!("{passes:?}") };
        assert_eq!((trial.end, trial.trial, trial.strategy), (136, true, PLAIN));
        assert_eq!((last.end, last.strategy, last.teaches()), (u32::MAX, PLAIN, false));
    }

    #[test]
    fn a_guide_that_clearly_pays_is_compared_once() {
        let passes = passes(planner(true, Sampler::Independent), 10.0, 100.0);
        assert_eq!(passes.iter().filter(|pass| pass.trial).count(), 2, "the first asks for smoothness only");
        assert!(passes.last().unwrap().strategy.informed);
    }

    #[test]
    fn a_guide_in_doubt_is_compared_twice() {
        // An informed ray costs 1.6 times a plain one here.
        for (informed, kept) in [(70.0, false), (40.0, true)] {
            let passes = passes(planner(true, Sampler::Independent), informed, 100.0);
            let trials: Vec<u32> = passes.iter().filter(|pass| pass.trial).map(|pass| pass.end).collect();
            let twice = trials.len() == 3;
            assert_eq!(passes.last().unwrap().strategy.informed, kept, "{passes:?}");
            assert!(twice || kept, "{trials:?}");
        }
    }

    /// With a loaded guide there may be nothing to learn; whether it pays is asked all the same.
    #[test]
    fn trials_come_whatever_is_learnt() {
        for learning_samples in [0, 32, 128] {
            let mut planner = planner(true, Sampler::Independent);
            planner.learning_samples = learning_samples;
            let passes = passes(planner, 55.0, 100.0);
            let trials = passes.iter().filter(|pass| pass.trial).map(|pass| pass.end);
            assert_eq!(trials.collect::<Vec<_>>(), [72, 136, 272], "{learning_samples}");
        }
    }

    /// At 1.6 times the cost, 0.55 of the variance pays, but not 1.2 times that.
    #[test]
    fn what_a_guide_loses_by_breaking_strata_up_is_counted() {
        for (sampler, kept) in [(Sampler::Stratified, false), (Sampler::Independent, true)] {
            let passes = passes(planner(true, sampler), 55.0, 100.0);
            assert_eq!(passes.last().unwrap().strategy.informed, kept, "{sampler:?}");
        }
    }

    #[test]
    fn short_paths_need_no_guide_where_samples_are_stratified() {
        for (sampler, kept) in [(Sampler::Stratified, false), (Sampler::Independent, true)] {
            let passes = passes_of(planner(true, sampler), 10.0, 100.0, 0.9 * SHORT);
            assert_eq!(passes.last().unwrap().strategy.informed, kept, "{sampler:?}");
        }
    }

    #[test]
    fn smooth_scenes_need_no_guide_where_samples_are_stratified() {
        for (sampler, kept) in [(Sampler::Stratified, false), (Sampler::Independent, true)] {
            let passes = passes(planner(true, sampler), 0.5, 0.9 * SMOOTH);
            assert_eq!(passes.last().unwrap().strategy.informed, kept, "{sampler:?}");
        }
    }
}
