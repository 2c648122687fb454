//! Splitting: copies of a path share its weight and its places for radiance; every engine makes the same ones; they change
//! the noise and the work, never the answer.

use crate::engines::mean_z;
use crate::furnace::{closed_form, mean_and_relative_error};
use crate::guiding_renders::guided;
use crate::support::*;
use qtracer::accel::Search;
use qtracer::gpu::stage::Schedule;
use qtracer::guiding::{GuideMode, LessonLayout, LessonSums, Trail};
use qtracer::scene::compiled::{CompiledScene, Uniforms};
use qtracer::stats::{ZTestOptions, differences, z_test};
use qtracer::transport::guide::Guidance;
use qtracer::transport::items::RayItem;
use qtracer::transport::path::Transport;
use qtracer::transport::roulette::Roulette;
use qtracer::transport::split::{bounce_of, budget_of};
use qtracer::{Image, RenderOptions, Renderer};

/// Small renders with learnt roulette that makes up to `split` copies of a path, `scale` times as many as it would.
fn splitting(mode: GuideMode, split: u32, scale: f32, seed: u32) -> RenderOptions {
    let options = guided(20, 20, seed, mode, Roulette::Learnt);
    RenderOptions { split: Some(split), roulette_scale: Some(scale), ..options }
}

/// Guides, splits and scales, each with a scene: shapes of both kinds, a large scene, all materials, an environment.
const SPLITS: [(GuideMode, u32, f32, &str); 4] = [
    (GuideMode::Adaptive, 8, 2.5, "bansal-room-1"),
    (GuideMode::Adaptive, 2, 5.0, "door-ajar"),
    (GuideMode::Octant, 3, 2.5, "furnace-open-half"),
    (GuideMode::Off, 4, 20.0, "cornell-box"),
];

/// Guides, splits and scales for `cornell-box`.
const CORNELL: [(GuideMode, u32, f32); 3] =
    [(GuideMode::Adaptive, 8, 2.5), (GuideMode::Octant, 3, 2.5), (GuideMode::Off, 4, 20.0)];

/// Bit for bit on software adapters, rays too; a queue of 256 slots, which is full all the time, never runs over.
#[test]
fn schedules_and_megakernel_split_alike() {
    let exact = open_gpu().summary.software;
    for (mode, split, scale, name) in SPLITS {
        let options = splitting(mode, split, scale, 7);
        let scene = scene(name);
        let reference = render(&scene, Engine::Megakernel, &options, 30);
        for (schedule, pool) in SPLITTING_SCHEDULES.into_iter().flat_map(|s| [(s, None), (s, Some(256))]) {
            let options = RenderOptions { pool, ..options.clone() };
            let other = render(&scene, Engine::Wavefront(schedule), &options, 30);
            let what = format!("{mode}, split {split}, {name}, {schedule:?}, pool {pool:?}");
            if exact {
                assert_eq!(differing_pixels(&reference.film, &other.film), 0, "{what}");
                assert_eq!(reference.image.rgb, other.image.rgb, "{what}");
                assert_eq!(reference.stats.rays, other.stats.rays, "{what}");
            } else {
                let close = differences(&other.image.view(), &reference.image.view()).unwrap();
                assert!(close.share_within_1e3 >= 0.95, "{what}: {close:?}");
            }
        }
        // Without splitting it is another image, with fewer rays.
        let whole = render(&scene, Engine::Megakernel, &RenderOptions { split: None, ..options.clone() }, 30);
        let (differing, more_rays) = (
            differing_pixels(&reference.film, &whole.film),
            reference.stats.rays as f64 / whole.stats.rays as f64,
        );
        println!("{name}: {differing} pixels differ, {more_rays:.3} times the rays");
        assert!(differing > 100 && more_rays > 1.05, "{name}");
    }
}

/// Levels of a path at once, or paths of an invocation, change neither the image nor the rays that are counted, wherever a
/// path splits among them.
#[test]
fn the_grain_does_not_change_what_splits() {
    let scene = scene("bansal-room-1");
    let options = splitting(GuideMode::Adaptive, 8, 2.5, 11);
    for engine in [Engine::Wavefront(Schedule::Fused), Engine::Megakernel] {
        let [one, three, many] = [1, 3, 16].map(|grain| {
            let options = RenderOptions { grain: Some(grain), max_bounces: Some(10), ..options.clone() };
            render(&scene, engine, &options, 30)
        });
        for other in [&three, &many] {
            assert_eq!(differing_pixels(&one.film, &other.film), 0, "{engine:?}");
            assert_eq!(one.stats.rays, other.stats.rays, "{engine:?}");
        }
        let fewer = three.stats.iterations < one.stats.iterations;
        assert_eq!(fewer, engine != Engine::Megakernel, "levels at once take fewer turns");
    }
}

#[test]
fn cpu_and_gpu_split_alike() {
    let scene = scene("cornell-box");
    for (mode, split, scale) in CORNELL {
        let [options, whole] = [split, 1].map(|split| splitting(mode, split, scale, 3));
        let cpu = render(&scene, Engine::Cpu, &options, 30);
        let gpu = render(&scene, Engine::Wavefront(Schedule::Fused), &options, 30);
        let found = differences(&gpu.image.view(), &cpu.image.view()).unwrap();
        let more_rays = gpu.stats.rays as f64 / cpu.stats.rays as f64;
        println!(
            "{mode}: {:.2} % of pixels alike, {more_rays:.5} times the rays",
            100.0 * found.share_within_1e3
        );
        assert!(found.share_within_1e3 >= 0.97 && (more_rays - 1.0).abs() < 2e-3, "{mode}: {found:?}");
        // All copies of a path are one sample, so the errors are alike as well.
        let [a, b] = [&gpu, &cpu].map(|render| render.film.standard_error());
        let alike = a.iter().zip(&b).filter(|(a, b)| (a[1] - b[1]).abs() <= 1e-3 * b[1]).count();
        assert!(alike >= 388, "{mode}: {alike} errors of 400 are alike");
        // Negative control: an image without splitting.
        let whole = render(&scene, Engine::Cpu, &whole, 30).image;
        let control = differences(&whole.view(), &gpu.image.view()).unwrap();
        assert!(control.share_within_1e3 < 0.7, "{mode}: {control:?}");
    }
}

#[test]
fn split_paths_are_the_same_in_any_order() {
    let scene = scene("bansal-room-1");
    let options = splitting(GuideMode::Adaptive, 4, 2.5, 5);
    let whole = render(&scene, Engine::Cpu, &options, 30);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let other = pool.install(|| render(&scene, Engine::Cpu, &options, 30));
    assert_eq!(differing_pixels(&whole.film, &other.film), 0);
    let engines = SPLITTING_SCHEDULES.map(Engine::Wavefront).into_iter().chain([Engine::Megakernel]);
    for engine in engines {
        let [a, b] = [(); 2].map(|_| render(&scene, engine, &options, 15));
        assert_eq!(differing_pixels(&a.film, &b.film), 0, "{engine:?}");
        assert_eq!(a.image.rgb, b.image.rgb, "{engine:?}");
    }
}

/// Against no learning and no roulette, with the errors that the images themselves tell: α = 6.3e-5 for each mean of a
/// channel, 1e-3 for the blocks of each image.
#[test]
fn split_and_whole_paths_agree() {
    let scene = scene("cornell-box");
    let image = |options: RenderOptions| {
        let options = RenderOptions { size: Some((32, 32)), ..options };
        render(&scene, Engine::Cpu, &options, 510).image
    };
    let plain = image(guided(32, 32, 40, GuideMode::Off, Roulette::Off));
    let agrees = |other: &Image| {
        let options = ZTestOptions { alpha: 1e-3, ..Default::default() };
        mean_z(&plain, other) < 4.0 && z_test(&plain.view(), &other.view(), &options).unwrap().passes
    };
    for ((mode, split, scale), seed) in CORNELL.into_iter().zip(51..) {
        let other = image(splitting(mode, split, scale, seed));
        println!("{mode}, split {split}: {:.2} s.e.", mean_z(&plain, &other));
        assert!(agrees(&other), "{mode}, split {split}: {} s.e.", mean_z(&plain, &other));
        assert!(!agrees(&brightened(&other, 1.04)), "{mode}, split {split}: 4 % brighter agrees");
    }
}

/// Light comes from everywhere alike: within 4 standard errors of the closed form, α = 6.3e-5 each.
#[test]
fn closed_furnaces_keep_their_radiance_when_paths_split() {
    let expected = closed_form(0.5, 64);
    for (engine, mode, split, spp) in [
        (Engine::Cpu, GuideMode::Adaptive, 8, 254),
        (Engine::Cpu, GuideMode::Octant, 3, 254),
        (Engine::Wavefront(Schedule::Compacted), GuideMode::Adaptive, 4, 126),
        (Engine::Megakernel, GuideMode::Off, 2, 126),
    ] {
        let options = splitting(mode, split, 4.0, 78);
        let options = RenderOptions { direct_light: Some(false), ..options };
        let image = render(&scene("furnace-closed-50"), engine, &options, spp).image;
        let z = |image: &Image| {
            let (mean, error) = mean_and_relative_error(image);
            assert!(error < 4e-3, "{mode} on {engine:?}: too few samples, s.e. {error}");
            (mean / expected - 1.0) / error
        };
        println!("{mode}, split {split} on {engine:?}: {:.1} s.e. off", z(&image));
        assert!(z(&image).abs() < 4.0, "{mode}, split {split} on {engine:?}: {} s.e. off", z(&image));
        assert!(z(&brightened(&image, 1.03)).abs() > 4.0, "{mode} on {engine:?}: 3 % brighter passes");
    }
}

/// Mean of what the surfaces behind the pixels have learnt to receive in so many samples, all of which teach.
fn mean_illumination(name: &str, options: &RenderOptions, spp: u32) -> f64 {
    let mut options = options.clone();
    options.guide.learning_samples = Some(spp);
    let mut renderer = Renderer::new(&scene(name), Engine::Cpu.with(&options)).unwrap();
    while renderer.samples() < spp {
        renderer.step(spp - renderer.samples()).unwrap();
    }
    let learnt = renderer.guide_layers().unwrap().illumination;
    learnt.iter().map(|v| f64::from(*v)).sum::<f64>() / learnt.len() as f64
}

/// A visit is counted once for all copies, and each teaches its share. Within what seeds scatter by: 1 % here. After seven passes: split
/// paths teach more, so with few their tables are further on (octants, 5 passes: 1.6 %).
#[test]
fn split_paths_teach_what_whole_ones_do() {
    for mode in [GuideMode::Adaptive, GuideMode::Octant] {
        for (name, tolerance) in [("furnace-closed-50", 0.02), ("cornell-box", 0.05)] {
            let [whole, split] =
                [1, 8].map(|split| mean_illumination(name, &splitting(mode, split, 4.0, 60), 256));
            println!("{mode}, {name}: {:.4}", split / whole);
            assert!((split / whole - 1.0).abs() < tolerance, "{mode}, {name}: {split} for {whole}");
        }
    }
}

/// Every ray that `ray` leads to, one level after the other, with the rays that left each surface together.
fn follow(transport: &Transport, ray: RayItem, trail: Trail, seen: &mut impl FnMut(&RayItem, &[RayItem])) {
    let outcome = transport.step(&ray, &trail);
    let first = outcome.ray.map(|ray| (ray, outcome.trail));
    let copies = outcome.split.iter().flat_map(|split| (1..split.copies).map(move |copy| (split, copy)));
    let others = copies.filter_map(|(split, copy)| transport.copy_of(split, copy));
    let next: Vec<(RayItem, Trail)> = first.into_iter().chain(others).collect();
    seen(&ray, &next.iter().map(|(ray, _)| *ray).collect::<Vec<_>>());
    next.into_iter().for_each(|(ray, trail)| follow(transport, ray, trail, seen));
}

/// Copies leave in directions of their own, with places that were their path's and are no other's.
#[test]
fn copies_of_a_path_share_its_places_and_choose_for_themselves() {
    let scene = scene("cornell-box");
    let mut renderer =
        Renderer::new(&scene, Engine::Cpu.with(&splitting(GuideMode::Adaptive, 1, 2.5, 1))).unwrap();
    while renderer.samples() < 14 {
        renderer.step(14 - renderer.samples()).unwrap();
    }
    let table = renderer.learner().unwrap().clone().table(true, &[0.02; 400]);
    let sums = LessonSums::new(LessonLayout::new(&table.uniforms));
    let compiled = CompiledScene::new(&scene);
    let search = Search::new(&compiled);
    let uniforms = compiled.uniforms(&scene.camera, 20, 20, 1);
    let uniforms = Uniforms { pixel_count: 400, max_bounces: 64, roulette_scale: 2.5, ..uniforms };
    for places in [2, 5, 8] {
        let guidance = Some(Guidance { mode: GuideMode::Adaptive, table: &table, sums: &sums });
        let plain = Transport::plain(&compiled, &search, &uniforms);
        let transport = Transport { places, roulette: Roulette::Learnt, guidance, ..plain };
        let mut most = 0;
        for path in 0..400 {
            let camera_ray = transport.generate(path);
            assert_eq!((camera_ray.path, budget_of(&camera_ray)), (places * path, places));
            follow(&transport, camera_ray, Trail::default(), &mut |ray, next| {
                let mut free = ray.path;
                for (i, copy) in next.iter().enumerate() {
                    assert!(copy.path >= free && bounce_of(copy) == bounce_of(ray) + 1, "{ray:?} {next:?}");
                    free = copy.path + budget_of(copy);
                    assert!(next[..i].iter().all(|other| other.direction != copy.direction), "{next:?}");
                }
                assert!(free <= ray.path + budget_of(ray), "{ray:?} {next:?}");
                most = most.max(next.len() as u32);
            });
        }
        assert_eq!(most, places, "no path was split that far");
    }
}
