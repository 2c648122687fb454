//! The pilot: a few paths that find out where surfaces are, before anything is learnt.

use super::RenderError;
use crate::accel::Search;
use crate::guiding::{GuideOptions, GuideTable, Learner, LessonLayout, LessonSums};
use crate::math::luminance;
use crate::scene::compiled::{CompiledScene, Uniforms};
use crate::transport::guide::Guidance;
use crate::transport::path::Transport;
use glam::Vec3;
use rayon::prelude::*;

/// Paths that it traces.
const PILOT_PATHS: u32 = 4096;

/// Traces a few paths on the CPU, the same whatever the engine: the learner's grid covers the surface points that they
/// meet, and has a cell wherever they did. A scene's bounds would not do: walls may be spheres of radius 2000. A learner
/// that was there `before` keeps its grid, and all its cells if it is not to learn.
pub fn pilot(
    options: GuideOptions,
    before: Option<&Learner>,
    scene: &CompiledScene,
    uniforms: &Uniforms,
) -> Result<Learner, RenderError> {
    let pixels = uniforms.width * uniforms.height;
    let uniforms = Uniforms { pixel_count: pixels, seed: uniforms.seed ^ 0x9e37_79b9, ..*uniforms };
    let search = Search::new(scene);
    let transport = Transport { guidance: None, ..Transport::plain(scene, &search, &uniforms) };
    let paths = |transport: &Transport| -> Vec<Vec3> {
        (0..PILOT_PATHS).into_par_iter().flat_map_iter(|i| surface_points(transport, pixels, i)).collect()
    };
    let brightest = scene.materials.iter().map(|m| luminance(m.emission)).fold(0.0, f32::max);
    let sky = scene.sky.as_ref().map_or(scene.environment, |sky| sky.brightest);
    let brightest = brightest.max(luminance(sky));
    let mut learner = match before {
        Some(learner) => learner.resumed(options, brightest)?,
        None => {
            let [low, high] = extent(&paths(&transport));
            Learner::new(options, low, high, brightest)?
        }
    };
    if before.is_some() && options.learning_samples == Some(0) {
        return Ok(learner);
    }
    let table: GuideTable = learner.table(true, &[]);
    let mut sums = LessonSums::new(LessonLayout::new(&table.uniforms));
    let guidance = Guidance { mode: options.mode, table: &table, sums: &sums };
    paths(&Transport { guidance: Some(guidance), ..transport });
    learner.make_cells(&sums.take().missing);
    Ok(learner)
}

/// Points at which the `i`-th pilot path leaves surfaces.
fn surface_points(transport: &Transport, pixels: u32, i: u32) -> Vec<Vec3> {
    let pixel = (u64::from(i) * u64::from(pixels) / u64::from(PILOT_PATHS)) as u32;
    // In images of fewer pixels, several samples of each.
    let sample = if pixels < PILOT_PATHS { i % PILOT_PATHS.div_ceil(pixels) } else { 0 };
    let mut points = Vec::new();
    let mut ray = transport.generate(sample * pixels + pixel);
    let mut trail = Default::default();
    while let outcome = transport.step(&ray, &trail)
        && let Some(next) = outcome.ray
    {
        points.push(next.origin);
        (ray, trail) = (next, outcome.trail);
    }
    points
}

/// Corners of the box that holds the points, those few apart that lie far out: an open scene's ground ends somewhere.
fn extent(points: &[Vec3]) -> [Vec3; 2] {
    let mut low = Vec3::ZERO;
    let mut high = Vec3::ONE;
    for axis in 0..3 {
        let mut values: Vec<f32> = points.iter().map(|p| p[axis]).filter(|v| v.is_finite()).collect();
        if values.is_empty() {
            continue;
        }
        values.sort_by(f32::total_cmp);
        let at = |share: f64| values[((values.len() - 1) as f64 * share) as usize];
        let (inner_low, inner_high) = (at(0.01), at(0.99));
        let reach = inner_high - inner_low;
        low[axis] = at(0.0).max(inner_low - reach);
        high[axis] = at(1.0).min(inner_high + reach);
    }
    [low, high]
}
