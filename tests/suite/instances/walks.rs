//! The walk through two levels against the one through a single hierarchy over the same triangles.

use super::{both, rock, somewhere, turn, under_a_sky};
use crate::probe::{Input, Numbers, Probe, floats, row};
use crate::support::*;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use qtracer::gpu::device::Gpu;
use qtracer::gpu::key::KernelKey;
use qtracer::guiding::GuideMode;
use qtracer::scene::compiled::{CompiledScene, NONE, Triangle};
use qtracer::scene::instance::{Instance, place_corner, place_normal};
use qtracer::scene::rows::{self, Row};
use qtracer::scene::shapes::{self, Hit, Ray, T_MISS};
use qtracer::scene::{MeshData, bvh, two_levels};
use qtracer::transport::roulette::Roulette;
use wgpu::BufferUsages;

/// How hard instances are put: sizes, and distances from the origin.
const PLACES: [([f64; 2], f64); 6] = [
    ([0.5, 2.0], 10.0),
    ([1e-3, 1e3], 100.0),
    ([1.0, 1.0], 1e4),
    ([1.0, 1.0], 1e6),
    ([1e-3, 1e-2], 1.0),
    ([1e2, 1e3], 0.1),
];

/// Rocks of 80 triangles, spheres, quads, and a mesh that is laid out.
fn rocks(numbers: &mut Numbers, (sizes, half): ([f64; 2], f64)) -> [CompiledScene; 2] {
    let places: Vec<_> =
        (0..24).map(|_| (somewhere(numbers, sizes, half), ["grey", "red"][numbers.below(2)])).collect();
    let mut builder = under_a_sky([0.0, 0.0, 9.0], [0.0; 3])
        .mesh_in_places(rock(numbers, 1), places)
        .mesh_in_places(
            rock(numbers, 0),
            (0..9).map(|_| (somewhere(numbers, sizes, half), "grey")).collect::<Vec<_>>(),
        )
        .mesh(rock(numbers, 1), "red");
    for _ in 0..4 {
        builder = builder.sphere(numbers.in_box(half), sizes[1], "grey");
        builder = builder.quad(
            numbers.in_box(half),
            numbers.direction() * sizes[1],
            numbers.direction() * sizes[1],
            "red",
        );
    }
    both(&builder.build().unwrap())
}

/// A ray at a corner, an edge or a point of a triangle, from near or far, or along an axis of the world or of a mesh.
fn ray_at(numbers: &mut Numbers, scene: &CompiledScene) -> [Row; 2] {
    let Triangle { a, b, c, .. } = scene.triangle(numbers.below(scene.triangle_count()));
    let mut share = || [0.0, 1.0, numbers.between(0.0, 1.0)][numbers.below(3)];
    let (s, t) = (share(), share());
    let target = a.as_dvec3() + (b - a).as_dvec3() * s + (c - a).as_dvec3() * (t * (1.0 - s));
    let size = f64::from(a.distance(b));
    let mut direction = numbers.direction();
    match numbers.below(4) {
        0 => direction[numbers.below(3)] = 0.0f64.copysign(numbers.sign()),
        1 => direction = DVec3::AXES[numbers.below(3)] * numbers.sign(),
        2 => {
            let Instance { x_axis, y_axis, z_axis, .. } =
                scene.shared.instances[numbers.below(scene.shared.instances.len())];
            direction = [x_axis, y_axis, z_axis][numbers.below(3)].as_dvec3() * numbers.sign();
        }
        _ => {}
    }
    let direction = direction.normalize_or(DVec3::X).as_vec3();
    let away = size * numbers.of_any_size(1e-2, 1e4);
    let origin = (target - direction.as_dvec3() * away).as_vec3();
    let excluded = [NONE, numbers.below(scene.shape_count()) as u32][numbers.below(2)];
    [row(origin, ((away * numbers.between(0.0, 2.0)) as f32).to_bits()), row(direction, excluded)]
}

fn ray_of([a, b]: &[Row; 2]) -> (Ray, f32, u32) {
    let ((origin, t_max), direction) = (floats(*a), floats(*b).0);
    (Ray { origin, direction }, t_max, b[3])
}

type Found = (Option<Hit>, bool);

fn by_two_levels(scene: &CompiledScene, question: &[Row; 2]) -> Found {
    let (ray, t_max, excluded) = ray_of(question);
    let bvh = scene.bvh.as_ref().unwrap();
    (two_levels::intersect(scene, bvh, ray), two_levels::occluded(scene, bvh, ray, t_max, excluded))
}

fn by_one(scene: &CompiledScene, question: &[Row; 2]) -> Found {
    let (ray, t_max, excluded) = ray_of(question);
    let bvh = scene.bvh.as_ref().unwrap();
    (bvh::intersect(scene, bvh, ray), bvh::occluded(scene, bvh, ray, t_max, excluded))
}

/// How many of so many rays are answered otherwise by the two walks, and how many hit instances.
fn differing(
    seed: u64,
    place: ([f64; 2], f64),
    rays: usize,
    change: impl Fn(&mut CompiledScene),
) -> [usize; 2] {
    let mut numbers = Numbers(seed);
    let [mut shared, laid_out] = rocks(&mut numbers, place);
    assert!(shared.shared.instances.len() > 20 && laid_out.shared.instances.is_empty(), "{place:?}");
    let questions: Vec<_> = (0..rays).map(|_| ray_at(&mut numbers, &shared)).collect();
    let first = (shared.shape_count() - shared.shared.seen) as u32;
    change(&mut shared);
    let mut counts = [0; 2];
    for question in &questions {
        let expected = by_one(&laid_out, question);
        counts[0] += usize::from(by_two_levels(&shared, question) != expected);
        counts[1] += usize::from(expected.0.is_some_and(|hit| hit.shape >= first));
    }
    counts
}

/// 7e5 rays: the same shapes at the same distances and the same shadows, in every bit.
#[test]
fn two_levels_find_what_one_hierarchy_finds() {
    for (number, place) in PLACES.into_iter().enumerate() {
        for seed in 0..4 {
            let [differ, hits] = differing(1000 + 10 * number as u64 + seed, place, 30_000, |_| ());
            assert_eq!(differ, 0, "{place:?}, seed {seed}: {hits} hits");
            assert!(hits > 5_000, "{place:?}: {hits} hits");
        }
    }
}

/// Negative controls: without room for roundings hits are lost; boxes met by another ray lose more.
#[test]
fn without_slack_or_with_another_matrix_hits_are_lost() {
    let no_slack = |scene: &mut CompiledScene| {
        scene.shared.instances.iter_mut().for_each(|instance| instance.slack = Vec3::ZERO);
    };
    let [differ, hits] = differing(1020, ([1.0, 1.0], 1e4), 30_000, no_slack);
    println!("without slack: {differ} of {hits} hits differ");
    assert!(differ > 100, "{differ}");
    let moved = |scene: &mut CompiledScene| {
        scene.shared.instances.iter_mut().for_each(|instance| instance.inverse_x *= 1.01);
    };
    let [differ, hits] = differing(1000, PLACES[0], 30_000, moved);
    println!("with another inverse: {differ} of {hits} hits differ");
    assert!(differ > 20, "{differ}");
}

/// Laid out and shared, corners are the same, and both find what asking all triangles one by one finds, but for the one in
/// millions that a walk does not come to.
#[test]
fn shared_triangles_are_those_laid_out_and_all_are_asked() {
    let mut numbers = Numbers(77);
    let [shared, laid_out] = rocks(&mut numbers, PLACES[0]);
    assert_eq!(shared.shape_count(), laid_out.shape_count());
    assert!((0..shared.triangle_count()).all(|i| shared.triangle(i) == laid_out.triangle(i)));
    let mut differ = 0;
    for _ in 0..3000 {
        let question = ray_at(&mut numbers, &shared);
        let (ray, t_max, excluded) = ray_of(&question);
        let all = (shapes::intersect(&shared, ray), shapes::occluded(&shared, ray, t_max, excluded));
        differ += usize::from(by_two_levels(&shared, &question) != all);
    }
    assert!(differ <= 1, "{differ}");
}

/// Asks a probe that reads this scene.
fn ask<const Q: usize, const A: usize>(
    gpu: &Gpu,
    (imports, body): (&str, &str),
    scene: &CompiledScene,
    questions: &[[Row; Q]],
) -> Vec<[Row; A]> {
    let usual = KernelKey::new(scene, &estimators(GuideMode::Off, Roulette::Off));
    let key = KernelKey { direct_light: true, smooth: true, ..usual };
    let camera = qtracer::scene::Camera {
        origin: DVec3::ZERO,
        target: DVec3::NEG_Z,
        up: DVec3::Y,
        fov_y_deg: 45.0,
        width: 1,
        height: 1,
    };
    let uniforms = scene.uniforms(&camera, 1, 1, 0);
    let packed = rows::pack(scene);
    let inputs: [Input<'_>; 2] = [
        ("uniforms", bytemuck::bytes_of(&uniforms), BufferUsages::UNIFORM),
        ("scene_rows", bytemuck::cast_slice(&packed), BufferUsages::STORAGE),
    ];
    Probe::<Q, A>::new(gpu, &key, imports, body).ask(gpu, &inputs, questions)
}

const WALK: (&str, &str) = (
    "import package::scene::two_levels::{intersect, occluded};
    import package::scene::shapes::Ray;",
    "let ray = Ray(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz));
    let hit = intersect(ray);
    let dark = occluded(ray, bitcast<f32>(a.w), b.w);
    out0 = vec4<u32>(bitcast<u32>(hit.t), hit.shape, u32(dark), 0u);",
);

/// The walk through one hierarchy.
const WALK_ONE: (&str, &str) = (
    "import package::scene::bvh::{intersect, occluded};
    import package::scene::shapes::Ray;",
    WALK.1,
);

/// The kernels find by two levels what they find by one, and where they compute to the letter what the CPU does; elsewhere
/// rays at corners, of which these are many, may go to another triangle than there. Hits of spheres have distances of their
/// own in the kernels, which refine them later.
#[test]
fn the_kernels_walk_through_two_levels_as_the_cpu_does() {
    let gpu = open_gpu();
    for (number, place) in PLACES.into_iter().enumerate() {
        let mut numbers = Numbers(2000 + number as u64);
        let [shared, laid_out] = rocks(&mut numbers, place);
        let questions: Vec<_> = (0..1 << 12).map(|_| ray_at(&mut numbers, &shared)).collect();
        let answers: Vec<[Row; 1]> = ask(&gpu, WALK, &shared, &questions);
        let by_one: Vec<[Row; 1]> = ask(&gpu, WALK_ONE, &laid_out, &questions);
        let differ = answers.iter().zip(&by_one).filter(|(a, b)| a != b).count();
        let to_the_letter = computes_to_the_letter(&gpu);
        println!("{place:?}: {differ} of {} differ", questions.len());
        assert!(
            differ <= if to_the_letter { 0 } else { questions.len() / 500 },
            "{place:?}: {differ} differ"
        );
        for (question, [found]) in questions.iter().zip(&answers).filter(|_| to_the_letter) {
            let (hit, dark) = by_two_levels(&shared, question);
            let Hit { t, shape } = hit.unwrap_or(Hit { t: T_MISS, shape: NONE });
            let sphere = (shape as usize) < shared.spheres.len();
            assert_eq!([shape, u32::from(dark)], found[1..3], "{place:?}: {question:?}");
            assert!(t.to_bits() == found[0] || sphere, "{place:?}: {question:?}");
        }
    }
}

const PLACE: (&str, &str) = (
    "import package::scene::data::instance_at;
    import package::scene::instance::{place_corner, place_normal, to_mesh};",
    "let instance = instance_at(a.w);
    let p = bitcast<vec3<f32>>(a.xyz);
    out0 = vec4<u32>(bitcast<vec3<u32>>(place_corner(instance, p)), 0u);
    out1 = vec4<u32>(bitcast<vec3<u32>>(place_normal(instance, p, bitcast<vec3<f32>>(b.xyz))), 0u);
    out2 = vec4<u32>(bitcast<vec3<u32>>(to_mesh(instance, p)), 0u);",
);

/// Corners are the same in every bit on every adapter, since nothing in them can be fused; normals within roundings.
#[test]
fn both_sides_place_corners_and_normals_alike() {
    let gpu = open_gpu();
    let mut numbers = Numbers(31);
    let [shared, _] = rocks(&mut numbers, PLACES[1]);
    let instances = &shared.shared.instances;
    let make = |_| {
        let p = numbers.direction().as_vec3();
        [row(p, numbers.below(instances.len()) as u32), row(numbers.direction().as_vec3(), 0)]
    };
    let questions: Vec<[Row; 2]> = (0..4096).map(make).collect();
    let answers: Vec<[Row; 3]> = ask(&gpu, PLACE, &shared, &questions);
    let (mut back, mut apart) = (0.0f32, 0.0f32);
    for ([a, b], [corner, normal, _]) in questions.iter().zip(&answers) {
        let (instance, p, flat) = (&instances[a[3] as usize], floats(*a).0, floats(*b).0);
        let placed = place_corner(instance, p);
        assert_eq!(floats(*corner).0, placed);
        apart = apart.max(floats(*normal).0.distance(place_normal(instance, p, flat)));
        assert!(place_normal(instance, p, flat).dot(flat) > 0.0);
        // The inverse brings it back to within the slack.
        let returned = qtracer::scene::instance::to_mesh(instance, placed - instance.translation);
        let slack = instance.slack * (placed.abs().max_element() + instance.reach);
        back = back.max(((returned - p).abs() / slack).max_element());
    }
    println!("normals up to {apart:e} apart; corners come back within {back} of the slack");
    assert!(apart <= if computes_to_the_letter(&gpu) { 0.0 } else { 1e-5 }, "{apart}");
    assert!(back < 0.5, "{back}");
}

const SURFACE: (&str, &str) = (
    "import package::scene::shapes::{Hit, Ray, surface_at};",
    "let ray = Ray(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz));
    let surface = surface_at(ray, Hit(bitcast<f32>(a.w), b.w));
    out0 = vec4<u32>(bitcast<vec3<u32>>(surface.position), bitcast<u32>(surface.offset));
    out1 = vec4<u32>(bitcast<vec3<u32>>(surface.normal), 0u);
    out2 = vec4<u32>(bitcast<vec3<u32>>(surface.shading_normal), 0u);",
);

/// Points, normals and offsets of instances are in every bit those laid out; shading normals differ by the 16 bits that they
/// are rounded to (4e-5), before the map or behind it: it stretches up to 16-fold here. The kernels say the same.
#[test]
fn surfaces_of_instances_are_those_laid_out() {
    let mut numbers = Numbers(41);
    let data = rock(&mut numbers, 1);
    let data = MeshData { normals: data.positions.clone(), ..data };
    let places: Vec<_> = (0..20).map(|_| (somewhere(&mut numbers, [0.5, 2.0], 9.0), "grey")).collect();
    let scene = under_a_sky([0.0, 0.0, 9.0], [0.0; 3]).mesh_in_places(data, places).build().unwrap();
    let [shared, laid_out] = both(&scene);
    let hit = |_| {
        let question = ray_at(&mut numbers, &shared);
        let (ray, ..) = ray_of(&question);
        let Hit { t, shape } = by_two_levels(&shared, &question).0?;
        Some([row(ray.origin, t.to_bits()), row(ray.direction, shape)])
    };
    let hits: Vec<[Row; 2]> = (0..8192).filter_map(hit).collect();
    assert!(hits.len() > 4000);
    let gpu = open_gpu();
    let answers: Vec<[Row; 3]> = ask(&gpu, SURFACE, &shared, &hits);
    let (mut bent, mut twins) = (0.0f32, [0.0f32; 3]);
    for ([a, b], [place, normal, shading]) in hits.iter().zip(&answers) {
        let (ray, hit) =
            (Ray { origin: floats(*a).0, direction: floats(*b).0 }, Hit { t: floats(*a).1, shape: b[3] });
        let [one, other] = [&shared, &laid_out].map(|scene| shapes::surface_at(scene, ray, hit));
        assert_eq!((one.position, one.normal, one.offset), (other.position, other.normal, other.offset));
        assert!(one.shading_normal.dot(one.normal) > 0.0);
        bent = bent.max(one.shading_normal.distance(other.shading_normal));
        let ((position, offset), normal, shading) = (floats(*place), floats(*normal).0, floats(*shading).0);
        // Beside the surface by a share of the offset, along it by roundings of the ray.
        let [beside, reach] = [position - one.position, ray.origin.abs() + Vec3::splat(hit.t)];
        let off = beside.dot(one.normal).abs() / offset;
        let along = beside.length() / (4.0 * f32::EPSILON * reach.max_element() + 0.25 * offset);
        let normals = normal.distance(one.normal).max(shading.distance(one.shading_normal));
        twins = [twins[0].max(off), twins[1].max(along), twins[2].max(normals)];
    }
    println!("shading normals up to {bent:e} apart, twins off the surface, along it, normals {twins:?}");
    assert!(bent < 2.5e-4, "{bent}");
    let most = if computes_to_the_letter(&gpu) { [1e-6; 3] } else { [0.25, 1.0, 1e-3] };
    assert!((0..3).all(|i| twins[i] <= most[i]), "{twins:?}");
}

/// In f64: a normal that is at right angles to a triangle stays so, on the outer side, whatever the map.
#[test]
fn placed_normals_are_at_right_angles_to_placed_triangles() {
    let mut numbers = Numbers(32);
    for _ in 0..200 {
        let map = somewhere(&mut numbers, [0.1, 10.0], 5.0);
        let data = rock(&mut numbers, 0);
        let scene = under_a_sky([0.0, 0.0, 9.0], [0.0; 3])
            .mesh_in_places(data.clone(), [(map, "grey")])
            .build()
            .unwrap();
        let [shared, _] = both(&scene);
        let instance = &shared.shared.instances[0];
        let [a, b, c] = data.triangles[0].map(|i| data.positions[i as usize]);
        let normal = (b - a).cross(c - a).normalize();
        let placed = [a, b, c].map(|p| map.transform_point3(p));
        let side = (placed[1] - placed[0]).cross(placed[2] - placed[0]) * map.matrix3.determinant().signum();
        let found = place_normal(instance, normal.as_vec3(), side.normalize().as_vec3());
        assert!((found.as_dvec3() - side.normalize()).length() < 1e-4, "{map:?}");
        let [one, two, three] = [0].map(|i| shared.triangle(i)).map(|t| [t.a, t.b, t.c])[0];
        assert!(
            (two - one).cross(three - one).as_dvec3().dot(side) > 0.0,
            "the outer side is inside: {map:?}"
        );
    }
}

/// What f32 can't bring to its place has triangles of its own, which are those that it always had.
#[test]
fn hopeless_places_are_laid_out_in_full_precision() {
    let data = rock(&mut Numbers(5), 1);
    let hopeless = [
        DAffine3::from_scale(DVec3::splat(1e-7)),
        DAffine3::from_scale(DVec3::new(1.0, 1.0, 1e-8)),
        // Rounded to f32, half of such maps are inside out.
        DAffine3::from_mat3(turn(&mut Numbers(2)) * DMat3::from_diagonal(DVec3::new(1e4, 1e4, 2e-6))),
        DAffine3::from_mat3(turn(&mut Numbers(3)) * DMat3::from_diagonal(DVec3::new(1e4, 1e4, 1e-3))),
        // Undoes what the mesh's own coordinates are.
        DAffine3::from_mat3_translation(DMat3::IDENTITY, DVec3::splat(-1e5)),
    ];
    let moved = MeshData {
        positions: data.positions.iter().map(|p| p + DVec3::splat(1e5)).collect(),
        ..data.clone()
    };
    for (number, map) in hopeless.into_iter().enumerate() {
        let mesh = if number == 4 { moved.clone() } else { data.clone() };
        let builder = under_a_sky([0.0, 0.0, 9.0], [0.0; 3]);
        let scene = builder
            .mesh_in_places(mesh, [(map, "grey"), (DAffine3::from_mat3(turn(&mut Numbers(1))), "grey")]);
        let scene = scene.build().unwrap();
        assert!(matches!(scene.shapes[0].geometry, qtracer::scene::Geometry::Mesh(_)), "{map:?}");
        assert!(matches!(scene.shapes[1].geometry, qtracer::scene::Geometry::Instance(_)), "{map:?}");
    }
}

/// A sliver that f32 can't tell from a line where it stands: that instance is laid out, and the sliver left out with a warning;
/// others are shared, where it is thin but there.
#[test]
fn an_instance_that_would_lose_a_triangle_is_laid_out() {
    let mut data = rock(&mut Numbers(6), 1);
    let first = data.positions.len() as u32;
    data.positions.extend([DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1e-6, 0.0)]);
    data.triangles.push([first, first + 1, first + 2]);
    let at = |y: f64| (DAffine3::from_translation(DVec3::Y * y), "grey");
    let scene = under_a_sky([0.0, 0.0, 9.0], [0.0; 3]).mesh_in_places(data, [at(0.0), at(1000.0)]);
    let scene = scene.build().unwrap();
    let [near, far] = [0, 1].map(|shape| &scene.shapes[shape].geometry);
    assert!(matches!(near, qtracer::scene::Geometry::Instance(_)));
    assert!(
        matches!(far, qtracer::scene::Geometry::Mesh(mesh) if mesh.len() == 80),
        "{}",
        far.mesh().unwrap().len()
    );
    let warnings: Vec<String> = scene.warnings().iter().map(|warning| warning.to_string()).collect();
    assert!(warnings.len() == 1 && warnings[0].contains("1 triangle without area"), "{warnings:?}");
}
