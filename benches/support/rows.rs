//! Raw rows: what one render had reached at one check point. A JSON object a line, appended and flushed one by one, so that
//! an interrupted run keeps what it measured; the same as CSV. `benches/peers/` writes the same rows.

use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::Path;

/// One render at one check point. Fields that a renderer can't know may be left out of the file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Row {
    pub scene: String,
    /// `qtracer`, or the name of a peer.
    pub renderer: String,
    /// How it ran: the engine and schedule; a peer's own variant.
    pub engine: String,
    /// GUIDE[:ROULETTE[:SCALE]].
    pub variant: String,
    pub direct_light: bool,
    pub max_bounces: u32,
    #[serde(default)]
    pub sampler: String,
    pub width: u32,
    pub height: u32,
    pub seed: u32,
    /// The check point that was to be reached, such as `4 s` or `64 samples`: rows of different seeds with the same goal are
    /// one mark of a plot.
    pub goal: String,
    /// Per pixel.
    pub samples: u32,
    /// From the first sample on, learning included, and neither the reading of the scene nor compilation.
    pub seconds: f64,
    /// Before the first sample: device, kernels, where surfaces are.
    #[serde(default)]
    pub setup_seconds: f64,
    /// Mean of (image − reference)² / (reference² + epsilon), minus what the reference's own noise makes of it; absent where
    /// only speed was measured.
    #[serde(default)]
    pub relative_mse: Option<f64>,
    /// The same without the worst 0.1 % of the pixels.
    #[serde(default)]
    pub trimmed: Option<f64>,
    #[serde(default)]
    pub epsilon: f64,
    /// What errors were measured against.
    #[serde(default)]
    pub truth: String,
    /// What the reference's own noise adds to a relMSE, already subtracted; 0 where seeds are compared with each other.
    #[serde(default)]
    pub truth_noise: f64,
    #[serde(default)]
    pub device: String,
    #[serde(default)]
    pub driver: String,
    /// Of qtracer, or version of the peer.
    #[serde(default)]
    pub commit: String,
    /// Day of the measurement, such as 2026-11-22 (UTC).
    #[serde(default)]
    pub date: String,
}

impl Row {
    /// Millions of samples (of all pixels) in a second.
    pub fn megasamples_per_second(&self) -> f64 {
        f64::from(self.width) * f64::from(self.height) * f64::from(self.samples)
            / self.seconds.max(1e-12)
            / 1e6
    }
}

/// Appends rows to a file, each at once.
pub struct RowFile {
    file: File,
}

impl RowFile {
    /// Opens for appending; makes the folder if it is missing.
    pub fn append(path: &Path) -> Result<RowFile, String> {
        let fault = |error| format!("can't write {}: {error}", path.display());
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(fault)?;
        }
        Ok(RowFile { file: OpenOptions::new().create(true).append(true).open(path).map_err(fault)? })
    }

    pub fn write(&mut self, row: &Row) -> Result<(), String> {
        let line = serde_json::to_string(row).map_err(|error| error.to_string())?;
        let written = self.file.write_all(format!("{line}\n").as_bytes()).and_then(|()| self.file.flush());
        written.map_err(|error| format!("can't write a row: {error}"))
    }
}

/// The rows of a text of JSON lines; a last line that was cut short is left out, any other fault is an error.
pub fn parse(text: &str, name: &str) -> Result<Vec<Row>, String> {
    let lines: Vec<(usize, &str)> =
        text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).collect();
    let mut rows = Vec::new();
    for (at, &(number, line)) in lines.iter().enumerate() {
        match serde_json::from_str(line) {
            Ok(row) => rows.push(row),
            Err(_) if at + 1 == lines.len() && !text.ends_with('\n') => break,
            Err(error) => return Err(format!("{name}, line {}: no row: {error}", number + 1)),
        }
    }
    Ok(rows)
}

/// The rows of several files.
pub fn read(paths: &[String]) -> Result<Vec<Row>, String> {
    let mut rows = Vec::new();
    for path in paths {
        let text = std::fs::read_to_string(path).map_err(|error| format!("can't read {path}: {error}"))?;
        rows.extend(parse(&text, path)?);
    }
    Ok(rows)
}

/// The rows as CSV, after a line of names; what is absent is empty.
pub fn csv(rows: &[Row]) -> String {
    let mut text = String::new();
    for row in rows {
        let Ok(serde_json::Value::Object(fields)) = serde_json::to_value(row) else { continue };
        if text.is_empty() {
            let names: Vec<&str> = fields.keys().map(String::as_str).collect();
            let _ = writeln!(text, "{}", names.join(","));
        }
        let cells: Vec<String> = fields.values().map(csv_cell).collect();
        let _ = writeln!(text, "{}", cells.join(","));
    }
    text
}

fn csv_cell(value: &serde_json::Value) -> String {
    match value {
        serde_json::Value::Null => String::new(),
        serde_json::Value::String(text) if text.contains([',', '"', '\n']) => {
            format!("\"{}\"", text.replace('"', "\"\""))
        }
        serde_json::Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
