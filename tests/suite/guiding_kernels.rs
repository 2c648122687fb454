//! The guide's kernels against their twins in Rust, evaluated at arrays of points and directions on the adapter under test.

use crate::guiding_maths::{anything, cases, finite, normal, share_error, vector};
use crate::probe::{Probe, row};
use crate::samplers::{ALPHA, Cells, WRONG};
use crate::support::{estimators, open_gpu, scene};
use crate::tables::*;
use glam::Vec3;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use qtracer::Sampler;
use qtracer::accel::Search;
use qtracer::gpu::device::Gpu;
use qtracer::gpu::key::KernelKey;
use qtracer::guiding::octant::{octant_of, octant_shares, octant_wholes};
use qtracer::guiding::quadtree::{MAX_DEPTH, octant_coordinates};
use qtracer::guiding::table::{CellPlace, NO_CELL, adaptive, octants};
use qtracer::guiding::{GuideMode, GuideTable, LessonLayout, LessonSums};
use qtracer::sampling::pdf_cosine;
use qtracer::scene::compiled::{CompiledScene, KIND_DIFFUSE, Material, Uniforms};
use qtracer::scene::shapes::Surface;
use qtracer::transport::estimators::Estimators;
use qtracer::transport::guide::{Guidance, LEAST_SEEN};
use qtracer::transport::path::Transport;
use qtracer::transport::roulette::Roulette;
use wgpu::BufferUsages;

/// Two rows of words: a question to a kernel.
type Question = [[u32; 4]; 2];

fn question(a: Vec3, word: u32, b: Vec3) -> Question {
    [row(a, word), row(b, 0)]
}

/// Answers of a kernel of these imports and this body on a table.
fn ask(
    gpu: &Gpu,
    mode: GuideMode,
    (imports, body): (&str, &str),
    table: &GuideTable,
    questions: &[Question],
) -> Vec<[u32; 4]> {
    let estimators = Estimators { sampler: Sampler::Independent, ..estimators(mode, Roulette::Throughput) };
    let key = KernelKey::new(&CompiledScene::new(&scene("cornell-box")), &estimators);
    let inputs = [
        ("guide_rows", bytemuck::cast_slice(&table.rows), BufferUsages::STORAGE),
        ("guide", bytemuck::bytes_of(&table.uniforms), BufferUsages::STORAGE),
    ];
    Probe::<2, 1>::new(gpu, &key, imports, body).ask(gpu, &inputs, questions).into_iter().flatten().collect()
}

/// The first `count` values of a strategy, the same in every run.
fn drawn<S: Strategy>(strategy: S, count: usize) -> Vec<S::Value> {
    let mut runner = TestRunner::new(cases(1));
    (0..count).map(|_| strategy.new_tree(&mut runner).unwrap().current()).collect()
}

/// Kernels may read subnormal numbers as zeros.
fn flushed(v: Vec3) -> Vec3 {
    Vec3::from(v.to_array().map(|x| if x.is_subnormal() { 0.0f32.copysign(x) } else { x }))
}

const PLACE: &str = "
    let normal = bitcast<vec3<f32>>(b.xyz);
    let place = place_in_table(bitcast<vec3<f32>>(a.xyz), normal);
    out0 = vec4<u32>(place.cell, place.base, place.eighth, octant_of(normal));";

/// The answer to [`PLACE`] in Rust.
fn place_and_octant(table: &GuideTable, position: Vec3, normal: Vec3) -> [u32; 4] {
    let CellPlace { cell, base, eighth, .. } = table.place(position, normal);
    [cell, base, eighth, octant_of(normal)]
}

/// Cells and octants are the same on both sides, bit for bit, for points anywhere and directions of any signs.
#[test]
fn points_have_the_same_cell_on_the_gpu() {
    let gpu = open_gpu();
    let kernel = (
        "import package::guiding::octant::octant_of;\nimport package::guiding::table::place_in_table;",
        PLACE,
    );
    for mode in [GuideMode::Adaptive, GuideMode::Octant] {
        let table = learnt(mode, 1).table;
        let mut points = drawn((vector(anything()), vector(anything())), 20_000);
        points.extend(drawn((vector(finite()), normal()), 20_000));
        points.extend((0..40_000).map(|i| (surface_point(5, i).0, uniform_direction(6, i))));
        let questions: Vec<Question> = points.iter().map(|(p, n)| question(*p, 0, *n)).collect();
        let answers = ask(&gpu, mode, kernel, &table, &questions);
        let (mut same, mut different) = (0, Vec::new());
        for (&(position, normal), answer) in points.iter().zip(&answers) {
            let [cell, base, eighth, octant] = *answer;
            let in_range = (cell == NO_CELL || cell < table.uniforms.cell_count)
                && base < table.uniforms.base_words()
                && eighth < 8
                && octant < 8;
            assert!(in_range, "{mode}: {position} {normal}: {answer:?}");
            // Beyond that sums overflow, and kernels may take it that they do not.
            if position.abs().max_element() > 1e30
                || normal.abs().max_element() > 1e30
                || !(position + normal).is_finite()
            {
                continue;
            }
            let expected = [(position, normal), (flushed(position), flushed(normal))];
            if expected.iter().any(|(p, n)| place_and_octant(&table, *p, *n) == *answer) {
                same += 1;
            } else {
                different.push((position, normal, *answer, place_and_octant(&table, position, normal)));
            }
        }
        assert!(same > 50_000, "{mode}: {same}");
        // Drivers of GPUs may fuse a product into a sum, which moves points across edges that they touch.
        let allowed = if gpu.summary.software { 0 } else { same / 200 };
        assert!(different.len() <= allowed, "{mode}: {} differ: {:?}", different.len(), &different[..1]);
        // Negative control: the same points a thousandth of the box further.
        let moved =
            points.iter().zip(&answers).filter(|((p, n), a)| place_and_octant(&table, *p * 1.001, *n) != **a);
        assert!(moved.count() > 20, "{mode}");
    }
}

/// Distance of a direction's first coordinate to the nearest edge that a leaf can have.
fn distance_to_edge(direction: Vec3) -> f32 {
    let steps = (1 << MAX_DEPTH) as f32;
    let x = octant_coordinates(direction).x * steps;
    (x - x.round()).abs() / steps
}

/// Directions that matter: uniform ones, and those to the edges of octants and leaves.
fn directions() -> Vec<Vec3> {
    let mut directions: Vec<Vec3> = (0..30_000).map(|i| uniform_direction(8, i)).collect();
    directions.extend(drawn(normal(), 20_000));
    directions
}

fn close(a: f32, b: f32, relative: f32, absolute: f32) -> bool {
    (a - b).abs() <= relative * a.abs().max(b.abs()) + absolute
}

/// Leaves are the same but where the driver's arc tangent puts a direction on the other side of an edge within 1e-6;
/// densities are then the same to 1e-5.
#[test]
fn directions_have_the_same_leaf_on_the_gpu() {
    let gpu = open_gpu();
    let kernel = (
        "import package::guiding::data::guide_rows;
        import package::guiding::table::{adaptive_density, cell_of};",
        "let density = adaptive_density(cell_of(guide_rows[a.w]), bitcast<vec3<f32>>(b.xyz));
        out0 = vec4<u32>(density.slot, bitcast<u32>(density.pdf), 0u, 0u);",
    );
    let learnt = learnt(GuideMode::Adaptive, 1);
    let asked: Vec<_> =
        directions().into_iter().zip(0..).map(|(d, i)| (learnt.cell(i % 97).0, flushed(d))).collect();
    let questions: Vec<Question> =
        asked.iter().zip(0..).map(|((_, d), i)| question(Vec3::ZERO, learnt.row(i % 97), *d)).collect();
    let answers = ask(&gpu, GuideMode::Adaptive, kernel, &learnt.table, &questions);
    let (mut moved, mut slots) = (0, std::collections::BTreeSet::new());
    for ((cell, direction), [slot, pdf, ..]) in asked.iter().zip(&answers) {
        let expected = adaptive::density(&learnt.table, cell, *direction);
        slots.insert(*slot);
        if *slot != expected.slot {
            moved += 1;
            assert!(distance_to_edge(*direction) < 1e-6, "{direction}: {slot} for {expected:?}");
            continue;
        }
        let pdf = f32::from_bits(*pdf);
        assert!(close(pdf, expected.pdf, 1e-5, 1e-9), "{direction}: {pdf} for {expected:?}");
    }
    println!("{moved} of {} directions moved over an edge; {} slots", asked.len(), slots.len());
    assert!(moved < asked.len() / 20 && slots.len() > 1000);
}

/// Shares to 2e-6; means and densities of the octant guide to 1e-4.
#[test]
fn octants_have_the_same_densities_on_the_gpu() {
    let gpu = open_gpu();
    let kernel = (
        "import package::guiding::data::guide_rows;
        import package::base::sampling::pdf_cosine;
        import package::guiding::octant::{octant_of, octant_shares, octant_wholes, of_octant};
        import package::guiding::table::{cell_of, octants_density, octants_radiance};",
        "let normal = bitcast<vec3<f32>>(a.xyz);
        let direction = bitcast<vec3<f32>>(b.xyz);
        let cell = cell_of(guide_rows[a.w]);
        let shares = octant_shares(normal);
        let mean = octants_radiance(cell, shares);
        let proposed = octants_radiance(cell, octant_wholes(normal));
        let density = octants_density(cell, mean, proposed, pdf_cosine(dot(normal, direction)), direction);
        let share = of_octant(shares, octant_of(direction));
        out0 = vec4<u32>(density.slot, bitcast<u32>(density.pdf), bitcast<u32>(share), bitcast<u32>(mean));",
    );
    let learnt = learnt(GuideMode::Octant, 1);
    let normals = drawn(normal(), 1000);
    let asked: Vec<_> = directions()
        .into_iter()
        .zip(0..)
        .map(|(d, i)| (learnt.cell(i % 97).0, flushed(normals[i as usize % 1000]), flushed(d)))
        .collect();
    let questions: Vec<Question> =
        asked.iter().zip(0..).map(|((_, n, d), i)| question(*n, learnt.row(i % 97), *d)).collect();
    let answers = ask(&gpu, GuideMode::Octant, kernel, &learnt.table, &questions);
    for ((cell, normal, direction), answer) in asked.iter().zip(&answers) {
        let mean = octants::radiance(cell, &octant_shares(*normal));
        let proposed = octants::radiance(cell, &octant_wholes(*normal));
        let cosine = pdf_cosine(normal.dot(*direction));
        let expected = octants::density(cell, mean, proposed, cosine, *direction);
        let share = octant_shares(*normal)[octant_of(*direction) as usize];
        let [pdf, gpu_share, gpu_mean] = [answer[1], answer[2], answer[3]].map(f32::from_bits);
        let what =
            format!("{normal} {direction}: {pdf} {gpu_share} {gpu_mean} for {expected:?} {share} {mean}");
        assert_eq!(answer[0], expected.slot, "{what}");
        assert!(close(gpu_share, share, 0.0, 2e-6) && close(gpu_mean, mean, 1e-5, 0.0), "{what}");
        assert!(close(pdf, expected.pdf, 1e-4, 1e-5), "{what}");
    }
    // Negative control: shares of other normals are not that close.
    let shares = asked.iter().zip(&answers).filter(|((_, n, d), a)| {
        close(octant_shares((*n + 1e-3).normalize())[octant_of(*d) as usize], f32::from_bits(a[2]), 0.0, 2e-6)
    });
    assert!(shares.count() < asked.len() / 2);
}

/// Normals of every kind, and within 1e-8 to 1e-2 of each axis.
fn normals_and_axes() -> Vec<Vec3> {
    let axes = Vec3::AXES.into_iter().flat_map(|axis| [axis, -axis]);
    let tilts = [0.0f32, 1e-8, 1e-5, 1e-4, 3e-4, 1e-3, 1e-2];
    let towards = Vec3::new(0.3, 0.6, -0.7);
    let tilted = axes.flat_map(|axis| tilts.map(|tilt| (axis + tilt * towards).normalize()));
    tilted.chain(drawn(normal(), 300)).map(flushed).collect()
}

/// All eight shares of a cosine lobe are those of quadrature in f64, to two millionths, and add up to one.
#[test]
fn octant_shares_on_the_gpu_are_right_to_two_millionths() {
    let gpu = open_gpu();
    let kernel = (
        "import package::guiding::octant::octant_shares;",
        "let n = bitcast<vec3<f32>>(a.xyz);
        let shares = octant_shares(n);
        out0 = bitcast<vec4<u32>>(shares.low);
        if a.w == 4u { out0 = bitcast<vec4<u32>>(shares.high); }",
    );
    let normals = normals_and_axes();
    let questions: Vec<Question> =
        normals.iter().flat_map(|n| [0, 4].map(|first| question(*n, first, Vec3::ZERO))).collect();
    let answers = ask(&gpu, GuideMode::Octant, kernel, &learnt(GuideMode::Octant, 1).table, &questions);
    let mut worst = 0.0f64;
    for (normal, halves) in normals.iter().zip(answers.chunks(2)) {
        let shares: Vec<f32> = halves.as_flattened().iter().map(|word| f32::from_bits(*word)).collect();
        assert!((shares.iter().sum::<f32>() - 1.0).abs() < 4e-6, "{normal:?}: {shares:?}");
        let errors = (0..8).zip(&shares).map(|(octant, share)| share_error(*normal, octant, *share));
        worst = errors.fold(worst, f64::max);
        assert!(worst < 2e-6, "{normal:?}: {shares:?} are {worst:e} off");
    }
    println!("octant shares are {worst:e} off");
}

/// At a surface point both sides have as many directions guided, whether the horizon turns proposals down or nothing is guided since
/// all that is known lies behind the surface.
#[test]
fn octants_guide_as_many_directions_on_the_gpu() {
    let gpu = open_gpu();
    let kernel = (
        "import package::items::Material;
        import package::scene::data::KIND_DIFFUSE;
        import package::scene::shapes::Surface;
        import package::transport::guide::guide_point;",
        "let normal = bitcast<vec3<f32>>(b.xyz);
        var material: Material;
        material.color = vec3<f32>(0.5);
        material.kind = KIND_DIFFUSE;
        let point = guide_point(Surface(bitcast<vec3<f32>>(a.xyz), normal, 0.0), normal, material);
        out0 = bitcast<vec4<u32>>(vec4<f32>(point.mixture, point.mean, point.proposed, point.share));",
    );
    let scene = CompiledScene::new(&scene("cornell-box"));
    let (search, uniforms) = (Search::new(&scene), Uniforms::default());
    let material = Material { color: Vec3::splat(0.5), kind: KIND_DIFFUSE, ..Default::default() };
    let mut learnt = learnt(GuideMode::Octant, 9);
    let position = surface_point(77, 4).0;
    let normals = normals_and_axes();
    for octants in [None, Some([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]), Some([1e-31; 8])] {
        octants.inspect(|octants| learnt.set_octants(4, *octants));
        let sums = LessonSums::new(LessonLayout::new(&learnt.table.uniforms));
        let guidance = Some(Guidance { mode: GuideMode::Octant, table: &learnt.table, sums: &sums });
        let transport = Transport { guidance, ..Transport::plain(&scene, &search, &uniforms) };
        let questions: Vec<Question> = normals.iter().map(|normal| question(position, 0, *normal)).collect();
        let answers = ask(&gpu, GuideMode::Octant, kernel, &learnt.table, &questions);
        let mut unguided = 0;
        for (normal, answer) in normals.iter().zip(&answers) {
            let surface = Surface::plain(position, *normal, 0.0);
            let point = transport.guide_point(&surface, *normal, &material).unwrap();
            let [mixture, mean, proposed, share] = answer.map(f32::from_bits);
            let what = format!("{normal:?}: {mixture} {mean} {proposed} for {point:?}");
            assert!(
                close(mean, point.mean, 1e-5, 1e-7) && close(proposed, point.proposed, 1e-5, 1e-7),
                "{what}"
            );
            // At the very border of what is seen either side may be right.
            let border = (point.mean / point.cell.irradiance / LEAST_SEEN - 1.0).abs() < 0.01;
            assert!(border || close(mixture, point.mixture, 1e-3, 0.0) && share == 1.0, "{what}");
            unguided += usize::from(mixture == 0.0);
        }
        let (few, all) = (normals.len() / 10, normals.len());
        let expected = [(None, 0..1), (Some(1.0), few..all), (Some(1e-31), all..all + 1)];
        let known = octants.map(|octants| octants[6]);
        let (_, range) = expected.iter().find(|(octant, _)| *octant == known).unwrap();
        assert!(range.contains(&unguided), "{known:?}: {unguided} of {all} normals are not guided");
    }
}

/// What the GPU draws at a surface point follows the density that Rust tells, and the GPU tells the same. α = 1e-4 each.
#[test]
fn directions_drawn_on_the_gpu_follow_the_density_of_the_cpu() {
    const DRAWS: u32 = 100_000;
    let gpu = open_gpu();
    let kernel = (
        "import package::base::random::{SampleKey, sample4};
        import package::items::Material;
        import package::scene::data::KIND_DIFFUSE;
        import package::scene::shapes::Surface;
        import package::transport::guide::{guide_point, guided_direction, guided_pdf};",
        "let normal = bitcast<vec3<f32>>(b.xyz);
        var material: Material;
        material.color = vec3<f32>(0.5);
        material.kind = KIND_DIFFUSE;
        let point = guide_point(Surface(bitcast<vec3<f32>>(a.xyz), normal, 0.0), normal, material);
        let key = SampleKey(3u, a.w, 47u);
        let wi = guided_direction(point, normal, sample4(key, 1u).xy, key, 0u);
        out0 = vec4<u32>(bitcast<vec3<u32>>(wi), bitcast<u32>(guided_pdf(point, normal, wi)));",
    );
    let scene = CompiledScene::new(&scene("cornell-box"));
    let (search, uniforms) = (Search::new(&scene), Uniforms::default());
    let material = Material { color: Vec3::splat(0.5), kind: KIND_DIFFUSE, ..Default::default() };
    let cells = Cells { rows: 16, columns: 32, ..Cells::sphere(Vec3::Z) };
    for mode in [GuideMode::Adaptive, GuideMode::Octant, GuideMode::BansalReweighted] {
        let table = learnt(mode, 9).table;
        let sums = LessonSums::new(LessonLayout::new(&table.uniforms));
        let guidance = Some(Guidance { mode, table: &table, sums: &sums });
        let transport = Transport { guidance, ..Transport::plain(&scene, &search, &uniforms) };
        for i in [4, 5] {
            let position = surface_point(77, i).0;
            let normal = Vec3::new(-0.35, 0.2 * i as f32, 0.4).normalize();
            let point =
                transport.guide_point(&Surface::plain(position, normal, 0.0), normal, &material).unwrap();
            let questions: Vec<Question> =
                (0..DRAWS).map(|sample| question(position, sample, normal)).collect();
            let answers = ask(&gpu, mode, kernel, &table, &questions);
            let drawn = |i: u32| {
                let [x, y, z, _] = answers[i as usize];
                Vec3::new(f32::from_bits(x), f32::from_bits(y), f32::from_bits(z))
            };
            let pdf = |d: Vec3| transport.guided_pdf(&point, normal, d);
            let p = cells.chi2(|i| Some(drawn(i)), |d| f64::from(pdf(d)));
            assert!(p > ALPHA, "{mode}, point {i}: p = {p}");
            let p = cells.chi2(|i| Some(drawn(i)), |d| f64::from(pdf(d) * (1.0 + 0.2 * d.x)));
            assert!(p < WRONG, "{mode}, point {i}: a wrong density passes with p = {p}");
            let differing = (0..DRAWS)
                .filter(|&i| !close(f32::from_bits(answers[i as usize][3]), pdf(drawn(i)), 1e-3, 1e-5));
            // A draw within rounding of a leaf's edge may count to either leaf.
            assert!(differing.count() < 20, "{mode}, point {i}");
        }
    }
}

/// The GPU draws the same ticket as the CPU from the same numbers, with the same density to the bit; the direction in its leaf
/// is the same but for the rounding of the driver's sine and cosine.
#[test]
fn tickets_are_drawn_alike_on_the_gpu() {
    let gpu = open_gpu();
    let kernel = (
        "import package::guiding::data::guide_rows;
        import package::guiding::table::{adaptive_sample, cell_of};",
        "let sample = adaptive_sample(cell_of(guide_rows[a.w]), bitcast<vec2<f32>>(b.xy));
        out0 = vec4<u32>(bitcast<vec3<u32>>(sample.direction), bitcast<u32>(sample.pdf));",
    );
    let learnt = learnt(GuideMode::Adaptive, 2);
    let asked: Vec<_> =
        (0..40_000u32).map(|i| (learnt.cell(i % 97).0, random(12, i, 3).truncate())).collect();
    let questions: Vec<Question> =
        asked.iter().zip(0..).map(|((_, u), i)| question(Vec3::ZERO, learnt.row(i % 97), *u)).collect();
    let answers = ask(&gpu, GuideMode::Adaptive, kernel, &learnt.table, &questions);
    for ((cell, u), [x, y, z, pdf]) in asked.iter().zip(&answers) {
        let (expected, density) = adaptive::sample(&learnt.table, cell, u.truncate());
        let found = Vec3::new(f32::from_bits(*x), f32::from_bits(*y), f32::from_bits(*z));
        assert!((found - expected).length() < 2e-6, "{u}: {found} for {expected}");
        assert_eq!(f32::from_bits(*pdf), density, "{u}");
    }
}
