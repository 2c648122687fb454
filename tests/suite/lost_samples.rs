//! Nothing infinite and nothing that is no number reaches the film: such samples count as black, and are counted. Tested by
//! putting them in: into the radiance that `resolve` sums, and into scenes behind their validation.

use crate::guiding_renders::guided;
use crate::probe::Numbers;
use crate::support::*;
use bytemuck::{Zeroable, cast_slice};
use glam::{DVec3, Vec3};
use qtracer::film::{BRIGHTEST, BlockSum, is_countable};
use qtracer::gpu::buffers::Buffers;
use qtracer::gpu::device::Gpu;
use qtracer::gpu::key::KernelKey;
use qtracer::gpu::link::link;
use qtracer::gpu::stage::{BLOCK, Schedule, Stage, WORKGROUP};
use qtracer::guiding::GuideMode;
use qtracer::scene::compiled::{CompiledScene, Uniforms};
use qtracer::scene::{Material, MaterialKind};
use qtracer::transport::roulette::Roulette;
use qtracer::{Film, RenderOptions, Scene};
use wgpu::BufferUsages;

/// What can't be counted: quiet, negative and signalling NaN, infinities, squares beyond f32.
const POISONS: [f32; 7] = [
    f32::NAN,
    -f32::NAN,
    f32::from_bits(0x7f80_0001),
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    -BRIGHTEST,
];

/// Sums of a batch of `samples` of each of `pixels` pixels by the kernel itself, and how many samples it says were lost.
fn resolve(gpu: &Gpu, places: u32, pixels: u32, samples: u32, radiance: &[Vec3]) -> (u32, Vec<BlockSum>) {
    let mut how = estimators(GuideMode::Adaptive, Roulette::Learnt);
    how.split = places;
    let key = KernelKey::new(&CompiledScene::new(&scene("cornell-box")), &how);
    assert_eq!(key.places, places);
    let wgsl = link(Stage::Resolve, &key, Schedule::Fused).unwrap();
    let kernel = gpu.kernel("resolve", &wgsl).unwrap();
    let mut buffers = Buffers::default();
    let uniforms = Uniforms {
        pixel_count: pixels,
        sample_count: samples,
        path_count: pixels * samples,
        ..Uniforms::zeroed()
    };
    let sums = pixels * samples.div_ceil(BLOCK);
    let storage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
    let uploads: [(&str, &[u8], _); 3] = [
        ("uniforms", bytemuck::bytes_of(&uniforms), BufferUsages::UNIFORM),
        ("radiance", cast_slice(radiance), storage),
        ("block_sums", &vec![0; 4 + 24 * sums as usize], storage),
    ];
    for (name, bytes, usage) in uploads {
        buffers.upload(gpu, name, bytes, usage).unwrap();
    }
    let bind = kernel.bind(gpu, &buffers, &[]);
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&kernel.pipeline);
        pass.set_bind_group(0, &bind, &[]);
        pass.dispatch_workgroups(sums.div_ceil(WORKGROUP), 1, 1);
    }
    gpu.queue.submit([encoder.finish()]);
    let read = gpu.read(&[(buffers.get("block_sums"), 4 + 24 * u64::from(sums))]).unwrap();
    let (lost, sums) = read[0].split_at(4);
    (bytemuck::pod_read_unaligned(lost), bytemuck::pod_collect_to_vec(sums))
}

/// The same on the host: samples lost, sums and sums of squares per block and pixel.
fn resolved(places: u32, pixels: u32, samples: u32, radiance: &[Vec3]) -> (u32, Vec<[Vec3; 2]>) {
    let mut lost = 0;
    let mut sums = vec![[Vec3::ZERO; 2]; (pixels * samples.div_ceil(BLOCK)) as usize];
    for (path, places) in radiance.chunks(places as usize).enumerate() {
        let (sample, pixel) = (path as u32 / pixels, path as u32 % pixels);
        let value: Vec3 = places[1..].iter().fold(places[0], |sum, place| sum + *place);
        let sum = &mut sums[(sample / BLOCK * pixels + pixel) as usize];
        match is_countable(value) {
            true => *sum = [sum[0] + value, sum[1] + value * value],
            false => lost += 1,
        }
    }
    (lost, sums)
}

/// 300 pixels, two blocks of samples and a part of one; every fiftieth place is poisoned in one channel.
#[test]
fn samples_that_are_no_numbers_are_black_and_counted_where_the_gpu_sums_them() {
    let gpu = open_gpu();
    let (pixels, samples) = (300, 70);
    for places in [1, 4] {
        let mut random = Numbers(5);
        let clean: Vec<Vec3> = (0..pixels * samples * places)
            .map(|_| Vec3::from_array([(); 3].map(|()| random.between(0.0, 4.0) as f32)))
            .collect();
        let mut poisoned = clean.clone();
        for i in (0..poisoned.len()).step_by(50) {
            poisoned[i][random.below(3)] = POISONS[random.below(POISONS.len())];
        }
        for (radiance, any) in [(&clean, false), (&poisoned, true)] {
            let (lost, sums) = resolve(&gpu, places, pixels, samples, radiance);
            let (expected_lost, expected) = resolved(places, pixels, samples, radiance);
            assert_eq!((lost, lost > 0), (expected_lost, any), "{places} places");
            for (i, (sum, [first, second])) in sums.iter().zip(&expected).enumerate() {
                // Drivers may fuse the square into the sum.
                let near =
                    |a: [f32; 3], b: Vec3| (Vec3::from(a) - b).abs().max_element() <= 1e-5 * b.max_element();
                assert!(
                    near(sum.sum, *first) && near(sum.sum_sq, *second),
                    "block {i}: {sum:?} {first} {second}"
                );
            }
        }
        // Negative control: the poison counts where nothing judges it.
        let raw: Vec3 = poisoned.iter().copied().sum();
        assert!(!is_countable(raw));
    }
}

/// A ball of which every ray sees a radiance of 1, before this environment.
fn ball_before(environment: DVec3) -> Scene {
    let mut scene = Scene::builder("ball")
        .camera([0.0, 0.0, 3.0], [0.0; 3], 45.0)
        .environment([1.0; 3])
        .material("ball", Material::diffuse([0.0; 3]).emitting([1.0; 3]))
        .sphere([0.0; 3], 1.0, "ball")
        .build()
        .unwrap();
    scene.environment = environment;
    scene
}

fn is_finite(film: &Film) -> bool {
    let finite = |sums: &[f64; 3]| sums.iter().all(|v| v.is_finite());
    film.pixels().iter().all(|pixel| finite(&pixel.sum) && finite(&pixel.sum_sq))
}

/// Every sample sees the ball, and brings 1, or the environment, and is lost: the number of the lost is known exactly.
#[test]
fn a_render_knows_exactly_how_many_samples_it_lost_on_every_engine() {
    for poison in [DVec3::new(1.0, f64::NAN, 1.0), DVec3::splat(f64::INFINITY), DVec3::new(0.0, 0.0, 1e30)] {
        for engine in ENGINES {
            let found = render_lossy(&ball_before(poison), engine, &small(16, 12, 3), 40);
            assert!(is_finite(&found.film), "{engine:?}, {poison}");
            let hits: f64 = found.film.pixels().iter().map(|pixel| pixel.sum[1]).sum();
            assert_eq!(found.stats.lost_samples + hits as u64, found.stats.paths, "{engine:?}, {poison}");
            assert!(found.stats.lost_samples > 1000 && hits > 1000.0, "{engine:?}, {poison}");
            assert_eq!(found.film.samples(), (40, 40), "the lost are samples all the same");
        }
    }
    // Negative control: nothing is lost of a right scene.
    let found = render_lossy(&ball_before(DVec3::splat(2.0)), Engine::Cpu, &small(16, 12, 3), 40);
    assert_eq!(found.stats.lost_samples, 0);
}

/// A cornell box with a wall whose colour or a lamp whose radiance is no number.
fn spoilt_boxes() -> Vec<(&'static str, Scene)> {
    let clean = scene("cornell-box");
    let spoil = |spoil: &dyn Fn(&mut Material)| {
        let mut scene = clean.clone();
        scene.materials.iter_mut().for_each(spoil);
        scene
    };
    let of_lamp = |value: f64| {
        move |material: &mut Material| {
            if material.is_emissive() {
                material.emission.x = value;
            }
        }
    };
    let of_wall = |material: &mut Material| {
        if let MaterialKind::Diffuse { color } = &mut material.kind
            && color.x < 0.4 * color.y
        {
            color.x = f64::NAN;
        }
    };
    vec![
        ("lamp NaN", spoil(&of_lamp(f64::NAN))),
        ("lamp infinite", spoil(&of_lamp(f64::INFINITY))),
        ("lamp of 1e25", spoil(&of_lamp(1e25))),
        ("wall NaN", spoil(&of_wall)),
    ]
}

/// Each in another way, guided or not, with roulette by throughput or by what was learnt, with paths split or not: films and
/// images are finite, and GPU engines lose the same samples.
#[test]
fn what_is_poisoned_in_a_scene_poisons_no_image() {
    let exact = open_gpu().summary.software;
    let split = RenderOptions { split: Some(4), ..guided(12, 12, 9, GuideMode::Adaptive, Roulette::Learnt) };
    let ways = [
        small(12, 12, 9),
        guided(12, 12, 9, GuideMode::Adaptive, Roulette::Learnt),
        guided(12, 12, 9, GuideMode::Octant, Roulette::Throughput),
        split,
    ];
    for (i, (name, scene)) in spoilt_boxes().iter().enumerate() {
        // The last way splits, which the last schedule cannot.
        let (way, options) = (i, &ways[i]);
        let engines =
            [Engine::Cpu, Engine::Megakernel, Engine::Wavefront(SCHEDULES[(way + 3) % SCHEDULES.len()])];
        let lost = engines.map(|engine| {
            let found = render_lossy(scene, engine, options, 14);
            let image = &found.image;
            let errors = image.standard_error.as_ref().unwrap();
            let finite = image.rgb.iter().chain(errors).flatten().all(|v| v.is_finite());
            assert!(finite && is_finite(&found.film), "{name}, way {way}, {engine:?}");
            assert!(found.stats.lost_samples > 0, "{name}, way {way}, {engine:?}");
            found.stats.lost_samples
        });
        println!("{name}, way {way}: {lost:?} of {} lost", 14 * 144);
        assert!(!exact || lost[1] == lost[2], "{name}, way {way}: {lost:?}");
    }
}

/// With albedo 1e-6 a path brings less than 2^-100 after its sixth surface: it ends there, long before f32 does. The
/// radiance is the closed form's all the same.
#[test]
fn throughput_that_underflows_ends_the_path() {
    let mut scene = scene("furnace-closed-50");
    scene.materials[0].kind = MaterialKind::Diffuse { color: DVec3::splat(1e-6) };
    for engine in ENGINES {
        for roulette in [Roulette::Off, Roulette::Throughput] {
            let options = RenderOptions {
                direct_light: Some(false),
                roulette: Some(roulette),
                max_bounces: Some(64),
                ..small(16, 16, 4)
            };
            let found = render(&scene, engine, &options, 64);
            let worst = found.image.rgb.iter().flatten().map(|v| (v - 1.000_001).abs()).fold(0.0, f32::max);
            // Roulette begins at the fourth surface, where what is left is 1e-18.
            assert!(worst < 5e-7, "{engine:?}, roulette {roulette}: {worst}");
            if roulette == Roulette::Off {
                assert_eq!(found.stats.rays, 6 * found.stats.paths, "{engine:?}");
            }
        }
    }
}

/// Lights whose solid angle is below what f32 can square or divide by: they bring nothing, and spoil nothing.
#[test]
fn lights_too_small_to_see_lose_no_samples() {
    let far = Scene::builder("lights too small to see")
        .camera([0.0, 1.0, 3.0], [0.0; 3], 45.0)
        .environment([0.25; 3])
        .material("floor", Material::diffuse([0.5; 3]))
        .material("lamp", Material::diffuse([0.0; 3]).emitting([1e15; 3]))
        .quad([-4.0, 0.0, -4.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0], "floor")
        .sphere([0.0, 9e8, 0.0], 2e-12, "lamp")
        .quad([1e8, 9e8, 0.0], [2e-12, 0.0, 0.0], [0.0, 0.0, 2e-12], "lamp")
        .build()
        .unwrap();
    for engine in ENGINES {
        for direct_light in [true, false] {
            let options = RenderOptions { direct_light: Some(direct_light), ..small(16, 16, 6) };
            let found = render(&far, engine, &options, 16);
            assert!(is_finite(&found.film), "{engine:?}");
            let worst = found.image.rgb.iter().flatten().fold(0.0f32, |a, v| a.max(*v));
            assert!(worst <= 0.25, "{engine:?}: {worst}");
        }
    }
}
