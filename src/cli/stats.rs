//! Figures about a finished render: a line for people, text or JSON for `--stats`.

use super::console;
use super::failure::Failure;
use super::render_args::{Job, StatsFormat};
use qtracer::{RenderStats, Renderer};
use serde::Serialize;
use std::fmt::Write;
use std::path::PathBuf;
use std::time::Duration;

/// What `--stats json` prints. Figures that do not exist are null.
#[derive(Debug, Serialize)]
pub struct Report {
    pub scene: String,
    pub width: u32,
    pub height: u32,
    pub seed: u32,
    pub first_sample: u32,
    /// Finished samples of each pixel.
    pub samples: u64,
    /// Whether all that was asked for was rendered.
    pub complete: bool,
    /// Seconds before the first sample: opening the GPU, compiling kernels.
    pub preparation_seconds: f64,
    /// Seconds of rendering.
    pub wall_seconds: f64,
    /// Million paths (samples of a pixel) per second of rendering.
    pub mpaths_per_second: f64,
    /// See `--error`.
    pub relative_error: f64,
    #[serde(flatten)]
    pub engine: RenderStats,
}

impl Report {
    pub fn new(
        job: &Job,
        renderer: &Renderer,
        complete: bool,
        preparation: Duration,
        elapsed: Duration,
    ) -> Self {
        let (film, engine) = (renderer.film(), renderer.stats());
        let wall_seconds = elapsed.as_secs_f64();
        Report {
            scene: job.scene.name.clone(),
            width: film.width(),
            height: film.height(),
            seed: job.options.seed,
            first_sample: job.options.first_sample,
            samples: film.samples().0,
            complete,
            preparation_seconds: preparation.as_secs_f64(),
            wall_seconds,
            mpaths_per_second: engine.paths as f64 / 1e6 / wall_seconds.max(1e-9),
            relative_error: renderer.relative_error(),
            engine,
        }
    }

    /// One line about all.
    pub fn summary(&self, written: &[&PathBuf]) -> String {
        let mut text = format!(
            "{}: {}x{}, {} samples/pixel, {} ({}), {:.2} s, {:.2} Msamples/s",
            self.scene,
            self.width,
            self.height,
            self.samples,
            self.engine.engine,
            self.engine.device,
            self.wall_seconds,
            self.mpaths_per_second,
        );
        for (index, path) in written.iter().enumerate() {
            let before = if index == 0 { "; wrote" } else { "," };
            let _ = write!(text, "{before} {}", path.display());
        }
        text
    }
}

pub fn print(report: &Report, format: StatsFormat) -> Result<(), Failure> {
    match format {
        StatsFormat::Json => console::json(report),
        StatsFormat::Text => {
            let value = serde_json::to_value(report)
                .map_err(|e| Failure::failed(format!("cannot list figures: {e}")))?;
            let mut text = String::new();
            add_rows(&mut text, "", &value);
            console::data(text)
        }
    }
}

/// A row per figure, by the names of the JSON form: `buffers.film  1024`.
fn add_rows(text: &mut String, name: &str, value: &serde_json::Value) {
    use serde_json::Value;
    match value {
        Value::Object(fields) => {
            let prefix = if name.is_empty() { String::new() } else { format!("{name}.") };
            fields.iter().for_each(|(key, value)| add_rows(text, &format!("{prefix}{key}"), value));
        }
        Value::Array(items) => {
            let items: Vec<&str> = items.iter().filter_map(Value::as_str).collect();
            let _ = writeln!(text, "{name:<24}{}", items.join(" "));
        }
        Value::String(value) => {
            let _ = writeln!(text, "{name:<24}{value}");
        }
        Value::Null => {
            let _ = writeln!(text, "{name:<24}unknown");
        }
        value => {
            let _ = writeln!(text, "{name:<24}{value}");
        }
    }
}
