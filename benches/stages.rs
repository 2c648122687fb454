//! How long does each stage take per item? A level of the wavefront engine is recorded: its queues are held as they are before
//! a stage, and the stage is run on them again and again, timed by the GPU's own clock (on lavapipe too, if it has one; else by
//! the host's). Criterion prints items a second (`thrpt`); the line behind each benchmark says nanoseconds per item.
//!
//! `cargo bench --bench stages` or, for one scene, stage or schedule, `cargo bench --bench stages -- bansal-room-1/streamed`.
//! QTRACER_STAGES_LEVEL is the level (6: the pool holds rays of all bounces up to there), QTRACER_STAGES_SIZE the image, such
//! as 640x480 on a GPU.

#[path = "support/engines.rs"]
#[allow(dead_code)]
mod engines;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use engines::Way;
use qtracer::engine::{RecordedLevel, RecordedStage};
use qtracer::guiding::GuideMode;
use qtracer::{RenderError, RenderOptions, Scene};
use std::cell::RefCell;
use std::time::Duration;

/// Scene, schedule, whether it guides.
const CASES: [(&str, &str, bool); 8] = [
    ("cornell-box", "fused", false),
    ("cornell-box", "streamed", false),
    ("cornell-box", "compacted", false),
    ("bansal-room-1", "fused", false),
    ("bansal-room-1", "sorted", false),
    ("bansal-room-1", "streamed", false),
    ("bansal-room-1", "compacted", false),
    ("door-ajar", "streamed", true),
];

fn stages(c: &mut Criterion) {
    for (name, schedule, guided) in CASES {
        if let Err(error) = case(c, name, schedule, guided) {
            eprintln!("{name}/{schedule}: {error}");
        }
    }
}

/// A number from the environment.
fn setting(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|value| !value.is_empty())
}

fn size() -> (u32, u32) {
    let text = setting("QTRACER_STAGES_SIZE").unwrap_or_else(|| "160x120".to_string());
    let parsed = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    parsed.unwrap_or_else(|| {
        eprintln!("error: QTRACER_STAGES_SIZE={text}: write it as 640x480");
        std::process::exit(2);
    })
}

fn case(c: &mut Criterion, name: &str, schedule: &str, guided: bool) -> Result<(), RenderError> {
    let scene = Scene::load(format!("scenes/{name}.toml")).expect("a shipped scene loads");
    let mut options = RenderOptions { size: Some(size()), direct_light: Some(true), ..Default::default() };
    Way::named(schedule).expect("a schedule").apply(&mut options);
    if guided {
        options.guide.mode = GuideMode::Adaptive;
    }
    let level = setting("QTRACER_STAGES_LEVEL").and_then(|level| level.parse().ok()).unwrap_or(6);
    let mut recorded = RecordedLevel::record(&scene, &options, level)?;
    let clock = if recorded.has_clock() { "its own clock" } else { "the host's clock" };
    eprintln!("\n{name}, {schedule}, level {level}: {} by {clock}", recorded.device());
    let guide = if guided { "-adaptive" } else { "" };
    let mut group = c.benchmark_group(format!("{name}/{schedule}{guide}"));
    group.sample_size(10).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    while let Some(RecordedStage { name: stage, items, .. }) = recorded.stage() {
        let seconds = RefCell::new(Vec::new());
        group.throughput(Throughput::Elements(items.max(1)));
        group.bench_function(BenchmarkId::from_parameter(&stage), |b| {
            b.iter_custom(|count| {
                let times: Vec<f64> = (0..count).map(|_| recorded.run().expect("the stage runs")).collect();
                let total = times.iter().sum();
                seconds.borrow_mut().extend(times);
                Duration::from_secs_f64(total)
            });
        });
        report(&stage, items, &mut seconds.borrow_mut());
        recorded.advance()?;
    }
    group.finish();
    Ok(())
}

/// Median and quartiles of the time per item; nothing for a stage that was not selected.
fn report(stage: &str, items: u64, seconds: &mut [f64]) {
    seconds.sort_by(f64::total_cmp);
    if seconds.is_empty() {
        return;
    }
    let at = |share: f64| 1e9 * seconds[(share * (seconds.len() - 1) as f64) as usize];
    let each = |share: f64| at(share) / items as f64;
    let (least, median, most) = (each(0.25), each(0.5), each(0.75));
    match items {
        0 => println!("{stage}: no items at this level, {:.1} µs", at(0.5) / 1e3),
        _ => println!(
            "{stage}: {median:.3} ns per item ({least:.3}-{most:.3} between quartiles), {items} items, {:.1} µs",
            at(0.5) / 1e3
        ),
    }
}

criterion_group!(benches, stages);
criterion_main!(benches);
