//! Which engine is faster, per scene? Criterion over whole small renders; runs on lavapipe and on a GPU alike, with the
//! wall time that a caller sees. `engine_times` has the GPU's own clock and larger work, `stages` the time of each stage.
//!
//! `cargo bench --bench engines` or, for one scene, `cargo bench --bench engines -- cornell`

#[path = "support/engines.rs"]
mod ways;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use qtracer::{RenderOptions, Renderer, Scene};
use std::time::Duration;
use ways::Way;

const SIZE: (u32, u32) = (128, 96);
const SPP: u32 = 32;

fn engines(c: &mut Criterion) {
    let ways = ["cpu", "mega", "fused", "streamed", "compacted"];
    for name in ["cornell-box", "bansal-room-1", "glass-caustic", "door-ajar"] {
        let scene = Scene::load(format!("scenes/{name}.toml")).expect("a shipped scene loads");
        let mut group = c.benchmark_group(name);
        group.throughput(Throughput::Elements(u64::from(SIZE.0 * SIZE.1 * SPP)));
        group.sample_size(10).measurement_time(Duration::from_secs(4));
        for way in ways {
            let mut options = RenderOptions { size: Some(SIZE), ..Default::default() };
            Way::named(way).expect("a way").apply(&mut options);
            let mut renderer = match Renderer::new(&scene, options) {
                Ok(renderer) => renderer,
                Err(error) => {
                    eprintln!("{name}/{way}: {error}");
                    continue;
                }
            };
            group.bench_function(BenchmarkId::from_parameter(way), |b| {
                b.iter(|| {
                    let mut left = SPP;
                    while left > 0 {
                        left -= renderer.step(left).expect("it rendered before");
                    }
                });
            });
        }
        group.finish();
    }
}

criterion_group!(benches, engines);
criterion_main!(benches);
