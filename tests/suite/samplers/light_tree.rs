//! Lights chosen by the light tree: probabilities, what is chosen, and the bounds that they are made of.

use super::twins::{SIDES, Side, Twins, World, Worst};
use super::{ALPHA, DRAW, DRAW_IMPORTS, WRONG, draw};
use crate::probe::{Numbers, floats, row};
use crate::support::{icosphere, scene};
use glam::{DVec3, Vec3, Vec4Swizzles};
use qtracer::scene::compiled::{CompiledScene, NONE, ShapeIndex};
use qtracer::scene::light_tree::{LIGHT, MOST_CLUSTERS};
use qtracer::scene::rows::Row;
use qtracer::scene::triangle::double_area;
use qtracer::scene::{Material, Scene, SceneBuilder};
use qtracer::stats::chi2_test;
use qtracer::transport::light_tree::{choose_in_tree, importance, probability_in_tree};

fn lamp(strength: f64) -> Material {
    Material::diffuse([0.0; 3]).emitting([strength, strength / 2.0, strength / 4.0])
}

fn built(builder: SceneBuilder) -> CompiledScene {
    let scene = CompiledScene::new(&builder.camera([0.0, 0.0, 9.0], [0.0; 3], 40.0).build().unwrap());
    assert!(scene.light_tree.is_some(), "{} lights", scene.lights.len());
    scene
}

/// Spheres, one in five of which shines inwards, and quads, within 10 of `center`, of powers up to 1e8 : 1.
fn mixed(center: DVec3, count: usize) -> CompiledScene {
    let mut numbers = Numbers(61);
    let mut builder = Scene::builder("mixed");
    for i in 0..count {
        let (name, at) = (format!("lamp {i}"), center + numbers.in_box(10.0));
        let size = numbers.of_any_size(0.02, 0.5);
        builder = builder.material(name.as_str(), lamp(numbers.of_any_size(1e-4, 1e4)));
        builder = match i % 5 {
            0 => builder.inward_sphere(at, 4.0 * size, name),
            1 | 2 => builder.sphere(at, size, name),
            _ => {
                let (a, b) = (numbers.direction(), numbers.direction());
                builder.quad(at, a * size, a.cross(b) * size, name)
            }
        };
    }
    built(builder)
}

/// Twenty lamps in one place, of powers 1e8 : 1.
fn coincident() -> CompiledScene {
    let lamps = (0..20).fold(Scene::builder("coincident"), |builder, i| {
        let name = format!("lamp {i}");
        builder.material(name.as_str(), lamp(1e-8f64.powf(f64::from(i) / 19.0))).sphere(
            DVec3::ZERO,
            1.0 + 1e-3 * f64::from(i),
            name,
        )
    });
    built(lamps)
}

/// A ball of 20 · 4^levels triangles that shine.
fn mesh_lamp(levels: u32) -> CompiledScene {
    built(Scene::builder("mesh lamp").material("lamp", lamp(1.0)).mesh(icosphere(levels), "lamp"))
}

fn many_lights() -> CompiledScene {
    CompiledScene::new(&scene("many-lights"))
}

fn worlds() -> Vec<(&'static str, World, DVec3)> {
    let far = DVec3::new(1e6, -2e6, 5e5);
    [
        ("many-lights", many_lights(), DVec3::new(0.0, 3.0, 2.0)),
        ("mixed", mixed(DVec3::ZERO, 300), DVec3::ZERO),
        ("far", mixed(far, 40), far),
        ("coincident", coincident(), DVec3::ZERO),
        ("mesh", mesh_lamp(3), DVec3::ZERO),
    ]
    .map(|(name, scene, center)| (name, World::of(scene), center))
    .into()
}

/// Points near and far, at the centres of lamps and on their surfaces.
fn points(scene: &CompiledScene, center: DVec3, count: usize) -> Vec<Vec3> {
    let mut numbers = Numbers(62);
    let point = |i: usize| {
        let shape = scene.lights[numbers.below(scene.lights.len())].shape;
        let on = match scene.shape_index(shape) {
            ShapeIndex::Sphere(i) => {
                scene.spheres[i].center
                    + scene.spheres[i].radius * [numbers.direction().as_vec3(), Vec3::ZERO][numbers.below(2)]
            }
            ShapeIndex::Quad(i) => scene.quads[i].corner + 0.5 * scene.quads[i].e1,
            ShapeIndex::Triangle(i) => scene.triangles[i].a,
        };
        let away = numbers.direction() * numbers.of_any_size(1e-3, 1e5);
        [on, (center + away).as_vec3(), (center + numbers.in_box(10.0)).as_vec3()][i % 3]
    };
    (0..count).map(point).collect()
}

/// Everywhere, each light has a probability and all together have 1, within 16 roundings for each cluster summed.
#[test]
fn probabilities_of_all_lights_add_up_to_one_and_none_is_zero() {
    for (name, world, center) in worlds() {
        let (worst, count) = (Worst::default(), world.scene.lights.len());
        for point in points(&world.scene, center, 30_000 / count) {
            let of = |light| probability_in_tree(&world.scene, point, light);
            let all: Vec<f32> = (0..count as u32).map(of).collect();
            let least = all.iter().copied().fold(1.0, f32::min);
            assert!(least > 0.0 && all.iter().all(|p| p.is_finite()), "{name}: {point}: {least}");
            let sum: f64 = all.iter().map(|&p| f64::from(p)).sum();
            assert!(worst.see((sum - 1.0).abs()) < 16.0 * 16.0 * 6e-8, "{name}: {point}: {sum}");
        }
        println!("{name}: {:.1e} off", worst.get());
    }
}

/// What is chosen by numbers (b) at a.xyz for a surface of normal c, and how likely light a.w is there.
const ASK: (&str, &str) = (
    "import package::transport::light_tree::{choose_in_tree, probability_in_tree};",
    "let origin = bitcast<vec3<f32>>(a.xyz);
    let choice = choose_in_tree(origin, bitcast<vec3<f32>>(c.xyz), bitcast<vec2<f32>>(b.xy));
    let other = probability_in_tree(origin, a.w);
    out0 = vec4<u32>(choice.light, bitcast<vec3<u32>>(vec3<f32>(choice.probability, choice.weighing, other)));",
);

fn ask(world: &World, [a, b, c]: &[Row; 3]) -> [Row; 1] {
    let origin = floats(*a).0;
    let [x, y, ..] = b.map(f32::from_bits);
    let choice = choose_in_tree(&world.scene, origin, floats(*c).0, glam::Vec2::new(x, y));
    let other = probability_in_tree(&world.scene, origin, a[3]);
    [[choice.light, choice.probability.to_bits(), choice.weighing.to_bits(), other.to_bits()]]
}

/// Both sides choose the same and think the same of it; and what weighs a choice is what the way up finds, within roundings.
#[test]
fn both_sides_choose_alike_and_the_way_up_finds_what_the_way_down_did() {
    for (name, world, center) in worlds() {
        let twins = Twins::new(&world, ASK, ask);
        let mut numbers = Numbers(63);
        let count = world.scene.lights.len();
        let questions: Vec<[Row; 3]> = points(&world.scene, center, 3000)
            .into_iter()
            .map(|point| {
                let normal = numbers.direction() * [0.0, 1.0, 1.0][numbers.below(3)];
                let mut number = || (numbers.below(1 << 24) as f32 / 16_777_216.0).to_bits();
                let u = [number(), number(), 0, 0];
                [row(point, numbers.below(count) as u32), u, row(normal.as_vec3(), 0)]
            })
            .collect();
        let cpu = twins.answer(Side::Cpu, &questions);
        let gpu = twins.answer(Side::Gpu, &questions);
        let (apart, upwards) = (Worst::default(), Worst::default());
        let off = |a: u32, b: u32| {
            let (a, b) = (f64::from(f32::from_bits(a)), f64::from(f32::from_bits(b)));
            (a - b).abs() / a.max(b)
        };
        let mut others = 0;
        for ((question, [a]), [b]) in questions.iter().zip(&cpu).zip(&gpu) {
            assert!(apart.see(off(a[3], b[3])) < 1e-4, "{name}: {question:?}: {a:?} {b:?}");
            let up = probability_in_tree(&world.scene, floats(question[0]).0, a[0]);
            assert!(upwards.see(off(a[2], up.to_bits())) < 1e-5, "{name}: {question:?}");
            if a[0] != b[0] {
                others += 1;
                continue;
            }
            assert!(off(a[1], b[1]).max(off(a[2], b[2])) < 1e-4, "{name}: {question:?}: {a:?} {b:?}");
        }
        println!("{name}: {:.1e} apart, {:.1e} up, {others} chosen otherwise", apart.get(), upwards.get());
        // Numbers that fall within rounding of a boundary; none where both sides compute to the letter.
        assert!(others <= if twins.compute_to_the_letter() { 3 } else { 30 }, "{name}: {others}");
    }
}

/// How likely a light is chosen for a surface, in f64: of a node's clusters each by what it sends, or all evenly once in 128.
fn facing_probability(scene: &CompiledScene, point: Vec3, normal: Vec3, light: u32) -> f64 {
    let clusters = &scene.light_tree.as_ref().unwrap().clusters;
    let mut at = scene.lights[light as usize].cluster as usize;
    let mut probability = 1.0;
    while at != 0 {
        let above = clusters[at].above;
        let siblings: Vec<_> = (0..clusters.len()).filter(|&i| clusters[i].above == above).collect();
        let sent = |i: usize| f64::from(importance(point, normal, &clusters[i]).facing);
        let total: f64 = siblings.iter().map(|&i| sent(i)).sum();
        probability *= 1.0 / 128.0 / siblings.len() as f64 + 127.0 / 128.0 * sent(at) / total;
        at = above as usize;
    }
    probability
}

/// The program's own numbers choose each light as often as its probability says, of the point and of a surface there, and say so.
/// α = 1e-4 each side and case.
#[test]
fn the_tree_chooses_lights_as_often_as_their_probabilities_say() {
    let choose = (
        format!("{DRAW_IMPORTS} import package::transport::light_tree::choose_in_tree;"),
        format!(
            "{DRAW} let choice = choose_in_tree(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz), u.xw);
            out0 = vec4<u32>(choice.light, bitcast<u32>(choice.probability), 0u, 0u);"
        ),
    );
    let cpu = |world: &World, [a, b]: &[Row; 2]| {
        let choice = choose_in_tree(&world.scene, floats(*a).0, floats(*b).0, draw(a[3]).xw());
        [[choice.light, choice.probability.to_bits(), 0, 0]]
    };
    let n = 1 << 17;
    let cases = [
        (many_lights(), Vec3::new(0.3, 0.01, 2.0), Vec3::Y),
        (many_lights(), Vec3::new(0.3, 1.5, 2.0), Vec3::ZERO),
        (mixed(DVec3::ZERO, 300), Vec3::ONE, Vec3::X),
        (mesh_lamp(4), Vec3::new(1.2, 0.1, 0.2), Vec3::ZERO),
        (mesh_lamp(4), Vec3::ZERO, Vec3::ZERO),
    ];
    for (scene, point, normal) in cases {
        let world = World::of(scene);
        let twins = Twins::new(&world, (&choose.0, &choose.1), cpu);
        let questions: Vec<_> = (0..n).map(|i| [row(point, i), row(normal, 0)]).collect();
        for side in SIDES {
            let count = world.scene.lights.len();
            let mut observed = vec![0u64; count];
            let told: Vec<f64> = (0..count as u32)
                .map(|light| facing_probability(&world.scene, point, normal, light))
                .collect();
            for [answer] in twins.answer(side, &questions) {
                let light = answer[0] as usize;
                observed[light] += 1;
                let off = f64::from(f32::from_bits(answer[1])) / told[light] - 1.0;
                assert!(off.abs() < 1e-4, "{side:?}: light {light} at {point} for {normal}: {off:e} off");
            }
            let expected: Vec<f64> = told.iter().map(|p| p * f64::from(n)).collect();
            let p = chi2_test(&observed, &expected).unwrap().p_value;
            assert!(p > ALPHA, "{side:?}: {p:e} at {point} for {normal}, {count} lights");
            // Negative control: every other light has 15 % less than it should.
            let askew: Vec<f64> = expected.iter().enumerate().map(|(i, e)| e * [0.85, 1.15][i % 2]).collect();
            assert!(chi2_test(&observed, &askew).unwrap().p_value < WRONG, "{side:?} at {point}");
        }
    }
}

/// Corners of a light, or points around it that hold a sphere; and the normal of its bright side, None if it shines all around.
fn outline(scene: &CompiledScene, light: u32) -> (Vec<DVec3>, Option<DVec3>) {
    match scene.shape_index(scene.lights[light as usize].shape) {
        ShapeIndex::Sphere(i) => {
            let (center, radius) = (scene.spheres[i].center.as_dvec3(), f64::from(scene.spheres[i].radius));
            let around = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| axis * radius);
            (around.into_iter().flat_map(|v| [center + v, center - v]).collect(), None)
        }
        ShapeIndex::Quad(i) => {
            let quad = &scene.quads[i];
            let [corner, e1, e2] = [quad.corner, quad.e1, quad.e2].map(|v| v.as_dvec3());
            (vec![corner, corner + e1, corner + e2, corner + e1 + e2], Some(e1.cross(e2).normalize()))
        }
        ShapeIndex::Triangle(i) => {
            let t = &scene.triangles[i];
            (
                [t.a, t.b, t.c].map(|v| v.as_dvec3()).into(),
                Some(double_area(t.a, t.b, t.c).as_dvec3().normalize()),
            )
        }
    }
}

/// From a light up to the root: balls hold its corners, cones its normal within 1e-5 (whose cosines a bound leaves 2e-3 for), and
/// what is sent is not told too small by the angles at the lamp and at the surface.
#[test]
fn clusters_bound_every_light_below_them() {
    for (name, world, center) in worlds() {
        let scene = &world.scene;
        let clusters = &scene.light_tree.as_ref().unwrap().clusters;
        let inner = clusters.iter().filter(|c| c.inside & LIGHT == 0).count();
        assert_eq!(clusters.len() - inner, scene.lights.len(), "{name}");
        assert!(inner <= 1 + scene.lights.len() / 4, "{name}: {inner} nodes");
        let mut numbers = Numbers(64);
        let points = points(scene, center, 64);
        for light in 0..scene.lights.len() as u32 {
            let (corners, normal) = outline(scene, light);
            let mut at = scene.lights[light as usize].cluster;
            assert_eq!(clusters[at as usize].inside, LIGHT | light);
            while at != NONE {
                let cluster = &clusters[at as usize];
                for corner in &corners {
                    let reach = corner.distance(cluster.center.as_dvec3());
                    assert!(reach <= f64::from(cluster.radius), "{name}: {light} sticks out of {cluster:?}");
                }
                let axis = cluster.axis.as_dvec3();
                let spread = f64::from(cluster.sin_cone).atan2(cluster.cos_cone.into());
                let turned = normal.map_or(std::f64::consts::PI, |n| n.angle_between(axis));
                assert!(turned <= spread + 1e-5, "{name}: {light} faces out of {cluster:?}");
                let (point, facing) = (points[numbers.below(64)], numbers.direction());
                let told = importance(point, facing.as_vec3(), cluster);
                let to = corners[numbers.below(corners.len())] - point.as_dvec3();
                if to.length() > 1e-6 * (1.0 + point.length() as f64) {
                    let wi = to.normalize();
                    let sent = normal.map_or(1.0, |n| -n.dot(wi)).max(0.0);
                    let distance2 = (cluster.center - point).length_squared().max(cluster.radius.powi(2));
                    let scale = f64::from(distance2 / cluster.strength);
                    let slack = 4e-3;
                    assert!(
                        f64::from(told.anywhere) * scale > sent - slack,
                        "{name}: {light} in {cluster:?}"
                    );
                    let arrives = sent * wi.dot(facing).max(0.0);
                    assert!(f64::from(told.facing) * scale > arrives - slack, "{name}: {light} {cluster:?}");
                }
                at = cluster.above;
            }
        }
        println!("{name}: {} clusters for {} lights", clusters.len(), scene.lights.len());
    }
    const { assert!(MOST_CLUSTERS <= 16, "more do not fit beside the number of the first") };
}

/// What is not flat, or shines behind: a sliver whose normal f32 does not know has a cone that is all around.
#[test]
fn a_sliver_is_bounded_all_around() {
    let sliver = |i: usize| {
        let x = i as f64;
        [DVec3::new(x, 0.0, 0.0), DVec3::new(x + 1.0, 1e-9, 0.0), DVec3::new(x + 2.0, 0.0, 3e-8)]
    };
    let positions: Vec<DVec3> = (0..20).flat_map(sliver).collect();
    let triangles = (0..20).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let mesh = qtracer::scene::MeshData { positions, normals: Vec::new(), uvs: Vec::new(), triangles };
    let scene = built(Scene::builder("slivers").material("lamp", lamp(1.0)).mesh(mesh, "lamp"));
    let tree = scene.light_tree.unwrap();
    assert!(tree.clusters.iter().all(|c| c.cos_cone == -1.0), "{:?}", tree.clusters);
}

/// Few lights have no tree, and many take less than 64 bytes each.
#[test]
fn trees_are_built_where_lights_are_many() {
    assert!(CompiledScene::new(&scene("cornell-box")).light_tree.is_none());
    for levels in [2, 4] {
        let scene = mesh_lamp(levels);
        let tree = scene.light_tree.as_ref().unwrap();
        let bytes = size_of_val(&tree.clusters[..]) as f64 / scene.lights.len() as f64;
        println!("{} triangles: {bytes:.1} bytes a lamp", scene.lights.len());
        assert!(bytes < 64.0);
    }
}

/// Seconds are the machine's; that they grow about as the number of lamps is the program's. 64 times as many took 61 times as
/// long on two idle cores; a step that asked all lamps for each would take 4096 times as long.
#[test]
#[ignore = "long: a million lamps; tests/run --long"]
fn building_a_tree_takes_time_about_as_the_number_of_lamps() {
    let [few, many] = [5, 8].map(|levels| {
        let mut scene = mesh_lamp(levels);
        let again = qtracer::scene::light_tree::LightTree::new(&mut scene);
        let first = scene.light_tree.as_ref().unwrap();
        assert_eq!(again.clusters, first.clusters, "threads make no difference");
        let seconds = again.seconds.min(first.seconds);
        println!("{} triangles: {seconds:.3} s", scene.lights.len());
        seconds
    });
    assert!(many < 200.0 * few, "{many} s against {few} s");
}
