//! Which way of tracing pays: a guide costs time per ray, and roulette trades rays for noise. Trials of a few samples tell,
//! by noise × cost, and every one of them is part of the image.
//!
//! Cost is counted in rays, not in seconds, so that the same seed always decides alike.

use super::{EngineKind, Estimators, RenderOptions};
use crate::guiding::GuideMode;
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

/// Samples per pixel of the first pass.
const FIRST_PASS: u32 = 2;
/// Trials after so many samples per pixel, and samples of each. A guide that is far off at the first is given up there.
const TRIALS: [(u32, u32); 2] = [(64, 8), (256, 16)];
/// At the first trial: how many times worse than plain tracing a guide may be to be given the second.
const HOPELESS: f64 = 2.5;
/// Scales of learnt roulette that are tried.
const LEARNT_SCALES: [f32; 2] = [2.5, 8.0];
/// Plain tracing's roulette: the best of 1, 4, 16 and off on most scenes (docs/PERFORMANCE.md).
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
    /// From measured times per ray: on an H100 0.07 ns and 1.4 ps per shape test, 0.085 ns for the table; on a CPU 60 ns,
    /// 3 ns and 240 ns.
    fn new(engine: EngineKind, tests: usize) -> CostModel {
        let (test, table) = match engine {
            EngineKind::Cpu => (0.05, 4.0),
            _ => (0.02, 1.2),
        };
        let plain = 1.0 + test * tests as f64;
        CostModel { plain, informed: plain + table, sample: 0.3 }
    }

    fn of(&self, strategy: &Strategy, rays: f64) -> f64 {
        self.sample + rays * if strategy.informed { self.informed } else { self.plain }
    }
}

/// The strategies to be tried, the one that learns first. A single one where nothing is to be compared.
fn strategies(options: &RenderOptions, estimators: Estimators) -> Vec<Strategy> {
    let Estimators { roulette, roulette_scale, .. } = estimators;
    let own = Strategy { informed: true, roulette, roulette_scale };
    if !options.guide.trial || estimators.guide == GuideMode::Off {
        return vec![own];
    }
    let plain = match roulette {
        Roulette::Off => Strategy { informed: false, ..own },
        _ => PLAIN,
    };
    if roulette != Roulette::Learnt || options.roulette_scale.is_some() {
        return vec![own, plain];
    }
    let scales = LEARNT_SCALES.map(|roulette_scale| Strategy { roulette_scale, ..own });
    scales.into_iter().chain([plain]).collect()
}

/// The strategy that does without the table, if it is tried.
pub fn plain_strategy(options: &RenderOptions, estimators: Estimators) -> Option<Strategy> {
    strategies(options, estimators).into_iter().find(|strategy| !strategy.informed)
}

/// Decides the passes of a render.
#[derive(Clone, Debug)]
pub struct Planner {
    arms: Vec<Arm>,
    /// The arm that learns, or that was chosen.
    chosen: usize,
    learning_samples: u32,
    costs: CostModel,
    trial: Trial,
}

/// A strategy and its noise × cost, from when it was last judged.
#[derive(Clone, Copy, Debug)]
struct Arm {
    strategy: Strategy,
    judged: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Trial {
    /// Before trial number `usize`.
    Before(usize),
    /// Trial number `round` is at this arm; learning goes on from `resume` samples.
    At {
        round: usize,
        arm: usize,
        resume: u32,
    },
    Over,
}

impl Planner {
    pub fn new(
        options: &RenderOptions,
        estimators: Estimators,
        engine: EngineKind,
        shapes: usize,
    ) -> Planner {
        let strategies = strategies(options, estimators);
        let tried = strategies.len() > 1;
        let tests = shapes * if estimators.direct_light { 2 } else { 1 };
        Planner {
            trial: if tried { Trial::Before(0) } else { Trial::Over },
            arms: strategies.into_iter().map(|strategy| Arm { strategy, judged: f64::INFINITY }).collect(),
            chosen: 0,
            learning_samples: options.guide.learning_samples,
            costs: CostModel::new(engine, tests),
        }
    }

    /// The first pass. Even without a lesson there is something to be found out: the estimates of the pixels.
    pub fn first(&mut self) -> Pass {
        Pass {
            strategy: self.arms[self.chosen].strategy,
            end: FIRST_PASS,
            learning: self.learning_samples > 0,
            trial: false,
        }
    }

    /// Takes in what a pass was worth: the variance of a sample, the rays of a path.
    pub fn judge(&mut self, pass: &Pass, variance: f64, rays: f64) {
        let judged = variance * self.costs.of(&pass.strategy, rays);
        if let Some(arm) = self.arms.iter_mut().find(|arm| arm.strategy == pass.strategy) {
            arm.judged = judged;
        }
    }

    /// The pass after `samples` samples per pixel.
    pub fn next(&mut self, samples: u32) -> Pass {
        match self.trial {
            Trial::Before(round) if samples >= TRIALS[round].0 => {
                self.trial = Trial::At { round, arm: 0, resume: samples };
            }
            Trial::At { round, arm, resume } => {
                self.trial = Trial::At { round, arm: arm + 1, resume };
            }
            _ => (),
        }
        if let Trial::At { round, arm, resume } = self.trial {
            // The arm that learnt until now was judged by its last pass.
            let next = (arm..self.arms.len()).find(|&arm| arm != self.chosen);
            if let Some(arm) = next {
                self.trial = Trial::At { round, arm, resume };
                let strategy = self.arms[arm].strategy;
                let end = samples + TRIALS[round].1;
                return Pass { strategy, end, learning: strategy.informed, trial: true };
            }
            self.decide(round);
        }
        self.learn_on(samples)
    }

    /// Chooses by what the trials showed.
    fn decide(&mut self, round: usize) {
        let best = |informed: bool| {
            let arms = (0..self.arms.len()).filter(|&i| self.arms[i].strategy.informed == informed);
            arms.min_by(|&a, &b| self.arms[a].judged.total_cmp(&self.arms[b].judged))
        };
        let (Some(guided), Some(plain)) = (best(true), best(false)) else { return };
        let ratio = self.arms[guided].judged / self.arms[plain].judged;
        let last = round + 1 == TRIALS.len();
        (self.chosen, self.trial) = match ratio {
            r if r > HOPELESS || last && r > 1.0 => (plain, Trial::Over),
            r if last || r <= 0.5 => (guided, Trial::Over),
            _ => (guided, Trial::Before(round + 1)),
        };
    }

    /// Passes of doubling size while learning goes on, then one without end.
    fn learn_on(&self, samples: u32) -> Pass {
        let strategy = self.arms[self.chosen].strategy;
        let learning = strategy.informed && samples < self.learning_samples;
        let doubled = (samples + 1).next_power_of_two();
        // A pass that would be short is not worth a lesson.
        let end = if f64::from(doubled) < 1.4 * f64::from(samples) { 2 * doubled } else { doubled };
        Pass { strategy, end: if learning { end } else { u32::MAX }, learning, trial: false }
    }
}
