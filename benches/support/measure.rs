//! Renders with check points: the clock runs while the renderer works, lessons and tables included.

use qtracer::{Budget, RenderError, Renderer};
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};

/// Where renders are looked at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Checks {
    /// Seconds, rising.
    Seconds(Vec<f64>),
    /// Samples per pixel, rising.
    Samples(Vec<u32>),
}

impl Checks {
    /// `count` check points up to `budget` seconds, each at twice the seconds of the one before.
    pub fn geometric(budget: f64, count: u32) -> Checks {
        Checks::Seconds((0..count).rev().map(|halvings| budget * 0.5f64.powi(halvings as i32)).collect())
    }

    pub fn len(&self) -> usize {
        match self {
            Checks::Seconds(seconds) => seconds.len(),
            Checks::Samples(samples) => samples.len(),
        }
    }

    /// Check point `check` in words.
    pub fn goal(&self, check: usize) -> String {
        match self {
            Checks::Seconds(seconds) => format!("{} s", seconds[check]),
            Checks::Samples(samples) => format!("{} samples", samples[check]),
        }
    }

    /// What a render comes to.
    pub fn budget(&self) -> Budget {
        let (mut budget, seconds) = (Budget::default(), |s: &f64| Duration::from_secs_f64(*s));
        match self {
            Checks::Seconds(goals) => budget.time = goals.last().map(seconds),
            Checks::Samples(goals) => budget.samples = goals.last().copied(),
        }
        budget
    }

    fn reached(&self, check: usize, seconds: f64, samples: u32) -> bool {
        match self {
            Checks::Seconds(goals) => seconds >= goals[check],
            Checks::Samples(goals) => samples >= goals[check],
        }
    }

    /// Samples to ask for next on the way to check point `check`.
    fn ask(&self, check: usize, seconds: f64, samples: u32) -> u32 {
        match self {
            Checks::Samples(goals) => goals[check] - samples,
            Checks::Seconds(_) if samples == 0 => 1,
            Checks::Seconds(goals) => {
                // Short of the goal, since speed varies; by no less than a 16th of what was done, so that it is reached.
                let rest = f64::from(samples) / seconds * (goals[check] - seconds);
                let asked = ((0.7 * rest) as u32).max(samples / 16).max(1);
                // Whole blocks of samples, once there are enough.
                if asked < 32 { asked } else { (samples + asked) / 32 * 32 - samples }.max(1)
            }
        }
    }
}

/// What was found at a check point.
pub struct Reached {
    pub seconds: f64,
    pub samples: u32,
    pub rgb: Vec<[f32; 3]>,
}

/// Renders to the last check point; `see` gets what was reached at each. Looking is not on the clock.
pub fn render(
    renderer: &mut Renderer,
    checks: &Checks,
    mut see: impl FnMut(Reached),
) -> Result<(), RenderError> {
    let mut seconds = 0.0;
    for check in 0..checks.len() {
        while !checks.reached(check, seconds, renderer.samples()) {
            let asked = checks.ask(check, seconds, renderer.samples());
            let start = Instant::now();
            renderer.step(asked)?;
            seconds += start.elapsed().as_secs_f64();
        }
        see(Reached { seconds, samples: renderer.samples(), rgb: renderer.image().rgb });
    }
    Ok(())
}
