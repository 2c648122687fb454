//! Rows of many seeds become curves: a point per check point, with mean and standard error over the seeds.

use super::rows::Row;
use std::collections::{BTreeMap, BTreeSet};

/// A mean over seeds and the standard error of that mean (NaN from a single seed, which tells nothing of it).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    pub mean: f64,
    pub error: f64,
}

impl Estimate {
    /// Of values drawn independently.
    pub fn of(values: &[f64]) -> Estimate {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
        Estimate { mean, error: (variance / n).sqrt() }
    }
}

/// What all seeds had reached at one check point.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    pub seeds: usize,
    /// Mean samples per pixel.
    pub samples: f64,
    /// Mean seconds.
    pub seconds: f64,
    /// relMSE; None where only speed was measured.
    pub error: Option<Estimate>,
    /// relMSE without the worst 0.1 % of the pixels.
    pub trimmed: Option<Estimate>,
    pub megasamples_per_second: f64,
}

impl Point {
    /// 1/(relMSE · seconds), its standard error by that of the relMSE. None where the error is unknown or not above 0.
    pub fn efficiency(&self) -> Option<Estimate> {
        self.inverse(self.error)
    }

    /// The same of the trimmed relMSE.
    pub fn trimmed_efficiency(&self) -> Option<Estimate> {
        self.inverse(self.trimmed)
    }

    fn inverse(&self, error: Option<Estimate>) -> Option<Estimate> {
        let error = error.filter(|e| e.mean > 0.0 && e.mean.is_finite() && self.seconds > 0.0)?;
        let mean = 1.0 / (error.mean * self.seconds);
        Some(Estimate { mean, error: mean * error.error / error.mean })
    }
}

/// One way to render one scene: points in the order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    pub renderer: String,
    pub engine: String,
    pub variant: String,
    pub direct_light: bool,
    pub max_bounces: u32,
    pub sampler: String,
    pub device: String,
    /// What tells it from the other curves of its scene.
    pub label: String,
    pub points: Vec<Point>,
}

impl Curve {
    pub fn last(&self) -> &Point {
        self.points.last().expect("a curve has a point")
    }

    pub fn is_peer(&self) -> bool {
        self.renderer != "qtracer"
    }

    /// Whether it neither guides nor learns anything.
    pub fn is_plain(&self) -> bool {
        let mut parts = self.variant.split(':');
        parts.next() == Some("off") && parts.next() != Some("learnt")
    }
}

/// Everything measured of one scene at one size.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneSummary {
    pub name: String,
    pub width: u32,
    pub height: u32,
    pub epsilon: f64,
    /// What errors were measured against, and what its noise adds to a relMSE.
    pub truths: BTreeSet<String>,
    pub truth_noise: f64,
    pub curves: Vec<Curve>,
}

impl SceneSummary {
    /// The efficiency of the best plain curve of qtracer on the same device with the same direct light: the baseline of a
    /// gain. None if there is no such curve.
    pub fn best_plain(&self, curve: &Curve) -> Option<f64> {
        let same = |other: &&Curve| {
            !other.is_peer()
                && other.is_plain()
                && other.device == curve.device
                && other.direct_light == curve.direct_light
        };
        let all = self.curves.iter().filter(same).filter_map(|plain| plain.last().efficiency());
        all.map(|efficiency| efficiency.mean).reduce(f64::max)
    }
}

/// Scenes in the order in which they appear, curves likewise.
pub fn summarize(rows: &[Row]) -> Vec<SceneSummary> {
    let mut scenes: Vec<(SceneKey, Vec<&Row>)> = Vec::new();
    for row in rows {
        let key = (row.scene.clone(), row.width, row.height, row.epsilon.to_bits());
        // Speed alone has no epsilon: it joins the first table of its scene and size.
        let fits = |other: &SceneKey| match row.relative_mse {
            Some(_) => *other == key,
            None => (&other.0, other.1, other.2) == (&key.0, key.1, key.2),
        };
        match scenes.iter_mut().find(|(other, _)| fits(other)) {
            Some((_, members)) => members.push(row),
            None => scenes.push((key, vec![row])),
        }
    }
    scenes.into_iter().map(|((name, ..), rows)| scene_summary(name, &rows)).collect()
}

/// Name, width, height, bits of epsilon.
type SceneKey = (String, u32, u32, u64);

fn scene_summary(name: String, rows: &[&Row]) -> SceneSummary {
    let mut groups: Vec<Vec<&Row>> = Vec::new();
    for &row in rows {
        match groups.iter_mut().find(|group| curve_key(group[0]) == curve_key(row)) {
            Some(group) => group.push(row),
            None => groups.push(vec![row]),
        }
    }
    let mut curves: Vec<Curve> = groups.iter().map(|group| curve(group)).collect();
    label(&mut curves);
    let measured = || rows.iter().filter(|row| row.relative_mse.is_some());
    SceneSummary {
        name,
        width: rows[0].width,
        height: rows[0].height,
        epsilon: measured().next().map_or(0.0, |row| row.epsilon),
        truths: measured().map(|row| row.truth.clone()).collect(),
        truth_noise: measured().map(|row| row.truth_noise).fold(0.0, f64::max),
        curves,
    }
}

fn curve_key(row: &Row) -> (&str, &str, &str, bool, u32, &str, &str) {
    let (renderer, engine, variant) = (&row.renderer, &row.engine, &row.variant);
    (renderer, engine, variant, row.direct_light, row.max_bounces, &row.sampler, &row.device)
}

fn curve(rows: &[&Row]) -> Curve {
    // A seed measured again replaces what it gave before: the same paths twice would feign a smaller error.
    let mut goals: BTreeMap<&str, BTreeMap<u32, &Row>> = BTreeMap::new();
    for &row in rows {
        goals.entry(&row.goal).or_default().insert(row.seed, row);
    }
    let seeds = |by_seed: &BTreeMap<u32, &Row>| point(&by_seed.values().copied().collect::<Vec<_>>());
    let mut points: Vec<Point> = goals.values().map(seeds).collect();
    points.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    let first = rows[0];
    Curve {
        renderer: first.renderer.clone(),
        engine: first.engine.clone(),
        variant: first.variant.clone(),
        direct_light: first.direct_light,
        max_bounces: first.max_bounces,
        sampler: first.sampler.clone(),
        device: first.device.clone(),
        label: String::new(),
        points,
    }
}

fn point(rows: &[&Row]) -> Point {
    let values = |value: &dyn Fn(&Row) -> f64| rows.iter().map(|row| value(row)).collect::<Vec<f64>>();
    let mean = |value: &dyn Fn(&Row) -> f64| Estimate::of(&values(value)).mean;
    let errors = |value: &dyn Fn(&Row) -> Option<f64>| {
        let known: Vec<f64> = rows.iter().filter_map(|row| value(row)).collect();
        (!known.is_empty()).then(|| Estimate::of(&known))
    };
    Point {
        seeds: rows.len(),
        samples: mean(&|row| f64::from(row.samples)),
        seconds: mean(&|row| row.seconds),
        error: errors(&|row| row.relative_mse),
        trimmed: errors(&|row| row.trimmed),
        megasamples_per_second: mean(&Row::megasamples_per_second),
    }
}

/// Names each curve by what differs among the curves of its scene.
fn label(curves: &mut [Curve]) {
    let differs =
        |value: &dyn Fn(&Curve) -> String| curves.iter().map(value).collect::<BTreeSet<_>>().len() > 1;
    let devices = differs(&|c| c.device.clone());
    let bounces = differs(&|c| c.max_bounces.to_string());
    let samplers = curves.iter().filter(|c| !c.is_peer()).map(|c| c.sampler.clone());
    let samplers = samplers.collect::<BTreeSet<_>>().len() > 1;
    let short: BTreeSet<&str> = curves.iter().map(|c| short_device(&c.device)).collect();
    let full: BTreeSet<&str> = curves.iter().map(|c| c.device.as_str()).collect();
    let shorten = short.len() == full.len();
    for curve in curves {
        let renderer = if curve.is_peer() { format!("{} ", curve.renderer) } else { String::new() };
        let mut label = format!("{renderer}{} {}", curve.engine, curve.variant);
        if !curve.direct_light {
            label.push_str(", no direct light");
        }
        if bounces {
            label.push_str(&format!(", {} levels", curve.max_bounces));
        }
        if samplers && !curve.is_peer() {
            label.push_str(&format!(", {}", curve.sampler));
        }
        if devices {
            let device = if shorten { short_device(&curve.device) } else { &curve.device };
            label.push_str(&format!(" on {device}"));
        }
        curve.label = label;
    }
}

/// `llvmpipe` of `llvmpipe (LLVM 15.0.6, 256 bits)`.
fn short_device(device: &str) -> &str {
    device.split([',', '(']).next().unwrap_or(device).trim()
}
