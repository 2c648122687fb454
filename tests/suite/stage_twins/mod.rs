//! Stages of the wavefront engine on recorded queues of real renders, item by item against the CPU's functions. Whole images
//! can hide what a stage does wrong to a few of its items; here each item is asked about.
//!
//! Words (paths, shapes, bounces, who lives) are equal and vectors within roundings. Where that fails, the twin is asked
//! about questions a few roundings away: if its answer to one of them is the one found, the item is *of two minds* (a ray
//! within rounding of an edge, a random number within rounding of its threshold), and such items are counted and bounded.

mod answers;
mod stages;

use crate::recorded_levels::{skip_to, walk_level};
use crate::support::{adapter, computes_to_the_letter, open_gpu, scene};
use answers::Report;
use glam::Vec3;
use qtracer::accel::Search;
use qtracer::engine::RecordedLevel;
use qtracer::gpu::stage::{Schedule, Stage};
use qtracer::guiding::{GuideMode, GuideOptions, LessonLayout, LessonSums};
use qtracer::scene::compiled::{CompiledScene, Uniforms};
use qtracer::transport::guide::Guidance;
use qtracer::transport::path::Transport;
use qtracer::{RenderOptions, Renderer};
use stages::Stagework;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Levels whose stages are compared: camera rays only, early, late.
const LEVELS: [u32; 3] = [0, 2, 8];
const SCHEDULES: [Schedule; 2] = [Schedule::Streamed, Schedule::Compacted];
/// Items of two minds, at most one in so many.
const RARELY: usize = 200;

fn options(schedule: Schedule) -> RenderOptions {
    RenderOptions {
        size: Some((48, 36)),
        seed: 11,
        schedule: Some(schedule),
        pool: Some(3000),
        adapter: adapter(),
        ..Default::default()
    }
}

/// The largest number that positions are made from.
fn largest_number(scene: &CompiledScene) -> f32 {
    let largest = |v: Vec3| v.abs().max_element();
    let spheres = scene.spheres.iter().map(|s| largest(s.center).max(s.radius));
    let quads = scene.quads.iter().map(|q| largest(q.corner).max(largest(q.corner + q.e1 + q.e2)));
    spheres.chain(quads).fold(0.0, f32::max)
}

/// What a twin is told otherwise than the kernels.
type Lie = fn(&mut CompiledScene, &mut Uniforms);
const TRUTH: Lie = |_, _| ();

/// Compares all stages of some levels of a scene with a twin for each lie, and calls `look` on each report and the lie's number.
fn compare(
    name: &str,
    options: &RenderOptions,
    lies: &[Lie],
    mut look: impl FnMut(usize, u32, Stage, &Report),
) {
    let described = scene(name);
    let compiled = CompiledScene::new(&described);
    let search = Search::new(&compiled);
    let estimators = options.estimators(&described);
    let mut recorded = RecordedLevel::record(&described, options, 0).unwrap();
    let key = *recorded.key();
    let told = |lie: &Lie| {
        let (mut compiled, mut uniforms) = (compiled.clone(), recorded.uniforms());
        lie(&mut compiled, &mut uniforms);
        (compiled, uniforms)
    };
    let told: Vec<_> = lies.iter().map(told).collect();
    let table = recorded.table().cloned();
    let sums = LessonSums::new(table.as_ref().map_or(Default::default(), |t| LessonLayout::new(&t.uniforms)));
    let guidance = table.as_ref().map(|table| Guidance { mode: estimators.table_mode(), table, sums: &sums });
    let twins: Vec<Transport> = told
        .iter()
        .map(|(scene, uniforms)| Transport {
            sampler: estimators.sampler,
            direct_light: estimators.direct_light && scene.has_light_to_sample(),
            roulette: estimators.roulette,
            guidance,
            ..Transport::plain(scene, &search, uniforms)
        })
        .collect();
    // The H100's sines and cosines: directions up to 9 roundings off.
    let slack = if computes_to_the_letter(&open_gpu()) { 1.0 } else { 2.0 };
    let mut at = 0;
    for level in LEVELS {
        skip_to(&mut recorded, at, level);
        walk_level(&mut recorded, |stage, before, after| {
            let schedule = options.schedule.unwrap();
            for (lie, transport) in twins.iter().enumerate() {
                let size = largest_number(&told[lie].0);
                let work = Stagework { transport, key: &key, schedule, size, slack, before, after };
                look(lie, level, stage, &work.check(stage));
            }
        });
        at = level;
    }
}

/// All stages of a scene: no fault, few items of two minds, and enough items of each stage.
fn all_stages_agree(name: &str, options: &RenderOptions) {
    let mut items = BTreeMap::new();
    compare(name, options, &[TRUTH], |_, level, stage, report| {
        let how = (options.schedule.unwrap(), options.guide.mode);
        let at = format!("{name}, {how:?}, level {level}, {}", stage.name());
        let Report { items: count, of_two_minds, faults, by_spread, plain, worst: (worst, part) } = report;
        println!(
            "{at}: {count} items, {of_two_minds} of two minds; plainly {plain:.1} off, {by_spread} judged by spread, worst \
             then {worst:.1} in {part}"
        );
        assert!(faults.is_empty(), "{at}: {} faults, such as\n{}", faults.len(), faults[0]);
        assert!(of_two_minds * RARELY <= *count + RARELY, "{at}: {of_two_minds} of {count} of two minds");
        *items.entry(stage.name()).or_insert(0) += count;
    });
    items.retain(|name, _| !name.starts_with("prepare"));
    assert!(items.len() >= 5 && items.values().all(|&count| count >= 50), "{name}: {items:?}");
}

fn stages_answer_as_their_twins_do(name: &str) {
    SCHEDULES.iter().for_each(|&schedule| all_stages_agree(name, &options(schedule)));
}

#[test]
fn stages_answer_as_their_twins_do_in_a_box() {
    stages_answer_as_their_twins_do("cornell-box");
}

#[test]
fn stages_answer_as_their_twins_do_among_every_material() {
    stages_answer_as_their_twins_do("glass-shelf");
    stages_answer_as_their_twins_do("bansal-room-1");
}

#[test]
fn stages_answer_as_their_twins_do_among_rough_materials() {
    stages_answer_as_their_twins_do("metal-spheres");
    stages_answer_as_their_twins_do("rough-glass");
}

#[test]
fn stages_answer_as_their_twins_do_behind_a_door() {
    stages_answer_as_their_twins_do("door-ajar");
}

#[test]
fn stages_answer_as_their_twins_do_under_an_open_sky() {
    stages_answer_as_their_twins_do("furnace-open-half");
    stages_answer_as_their_twins_do("open-sky");
}

/// With a guide that has learnt: the mixture, what is remembered, what is taught.
#[test]
fn stages_answer_as_their_twins_do_when_guided() {
    for mode in [GuideMode::Adaptive, GuideMode::Octant] {
        let name = "bansal-room-1";
        let guide = GuideOptions { mode, ..Default::default() };
        let learning = RenderOptions { size: Some((32, 32)), seed: 3, guide, ..RenderOptions::cpu() };
        let mut renderer = Renderer::new(&scene(name), learning).unwrap();
        while renderer.samples() < 64 {
            renderer.step(64 - renderer.samples()).unwrap();
        }
        assert!(renderer.stats().guide.unwrap().passes >= 5, "too little was learnt");
        let guide_table = renderer.learner().cloned().map(Arc::new);
        for schedule in SCHEDULES {
            all_stages_agree(
                name,
                &RenderOptions { guide, guide_table: guide_table.clone(), ..options(schedule) },
            );
        }
    }
}

/// Negative controls: a twin that is told something else of the scene or of the batch is found to differ, in the stage that
/// reads it.
#[test]
fn a_twin_that_is_told_something_else_is_reported() {
    let lies: [(&str, Lie); 14] = [
        ("generate", |_, uniforms| uniforms.seed += 1),
        ("generate", |_, uniforms| uniforms.camera_right *= 1.00001),
        ("intersect", |scene, _| scene.spheres[3].radius *= 1.0001),
        ("intersect", |scene, _| scene.quads.iter_mut().for_each(|quad| quad.corner += 1e-4 * quad.normal)),
        ("shade_diffuse", |scene, _| scene.materials.iter_mut().for_each(|m| m.color *= 1.0001)),
        ("shade_mirror", |scene, _| scene.materials.iter_mut().for_each(|m| m.parameter *= 0.99)),
        ("shade_glossy", |scene, _| scene.materials.iter_mut().for_each(|m| m.parameter *= 1.001)),
        ("shade_dielectric", |scene, _| scene.materials.iter_mut().for_each(|m| m.parameter *= 1.0001)),
        ("shade_metal", |scene, _| scene.materials.iter_mut().for_each(|m| m.roughness *= 1.001)),
        ("shade_metallic_roughness", |scene, _| scene.materials.iter_mut().for_each(|m| m.metallic += 0.01)),
        ("shade_rough_dielectric", |scene, _| scene.materials.iter_mut().for_each(|m| m.roughness *= 1.001)),
        ("shade_rough_dielectric", |scene, _| scene.materials.iter_mut().for_each(|m| m.parameter *= 1.0001)),
        ("shade_diffuse", |_, uniforms| uniforms.roulette_scale *= 0.9),
        ("shadow", |scene, _| scene.spheres.iter_mut().for_each(|sphere| sphere.radius *= 1.01)),
    ];
    let scene_of = |stage: &str| match stage {
        "shade_metal" | "shade_metallic_roughness" => "metal-spheres",
        "shade_rough_dielectric" => "rough-glass",
        _ => "glass-shelf",
    };
    for name in ["glass-shelf", "metal-spheres", "rough-glass"] {
        let (stages, told): (Vec<&str>, Vec<Lie>) =
            lies.iter().filter(|(stage, _)| scene_of(stage) == name).copied().unzip();
        let mut faults = vec![0; told.len()];
        compare(name, &options(Schedule::Streamed), &told, |i, _, stage, report| {
            faults[i] += if stage.name() == stages[i] { report.faults.len() } else { 0 };
        });
        println!("{name}: {faults:?}");
        for (stage, faults) in stages.iter().zip(faults) {
            assert!(faults > 0, "a lie about {stage} was not found");
        }
    }
}
