//! Renders of scenes with many lights: choosing them by the light tree shows the same as choosing by power, with less noise.

use crate::support::*;
use glam::DVec3;
use qtracer::gpu::stage::Schedule;
use qtracer::guiding::GuideMode;
use qtracer::scene::Material;
use qtracer::transport::roulette::Roulette;
use qtracer::{Image, RenderOptions, Scene};

/// One engine of each class.
const CLASSES: [Engine; 3] = [Engine::Cpu, Engine::Megakernel, Engine::Wavefront(Schedule::Fused)];

fn by(light_tree: bool, levels: u32, options: RenderOptions) -> RenderOptions {
    RenderOptions { light_tree: Some(light_tree), max_bounces: Some(levels), ..options }
}

/// Mean of a channel, and its standard error.
fn mean(image: &Image, c: usize) -> (f64, f64) {
    let n = image.rgb.len() as f64;
    let errors = image.standard_error.as_ref().unwrap();
    let mean = image.rgb.iter().map(|rgb| f64::from(rgb[c])).sum::<f64>() / n;
    (mean, errors.iter().map(|se| f64::from(se[c]).powi(2)).sum::<f64>().sqrt() / n)
}

/// z-score of the difference of the means of those pixels, the largest of the channels.
fn worst_z(a: &Image, b: &Image, counts: &[bool]) -> f64 {
    let only = |image: &Image| {
        let those = |values: &[[f32; 3]]| values.iter().zip(counts).filter(|v| *v.1).map(|v| *v.0).collect();
        let standard_error = image.standard_error.as_deref().map(those);
        Image { rgb: those(&image.rgb), standard_error, ..image.clone() }
    };
    let (a, b) = (only(a), only(b));
    let z = |c| {
        let ((a, error_a), (b, error_b)) = (mean(&a, c), mean(&b, c));
        (a - b).abs() / error_a.hypot(error_b)
    };
    (0..3).map(z).fold(0.0, f64::max)
}

/// Pixels in which no lamp is seen, not even at an edge: the noise of the others is no choice of lights.
fn dim_pixels(scene: &Scene, options: &RenderOptions) -> Vec<bool> {
    let options = RenderOptions { max_bounces: Some(1), ..options.clone() };
    let lamps = render(scene, Engine::Cpu, &options, 64).image;
    lamps.rgb.iter().map(|rgb| *rgb == [0.0; 3]).collect()
}

/// What relMSE one sample a pixel has, from the standard errors: variance / (mean² + 0.01), of the means that `truth` has,
/// without the worst thousandth of the pixels.
fn noise(image: &Image, truth: &Image, samples: u32, counts: &[bool]) -> f64 {
    let errors = image.standard_error.as_ref().unwrap();
    let of = |i: usize| {
        let channel = |c: usize| {
            let (se, mean) = (f64::from(errors[i][c]), f64::from(truth.rgb[i][c]));
            se * se * f64::from(samples) / (mean * mean + 0.01)
        };
        (0..3).map(channel).sum::<f64>() / 3.0
    };
    let mut all: Vec<f64> = (0..counts.len()).filter(|&i| counts[i]).map(of).collect();
    all.sort_by(f64::total_cmp);
    all.truncate(all.len() - all.len() / 1000);
    all.iter().sum::<f64>() / all.len() as f64
}

/// relMSE at equal samples, by power and by the tree, of pixels in which no lamp is seen: of direct light, and of paths of all
/// lengths, part of whose noise is in the directions that they take and not in their lights. Against the means of the tree's own
/// image, and against those of another: its own are too bright where its noise is large, which tells less of it.
#[test]
fn many_lights_have_a_fifth_of_the_noise_by_the_tree() {
    let scene = scene("many-lights");
    let options = small(96, 72, 71);
    let dim = dim_pixels(&scene, &options);
    assert!(dim.iter().filter(|dim| **dim).count() > dim.len() * 3 / 4);
    for (levels, samples, gains) in [(2, 48, [8.5, 8.5]), (64, 32, [5.0, 3.7])] {
        let image = |tree, seed| {
            let options = by(tree, levels, RenderOptions { seed, ..options.clone() });
            render(&scene, Engine::Cpu, &options, samples).image
        };
        let (by_power, by_tree, other) = (image(false, 71), image(true, 71), image(true, 79));
        for (truth, gain) in [&by_tree, &other].into_iter().zip(gains) {
            let [power, tree] = [&by_power, &by_tree].map(|image| noise(image, truth, samples, &dim));
            println!(
                "{levels} levels: relMSE of one sample {power:.3} by power, {tree:.3} by the tree: {:.2}",
                power / tree
            );
            assert!(power / tree > gain, "{levels} levels: {power} by power, {tree} by the tree");
        }
    }
}

/// Means of many-lights, of pixels in which no lamp is seen, within 4.5 standard errors of each other in each channel, α = 2e-5 an engine; and an image that is 8 %
/// brighter is not.
#[test]
fn many_lights_are_as_bright_by_the_tree_as_by_power() {
    let scene = scene("many-lights");
    let by_power = render(&scene, Engine::Cpu, &by(false, 3, small(48, 36, 72)), 256).image;
    let dim = dim_pixels(&scene, &small(48, 36, 72));
    for engine in CLASSES {
        let image = render(&scene, engine, &by(true, 3, small(48, 36, 73)), 32).image;
        let z = worst_z(&image, &by_power, &dim);
        let wrong = worst_z(&brightened(&image, 1.08), &by_power, &dim);
        println!("{engine:?}: z = {z:.2}; 8 % brighter {wrong:.2}");
        assert!(z < 4.5 && wrong > 4.5, "{engine:?}: {z}, {wrong}");
    }
}

/// Every way of running it traces the same paths.
#[test]
fn schedules_agree_in_every_bit_on_many_lights() {
    let scene = scene("many-lights");
    let film = |engine| render(&scene, engine, &small(24, 18, 74), 8).film;
    let first = film(GPU_ENGINES[0]);
    for engine in &GPU_ENGINES[1..] {
        assert_eq!(differing_pixels(&first, &film(*engine)), 0, "{engine:?}");
    }
}

/// Guided paths end on the same image. 4.5 standard errors as above, which 8 % are not within.
#[test]
fn guided_paths_see_many_lights_as_bright() {
    let scene = scene("many-lights");
    let by_power = render(&scene, Engine::Cpu, &by(false, 4, small(32, 24, 75)), 384).image;
    let dim = dim_pixels(&scene, &small(32, 24, 75));
    for engine in [Engine::Cpu, Engine::Wavefront(Schedule::Fused)] {
        let options = crate::guiding_renders::guided(32, 24, 76, GuideMode::Adaptive, Roulette::Off);
        let image = render(&scene, engine, &by(true, 4, options), 126).image;
        let z = worst_z(&image, &by_power, &dim);
        let wrong = worst_z(&brightened(&image, 1.08), &by_power, &dim);
        println!("{engine:?}: z = {z:.2}; 8 % brighter {wrong:.2}");
        assert!(z < 4.5 && wrong > 4.5, "{engine:?}: {z}, {wrong}");
    }
}

/// A grey floor seen at one point, under red lamps of which one is 1e8 times as bright as the green one beside it: closed forms,
/// each within 4 standard errors. None shades another.
#[test]
fn a_light_among_many_of_a_hundred_million_times_its_strength_keeps_its_share() {
    let ball = |i: usize| {
        let angle = std::f64::consts::TAU * i as f64 / 20.0;
        DVec3::new(2.0 * angle.cos(), 1.0 + 0.04 * i as f64, 2.0 * angle.sin())
    };
    let radiance = |i: usize| match i {
        7 => DVec3::new(0.0, 1.0, 0.0),
        13 => DVec3::new(1e8, 0.0, 0.0),
        _ => DVec3::new(1.0, 0.0, 0.0),
    };
    let radius = 0.25;
    let mut builder = Scene::builder("floor")
        .camera([3.0, 3.0, 0.0], [0.0; 3], 1e-3)
        .material("floor", Material::diffuse([0.5; 3]))
        .quad([-2.0, 0.0, -2.0], [0.0, 0.0, 4.0], [4.0, 0.0, 0.0], "floor");
    let mut expected = DVec3::ZERO;
    for i in 0..20 {
        let (name, center) = (format!("lamp {i}"), ball(i));
        builder = builder.material(&name, Material::diffuse([0.0; 3]).emitting(radiance(i)));
        builder = builder.sphere(center, radius, &name);
        let share = radius * radius / center.length_squared() * center.y / center.length();
        expected += 0.5 * radiance(i) * share;
    }
    let scene = builder.build().unwrap();
    for engine in CLASSES {
        let image = render(&scene, engine, &by(true, 2, small(8, 8, 77)), 2048).image;
        for c in 0..2 {
            let (mean, error) = mean(&image, c);
            println!(
                "{engine:?}, channel {c}: {:.1e} off, s.e. {:.1e}",
                mean / expected[c] - 1.0,
                error / expected[c]
            );
            assert!(error < 0.05 * expected[c], "{engine:?}, channel {c}: too few samples");
            let agrees = |mean: f64| (mean - expected[c]).abs() < 4.0 * error + 2e-6 * expected[c];
            assert!(
                agrees(mean) && !agrees(mean * 1.25),
                "{engine:?}, channel {c}: {mean} for {}",
                expected[c]
            );
        }
    }
}

/// Ten thousand triangles of a lamp that is about a ball: the closed form of the ball within its facets, 1 %, and 4 standard
/// errors; and less than a ninth of the variance by power.
#[test]
fn a_lamp_of_ten_thousand_triangles_is_as_bright_as_the_ball() {
    let center = DVec3::new(0.0, 1.5, 0.0);
    let mut mesh = icosphere(5);
    mesh.positions.iter_mut().for_each(|p| *p = 0.5 * *p + center);
    let scene = Scene::builder("mesh lamp")
        .camera([3.0, 3.0, 0.0], [0.0; 3], 1e-3)
        .material("floor", Material::diffuse([0.5; 3]))
        .material("lamp", Material::diffuse([0.0; 3]).emitting([1.0, 2.0, 4.0]))
        .quad([-2.0, 0.0, -2.0], [0.0, 0.0, 4.0], [4.0, 0.0, 0.0], "floor")
        .mesh(mesh, "lamp")
        .build()
        .unwrap();
    let expected = 0.5 * 0.25 / center.length_squared();
    for engine in CLASSES {
        let options = small(8, 8, 78);
        let [power, tree] = [false, true]
            .map(|tree| mean(&render(&scene, engine, &by(tree, 2, options.clone()), 64).image, 0));
        let gain = (power.1 / tree.1).powi(2);
        println!(
            "{engine:?}: {:.1e} off, s.e. {:.1e}; gain {gain:.1}",
            tree.0 / expected - 1.0,
            tree.1 / expected
        );
        assert!(
            (tree.0 - expected).abs() < 4.0 * tree.1 + 0.01 * expected,
            "{engine:?}: {tree:?} for {expected}"
        );
        assert!((power.0 - tree.0).abs() < 4.0 * power.1.hypot(tree.1), "{engine:?}: {power:?} {tree:?}");
        assert!(gain > 9.0, "{engine:?}: {gain}");
    }
}
