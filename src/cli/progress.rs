//! The progress bar: on stderr, and only where that is a terminal.

use super::stop::{State, Stop};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::time::Duration;

/// Steps of the bar.
const STEPS: u64 = 1000;

pub struct Progress {
    bar: ProgressBar,
    pixels: f64,
}

impl Progress {
    pub fn new(pixels: u64, quiet: bool) -> Self {
        let bar = match quiet || !std::io::stderr().is_terminal() {
            true => ProgressBar::hidden(),
            false => ProgressBar::new(STEPS),
        };
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {percent:>3} %  {msg}") {
            bar.set_style(style);
        }
        Progress { bar, pixels: pixels as f64 }
    }

    pub fn show(&self, stop: &Stop, state: &State) {
        if !self.bar.is_hidden() {
            let fraction = stop.fraction(state);
            self.bar.set_position((fraction * STEPS as f64) as u64);
            self.bar.set_message(message(stop, state, fraction, self.pixels));
        }
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

fn message(stop: &Stop, state: &State, fraction: f64, pixels: f64) -> String {
    let samples = match stop.max_samples {
        u32::MAX => format!("{} samples", state.samples),
        max => format!("{}/{max} samples", state.samples),
    };
    let seconds = state.elapsed.as_secs_f64();
    if state.samples == 0 || seconds <= 0.0 {
        return samples;
    }
    let rate = f64::from(state.samples) * pixels / seconds / 1e6;
    let error = match state.relative_error.is_finite() {
        true => format!("  error {:.2} %", 100.0 * state.relative_error),
        false => String::new(),
    };
    let left = match seconds * (1.0 - fraction) / fraction {
        left if left.is_finite() => format!("  {} left", clock(left)),
        _ => String::new(),
    };
    format!("{samples}{error}  {rate:.2} Msamples/s{left}")
}

/// `12 s`, `3:05`, `1:02:03`.
fn clock(seconds: f64) -> String {
    let whole = Duration::from_secs_f64(seconds.clamp(0.0, 1e9).ceil()).as_secs();
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m}:{s:02}"),
        (h, m, s) => format!("{h}:{m:02}:{s:02}"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::stop::Goal;
    use super::*;

    #[test]
    fn the_message_tells_samples_rate_and_time_left() {
        let stop = Stop { goal: Goal::Samples, max_samples: 64 };
        let state = State { samples: 16, elapsed: Duration::from_secs(25), relative_error: f64::INFINITY };
        let text = message(&stop, &state, stop.fraction(&state), 1e6);
        assert_eq!(text, "16/64 samples  0.64 Msamples/s  1:15 left");
        assert_eq!(clock(3723.0), "1:02:03");
    }
}
