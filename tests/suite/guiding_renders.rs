//! Guided renders: every engine learns the same table and makes the same image, and what is learnt changes the noise, never
//! the answer, but where Bansal's published rule is asked for.

use crate::engines::mean_z;
use crate::failing_images::expect_agreement;
use crate::furnace::{closed_form, mean_and_relative_error};
use crate::references::{Against, compare, reference};
use crate::support::*;
use qtracer::gpu::stage::Schedule;
use qtracer::guiding::{GuideMode, GuideOptions};
use qtracer::stats::{ZTestOptions, differences, mean_ratio, z_test};
use qtracer::transport::roulette::Roulette;
use qtracer::{Image, RenderOptions};

/// Small renders with this guide and roulette.
pub fn guided(width: u32, height: u32, seed: u32, mode: GuideMode, roulette: Roulette) -> RenderOptions {
    // Renders of tests are short: they believe what they learn at once.
    let guide = GuideOptions { mode, mature_samples: 2, ..Default::default() };
    RenderOptions { guide, roulette: Some(roulette), ..small(width, height, seed) }
}

/// Guides and roulettes, each with a scene: shapes of both kinds, large scenes, all materials, an environment.
const COMBINATIONS: [(GuideMode, Roulette, &str); 7] = [
    (GuideMode::Adaptive, Roulette::Learnt, "cornell-box"),
    (GuideMode::Adaptive, Roulette::Throughput, "door-ajar"),
    (GuideMode::Adaptive, Roulette::Learnt, "furnace-open-half"),
    (GuideMode::Octant, Roulette::Learnt, "bansal-room-1"),
    (GuideMode::Bansal, Roulette::Throughput, "cornell-box"),
    (GuideMode::BansalReweighted, Roulette::Throughput, "cornell-box"),
    (GuideMode::Off, Roulette::Learnt, "cornell-box"),
];

/// 30 samples are five passes, of which the last is cut short: each of the others changes the table. Bit for bit on
/// software adapters, as in engines.rs.
#[test]
fn schedules_and_megakernel_learn_alike() {
    let exact = open_gpu().summary.software;
    for (mode, roulette, name) in COMBINATIONS {
        let options = guided(20, 20, 7, mode, roulette);
        let scene = scene(name);
        let reference = render(&scene, Engine::Megakernel, &options, 30);
        for schedule in SCHEDULES {
            let other = render(&scene, Engine::Wavefront(schedule), &options, 30);
            let what = format!("{mode}, roulette {roulette}, {name}, {schedule:?}");
            if exact {
                assert_eq!(differing_pixels(&reference.film, &other.film), 0, "{what}");
                assert_eq!(reference.image.rgb, other.image.rgb, "{what}");
            } else {
                let close = differences(&other.image.view(), &reference.image.view()).unwrap();
                assert!(close.share_within_1e3 >= 0.95, "{what}: {close:?}");
            }
        }
    }
    // Negative control: with a lesson less, the image is another.
    let scene = scene("cornell-box");
    let options = guided(32, 32, 7, GuideMode::Adaptive, Roulette::Learnt);
    let mut lazy = options.clone();
    lazy.guide.learning_samples = Some(8);
    let [a, b] = [options, lazy].map(|options| render(&scene, Engine::Megakernel, &options, 30).film);
    assert!(differing_pixels(&a, &b) > 500);
}

#[test]
fn the_same_seed_twice_learns_identical_bytes() {
    let scene = scene("cornell-box");
    let options = guided(20, 20, 5, GuideMode::Adaptive, Roulette::Learnt);
    for engine in ENGINES {
        let [a, b] = [(); 2].map(|_| render(&scene, engine, &options, 15));
        assert_eq!(differing_pixels(&a.film, &b.film), 0, "{engine:?}");
        assert_eq!(a.image.rgb, b.image.rgb, "{engine:?}");
    }
}

/// Sums of lessons are whole numbers, so threads may add them in any order; and steps of any length end passes where
/// they end.
#[test]
fn neither_threads_nor_steps_change_what_is_learnt() {
    let scene = scene("bansal-room-1");
    let options = guided(24, 18, 5, GuideMode::Adaptive, Roulette::Learnt);
    let whole = render(&scene, Engine::Cpu, &options, 30);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let other = pool.install(|| render(&scene, Engine::Cpu, &options, 30));
        assert_eq!(differing_pixels(&whole.film, &other.film), 0, "{threads} threads");
        assert_eq!(whole.image.rgb, other.image.rgb, "{threads} threads");
    }
    for engine in [Engine::Cpu, Engine::Wavefront(Schedule::Fused)] {
        let [a, b] =
            [7, u32::MAX].map(|step| render_in_steps(&scene, engine, &options, 30, step).film.mean());
        let largest = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs() / b.max(1e-3));
        assert!(largest.fold(0.0, f32::max) < 1e-5, "{engine:?}");
    }
}

/// Rounding differs between Rust and the driver in the last place, and so do tables; pixels part where a choice falls the
/// other way. The shares are claims, a little below what lavapipe gave.
#[test]
fn cpu_and_gpu_learn_the_same_image() {
    let scene = scene("cornell-box");
    for (mode, claimed) in [(GuideMode::Adaptive, 0.97), (GuideMode::Octant, 0.97), (GuideMode::Bansal, 0.97)]
    {
        let roulette = if mode.is_bansal() { Roulette::Throughput } else { Roulette::Learnt };
        let options = guided(32, 32, 3, mode, roulette);
        let cpu = render(&scene, Engine::Cpu, &options, 30).image;
        let gpu = render(&scene, Engine::Wavefront(Schedule::Fused), &options, 30).image;
        let found = differences(&gpu.view(), &cpu.view()).unwrap();
        println!("{mode}: {:.2} % of pixels within 1e-3", 100.0 * found.share_within_1e3);
        assert!(found.share_within_1e3 >= claimed, "{mode}: {found:?}");
        // Negative control: an image without the guide.
        let unguided = render(&scene, Engine::Cpu, &guided(32, 32, 3, GuideMode::Off, roulette), 30).image;
        let control = differences(&unguided.view(), &gpu.view()).unwrap();
        assert!(control.share_within_1e3 < claimed - 0.2, "{mode}: {control:?}");
    }
}

/// As in references.rs: α = 1e-3 that a right image fails, and an image 2 % brighter must fail.
fn agrees_with_mitsuba(
    file: &'static str,
    name: &'static str,
    guide: GuideMode,
    roulette: Roulette,
    spp: u32,
    seed: u32,
) {
    Against { guide, roulette, ..Against::plain(file, name, spp, seed) }.agrees(0.02);
}

#[test]
fn guided_cornell_box_agrees_with_mitsuba() {
    let agrees =
        |mode, roulette, seed| agrees_with_mitsuba("cornell-box", "cornell", mode, roulette, 2046, seed);
    agrees(GuideMode::Adaptive, Roulette::Learnt, 121);
    agrees(GuideMode::Octant, Roulette::Learnt, 122);
}

#[test]
fn guided_bansal_rooms_agree_with_mitsuba() {
    agrees_with_mitsuba("bansal-room-1", "seed1", GuideMode::Adaptive, Roulette::Learnt, 512, 124);
    agrees_with_mitsuba("bansal-room-5", "seed5", GuideMode::Octant, Roulette::Learnt, 512, 125);
}

#[test]
fn guided_door_ajar_agrees_with_mitsuba() {
    agrees_with_mitsuba("door-ajar", "door", GuideMode::Adaptive, Roulette::Learnt, 3072, 127);
}

#[test]
fn guided_glass_caustic_agrees_with_mitsuba() {
    agrees_with_mitsuba("glass-caustic", "caustic", GuideMode::Adaptive, Roulette::Learnt, 1024, 126);
}

/// Negative control of the tests above: Bansal's rule as published is wrong, and they see it.
#[test]
fn bansals_published_rule_does_not_agree_with_mitsuba() {
    let guide = GuideMode::Bansal;
    let (image, reference) = Against { guide, ..Against::plain("door-ajar", "door", 1024, 128) }.render();
    let ratio = mean_ratio(&image.view(), &reference.view()).unwrap();
    println!("door-ajar, guide bansal: mean ratio {ratio:.4?}");
    assert_eq!(compare(&image, &reference).passes(), Some(false), "{ratio:?}");
}

/// Mean luminance of the whole image over the reference's, and its standard error over 24 seeds: Bansal's weights have so
/// long a tail that single images don't know their error.
fn ratio_over_seeds(file: &str, name: &str, engine: Engine, mode: GuideMode, spp: u32) -> (f64, f64) {
    let green = |rgb: &[[f32; 3]]| rgb.iter().map(|p| f64::from(p[1])).sum::<f64>() / rgb.len() as f64;
    let truth = green(&reference(name).rgb);
    let ratios: Vec<f64> = (500..524)
        .map(|seed| {
            let options = guided(16, 16, seed, mode, Roulette::Throughput);
            let options = RenderOptions { max_bounces: Some(64), ..options };
            green(&render(&scene(file), engine, &options, spp).image.rgb) / truth
        })
        .collect();
    let n = ratios.len() as f64;
    let mean = ratios.iter().sum::<f64>() / n;
    let variance = ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// Divided by its density, Bansal's rule is right on average, within 4 standard errors; as published it is not.
fn bansals_rule_is_right_divided_by_its_density_only(engine: Engine) {
    for (file, name) in [("cornell-box", "cornell"), ("door-ajar", "door")] {
        let (ratio, error) = ratio_over_seeds(file, name, engine, GuideMode::BansalReweighted, 126);
        println!("{file} on {engine:?}: {ratio:.3} ± {error:.3}");
        let right = error < 0.1 && (ratio - 1.0).abs() < 4.0 * error;
        assert!(right, "{file} on {engine:?}, seeds 500 to 523: {ratio} ± {error}");
    }
    let (ratio, error) = ratio_over_seeds("door-ajar", "door", engine, GuideMode::Bansal, 126);
    assert!((ratio - 1.0).abs() > 4.0 * error, "Bansal's published rule passes: {ratio} ± {error}");
}

#[test]
fn bansals_rule_divided_by_its_density_is_right_on_average() {
    bansals_rule_is_right_divided_by_its_density_only(Engine::Cpu);
}

#[test]
#[ignore = "long: 72 renders on each of two GPU engines; tests/run --long"]
fn bansals_rule_divided_by_its_density_is_right_on_average_on_gpu_engines() {
    for engine in [Engine::Megakernel, Engine::Wavefront(Schedule::Fused)] {
        bansals_rule_is_right_divided_by_its_density_only(engine);
    }
}

/// The unbiased guides with either roulette, on all five scenes, at four times the samples.
#[test]
#[ignore = "long: 20 renders of up to 12,288 samples on the CPU; tests/run --long"]
fn guides_agree_with_mitsuba_under_either_roulette() {
    let scenes = [
        ("cornell-box", "cornell", 4096),
        ("bansal-room-1", "seed1", 2048),
        ("bansal-room-5", "seed5", 2048),
        ("door-ajar", "door", 12_288),
        ("glass-caustic", "caustic", 4096),
    ];
    for (file, name, spp) in scenes {
        for mode in [GuideMode::Adaptive, GuideMode::Octant] {
            for roulette in [Roulette::Throughput, Roulette::Learnt] {
                agrees_with_mitsuba(file, name, mode, roulette, spp, 300);
            }
        }
    }
}

/// Learning against none, with the errors that the images themselves tell: α = 6.3e-5 for each mean of a channel, 1e-3 for
/// the blocks of each image.
#[test]
fn guided_and_unguided_renders_agree() {
    let scene = scene("cornell-box");
    let options = ZTestOptions { alpha: 1e-3, ..Default::default() };
    let image =
        |mode, roulette, seed| render(&scene, Engine::Cpu, &guided(32, 32, seed, mode, roulette), 510).image;
    let plain = image(GuideMode::Off, Roulette::Off, 40);
    let agrees = |other: &Image| {
        mean_z(&plain, other) < 4.0 && z_test(&plain.view(), &other.view(), &options).unwrap().passes
    };
    let combinations = [
        (GuideMode::Adaptive, Roulette::Off),
        (GuideMode::Adaptive, Roulette::Learnt),
        (GuideMode::Octant, Roulette::Learnt),
        (GuideMode::Off, Roulette::Learnt),
    ];
    for ((mode, roulette), seed) in combinations.into_iter().zip(41..) {
        let other = image(mode, roulette, seed);
        let what = format!("cornell-box, guide {mode}, roulette {roulette}, and none");
        expect_agreement(agrees(&other), &what, seed, (&other, &plain), mean_z(&plain, &other));
        assert!(!agrees(&brightened(&other, 1.04)), "{mode}, roulette {roulette}: 4 % brighter agrees");
    }
}

/// Light comes from everywhere alike, so that every factor of the estimator is weighed: within 4 standard errors of the
/// closed form, α = 6.3e-5 each.
#[test]
fn closed_furnaces_keep_their_radiance_when_guided() {
    let expected = closed_form(0.5, 64);
    let all = [
        (Engine::Cpu, GuideMode::Adaptive, Roulette::Learnt, 1022),
        (Engine::Cpu, GuideMode::Octant, Roulette::Learnt, 1022),
        (Engine::Wavefront(Schedule::Fused), GuideMode::Adaptive, Roulette::Learnt, 254),
        (Engine::Wavefront(Schedule::Compacted), GuideMode::Adaptive, Roulette::Off, 254),
        (Engine::Megakernel, GuideMode::Off, Roulette::Learnt, 254),
    ];
    for (engine, mode, roulette, spp) in all {
        let options = RenderOptions { direct_light: Some(false), ..guided(16, 16, 78, mode, roulette) };
        let image = render(&scene("furnace-closed-50"), engine, &options, spp).image;
        let (mean, error) = mean_and_relative_error(&image);
        let deviation = mean / expected - 1.0;
        println!("{mode} on {engine:?}: {deviation:.1e} off, s.e. {error:.1e}");
        assert!(error < 1e-2, "{mode} on {engine:?}: too few samples, s.e. {error}");
        assert!(deviation.abs() < 4.0 * error, "{mode} on {engine:?}: {deviation} off, s.e. {error}");
    }
    // Negative control: a light two hundredths brighter.
    let options = RenderOptions {
        direct_light: Some(false),
        ..guided(16, 16, 78, GuideMode::Adaptive, Roulette::Learnt)
    };
    let image = render(&scene("furnace-closed-50"), Engine::Cpu, &options, 1022).image;
    let (mean, error) = mean_and_relative_error(&brightened(&image, 1.02));
    assert!((mean / expected - 1.0).abs() > 4.0 * error, "{mean} {error}");
}

/// A guided image, and the cell that each pixel sees, through mirrors and glass too.
fn with_cells(scene: &qtracer::Scene, options: &RenderOptions, spp: u32) -> (Image, Vec<f32>) {
    let mut renderer = qtracer::Renderer::new(scene, Engine::Cpu.with(options)).unwrap();
    while renderer.samples() < spp {
        renderer.step(spp - renderer.samples()).unwrap();
    }
    (renderer.image(), renderer.guide_layers().unwrap().cell)
}

/// The largest |z| of the difference summed over the pixels of a cell, and how many cells with at least 12 there are.
fn worst_cell(a: &Image, b: &Image, cells: &[f32]) -> (f64, usize) {
    let mut sums = std::collections::BTreeMap::<i64, (f64, f64, u32)>::new();
    let errors = |image: &Image, i: usize| image.standard_error.as_ref().unwrap()[i];
    for (i, cell) in cells.iter().enumerate().filter(|(_, cell)| **cell >= 0.0) {
        let (difference, variance, pixels) = sums.entry(*cell as i64).or_default();
        let (ea, eb) = (errors(a, i), errors(b, i));
        *difference += f64::from(a.rgb[i][1]) - f64::from(b.rgb[i][1]);
        *variance += f64::from(ea[1]).powi(2) + f64::from(eb[1]).powi(2);
        *pixels += 1;
    }
    let z = sums.values().filter(|(_, _, pixels)| *pixels >= 12).map(|(d, v, _)| d.abs() / v.sqrt());
    let (all, worst) = z.fold((0, 0.0f64), |(n, worst), z| (n + 1, worst.max(z)));
    (worst, all)
}

/// Guided minus unguided over the pixels that see the same cell: none is brighter or darker than noise explains, on walls,
/// behind glass and in mirrors. Some 80 cells, each seen by enough pixels for their sum to be nearly normal: |z| < 4.5,
/// α = 5e-4. Few levels, since rare long paths make tails that no standard error tells of.
#[test]
fn no_cell_shows_in_the_image() {
    for (name, bounces) in [("bansal-room-1", 4), ("door-ajar", 12)] {
        let scene = scene(name);
        let short = |options: RenderOptions| RenderOptions { max_bounces: Some(bounces), ..options };
        let options = short(guided(64, 48, 91, GuideMode::Adaptive, Roulette::Off));
        let (image, cells) = with_cells(&scene, &options, 384);
        let plain = short(guided(64, 48, 92, GuideMode::Off, Roulette::Off));
        let plain = render(&scene, Engine::Cpu, &plain, 512).image;
        let (worst, count) = worst_cell(&image, &plain, &cells);
        println!("{name}: worst of {count} cells {worst:.2}");
        assert!(count > 20 && worst < 4.5, "{name}: worst of {count} cells {worst}");
        // Negative control: half as much light again in the cell that most pixels see.
        let seen = |wanted: f32| cells.iter().filter(|cell| **cell == wanted).count();
        let widest = cells.iter().copied().filter(|c| *c >= 0.0).max_by_key(|c| seen(*c)).unwrap();
        let mut lit = image.clone();
        for (rgb, _) in lit.rgb.iter_mut().zip(&cells).filter(|(_, cell)| **cell == widest) {
            *rgb = rgb.map(|v| 1.5 * v);
        }
        assert!(worst_cell(&lit, &plain, &cells).0 > 4.5, "{name}");
    }
}

/// What cells have learnt from few samples decides nothing: paths end as by throughput, to the bit.
#[test]
fn young_tables_do_not_end_paths() {
    let scene = scene("cornell-box");
    let image = |roulette, mature_samples| {
        let mut options = guided(20, 20, 5, GuideMode::Adaptive, roulette);
        options.roulette_scale = Some(2.5);
        options.guide.mature_samples = mature_samples;
        render(&scene, Engine::Cpu, &options, 24).image.rgb
    };
    assert_eq!(image(Roulette::Learnt, 64), image(Roulette::Throughput, 64));
    assert_ne!(image(Roulette::Learnt, 2), image(Roulette::Throughput, 2));
}
