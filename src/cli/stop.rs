//! When a render is done, and how many samples to ask for until then.

use qtracer::Budget;
use std::time::Duration;

/// What the user asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    Samples,
    /// This long, not counting preparation and writing.
    Time(Duration),
    /// This relative standard error ([`qtracer::Renderer::relative_error`]) or less.
    Error(f64),
}

/// The goal and the ceiling: whichever comes first ends the render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    pub goal: Goal,
    pub max_samples: u32,
}

/// How far a render is.
#[derive(Clone, Copy, Debug)]
pub struct State {
    /// Samples of each pixel.
    pub samples: u32,
    pub elapsed: Duration,
    /// Infinite while unknown, or where the goal does not need it.
    pub relative_error: f64,
}

/// Standard errors estimated from fewer samples are not trusted.
const FEWEST_SAMPLES_FOR_ERROR: u32 = 16;
/// How much of the time that is left to plan for, since rates vary.
const TIME_MARGIN: f64 = 0.9;

impl Stop {
    /// What the render comes to.
    pub fn budget(&self) -> Budget {
        let ceiling = Budget { samples: Some(self.max_samples), ..Default::default() };
        match self.goal {
            Goal::Samples => ceiling,
            Goal::Time(limit) => Budget { time: Some(limit), ..ceiling },
            Goal::Error(limit) => Budget { error: Some(limit), ..ceiling },
        }
    }

    pub fn needs_error(&self) -> bool {
        matches!(self.goal, Goal::Error(_))
    }

    /// Samples to ask for next; 0 when done.
    pub fn next(&self, state: &State) -> u32 {
        let left = self.max_samples.saturating_sub(state.samples);
        let samples = f64::from(state.samples);
        match self.goal {
            Goal::Samples => left,
            _ if left == 0 => 0,
            Goal::Time(_) | Goal::Error(_) if state.samples == 0 => 1,
            Goal::Time(limit) => {
                let Some(rest) = limit.checked_sub(state.elapsed).filter(|r| !r.is_zero()) else {
                    return 0;
                };
                let rate = samples / state.elapsed.as_secs_f64().max(1e-6);
                (rate * rest.as_secs_f64() * TIME_MARGIN).clamp(1.0, f64::from(left)) as u32
            }
            Goal::Error(_) if state.samples < FEWEST_SAMPLES_FOR_ERROR => {
                left.min(FEWEST_SAMPLES_FOR_ERROR - state.samples)
            }
            Goal::Error(limit) if state.relative_error <= limit => 0,
            // Errors fall with the square root of the samples. Early estimates are rough: at most double.
            Goal::Error(limit) => {
                let needed = samples * ((state.relative_error / limit).powi(2) - 1.0);
                needed.ceil().clamp(1.0, samples).min(f64::from(left)) as u32
            }
        }
    }

    /// Whether it ended at the ceiling, short of the error asked for.
    pub fn fell_short(&self, state: &State) -> bool {
        matches!(self.goal, Goal::Error(limit) if state.relative_error > limit)
    }

    /// Share of the work that is done, 0 to 1.
    pub fn fraction(&self, state: &State) -> f64 {
        let of_samples = f64::from(state.samples) / f64::from(self.max_samples.max(1));
        let of_goal = match self.goal {
            Goal::Samples => 0.0,
            Goal::Time(limit) => state.elapsed.as_secs_f64() / limit.as_secs_f64().max(1e-6),
            Goal::Error(limit) => (limit / state.relative_error).powi(2),
        };
        of_samples.max(of_goal).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(samples: u32, seconds: f64, relative_error: f64) -> State {
        let elapsed = Duration::from_secs_f64(seconds);
        State { samples, elapsed, relative_error }
    }

    fn stop(goal: Goal, max_samples: u32) -> Stop {
        Stop { goal, max_samples }
    }

    #[test]
    fn a_budget_is_the_goal_and_the_ceiling() {
        let of = |goal| Stop { goal, max_samples: 300 }.budget();
        let (second, ceiling) = (Duration::from_secs(1), Budget { samples: Some(300), ..Default::default() });
        assert_eq!(of(Goal::Samples), ceiling);
        assert_eq!(of(Goal::Time(second)), Budget { time: Some(second), ..ceiling });
        assert_eq!(of(Goal::Error(0.1)), Budget { error: Some(0.1), ..ceiling });
    }

    #[test]
    fn a_sample_goal_asks_for_all_that_is_left() {
        let stop = stop(Goal::Samples, 64);
        assert_eq!(stop.next(&state(0, 0.0, f64::INFINITY)), 64);
        assert_eq!(stop.next(&state(64, 9.0, f64::INFINITY)), 0);
        assert_eq!(stop.fraction(&state(16, 9.0, f64::INFINITY)), 0.25);
    }

    #[test]
    fn a_time_goal_asks_for_what_fits_and_always_gets_a_sample() {
        let stop = stop(Goal::Time(Duration::from_secs(10)), u32::MAX);
        assert_eq!(stop.next(&state(0, 11.0, f64::INFINITY)), 1);
        let asked = stop.next(&state(100, 5.0, f64::INFINITY));
        assert!((50..=100).contains(&asked), "{asked}");
        assert_eq!(stop.next(&state(1, 9.999, f64::INFINITY)), 1);
        assert_eq!(stop.next(&state(100, 10.0, f64::INFINITY)), 0);
    }

    #[test]
    fn an_error_goal_approaches_what_the_square_root_law_predicts() {
        let stop = stop(Goal::Error(0.01), 10_000);
        assert_eq!(stop.next(&state(2, 1.0, 0.0)), 14);
        assert_eq!(stop.next(&state(100, 1.0, 0.0125)), 57);
        assert_eq!(stop.next(&state(100, 1.0, f64::INFINITY)), 100);
        assert_eq!(stop.next(&state(9_990, 1.0, 0.5)), 10);
        assert_eq!(stop.next(&state(100, 1.0, 0.01)), 0);
        assert!(stop.fell_short(&state(10_000, 1.0, 0.02)));
    }
}
