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
        // What a cluster just above the horizon sends is a difference, which adapters that fuse products round otherwise.
        let most = if twins.compute_to_the_letter() { 1e-4 } else { 0.03 };
        let mut others = 0;
        for ((question, [a]), [b]) in questions.iter().zip(&cpu).zip(&gpu) {
            assert!(apart.see(off(a[3], b[3])) < most, "{name}: {question:?}: {a:?} {b:?}");
            let up = probability_in_tree(&world.scene, floats(question[0]).0, a[0]);
            assert!(upwards.see(off(a[2], up.to_bits())) < 1e-5, "{name}: {question:?}");
            if a[0] != b[0] {
                others += 1;
                continue;
            }
            assert!(off(a[1], b[1]).max(off(a[2], b[2])) < most, "{name}: {question:?}: {a:?} {b:?}");
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
                let most = if twins.compute_to_the_letter() { 1e-4 } else { 0.03 };
                assert!(off.abs() < most, "{side:?}: light {light} at {point} for {normal}: {off:e} off");
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

/// Points spread evenly over a light with the normals of its bright side, and radiance × area as noise counts it.
fn surface_points(scene: &CompiledScene, light: u32, rows: u32) -> (Vec<(DVec3, DVec3)>, f64) {
    let light = &scene.lights[light as usize];
    let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(rows);
    let grid = (0..rows).flat_map(|i| (0..rows).map(move |j| (middle(i), middle(j))));
    let flat = |corner: Vec3, (e1, e2): (DVec3, DVec3), normal: DVec3, folded: bool| {
        let at = |(u, v): (f64, f64)| {
            let (u, v) = if folded { (u.sqrt() * (1.0 - v), u.sqrt() * v) } else { (u, v) };
            (corner.as_dvec3() + e1 * u + e2 * v, normal)
        };
        grid.clone().map(at).collect()
    };
    let (points, area): (Vec<_>, f64) = match scene.shape_index(light.shape) {
        ShapeIndex::Sphere(i) => {
            let sphere = &scene.spheres[i];
            let (center, radius) = (sphere.center.as_dvec3(), f64::from(sphere.radius));
            let bright = if sphere.inward != 0 { -1.0 } else { 1.0 };
            let at = |(u, v): (f64, f64)| {
                let (z, angle) = (2.0 * u - 1.0, std::f64::consts::TAU * v);
                let n = DVec3::new(angle.cos(), angle.sin(), 0.0) * (1.0 - z * z).sqrt() + DVec3::Z * z;
                (center + radius * n, bright * n)
            };
            (grid.clone().map(at).collect(), 4.0 * std::f64::consts::PI * radius * radius)
        }
        ShapeIndex::Quad(i) => {
            let quad = &scene.quads[i];
            let sides = (quad.e1.as_dvec3(), quad.e2.as_dvec3());
            let across = sides.0.cross(sides.1);
            (flat(quad.corner, sides, across.normalize(), false), across.length())
        }
        ShapeIndex::Triangle(i) => {
            let t = &scene.triangles[i];
            let sides = ((t.b - t.a).as_dvec3(), (t.c - t.a).as_dvec3());
            let across = double_area(t.a, t.b, t.c).as_dvec3();
            (flat(t.a, sides, across.normalize(), true), 0.5 * across.length())
        }
    };
    (points, scene.materials[light.material as usize].emission.as_dvec3().length() * area)
}

/// Points of all lights below each cluster, each with its share of the strength of all.
fn below(scene: &CompiledScene, rows: u32) -> Vec<Vec<(DVec3, DVec3, f64)>> {
    let clusters = &scene.light_tree.as_ref().unwrap().clusters;
    let mut below = vec![Vec::new(); clusters.len()];
    let lights: Vec<_> = (0..scene.lights.len() as u32).map(|i| surface_points(scene, i, rows)).collect();
    let total: f64 = lights.iter().map(|(_, strength)| strength).sum();
    for (light, (points, strength)) in lights.iter().enumerate() {
        let mut at = scene.lights[light].cluster;
        assert_eq!(clusters[at as usize].inside, LIGHT | light as u32);
        let weight = (strength / total).max(1e-12) / points.len() as f64;
        while at != NONE {
            below[at as usize].extend(points.iter().map(|&(p, n)| (p, n, weight)));
            at = clusters[at as usize].above;
        }
    }
    below
}

/// From each light up to the root: strength, centre, normal and deviation are those of 144 points on each light, within what
/// these leave out of a light (2 % of the deviation) and what f32 leaves of coordinates.
#[test]
fn clusters_know_the_moments_of_the_lights_below_them() {
    for (name, world, _) in worlds() {
        let scene = &world.scene;
        let clusters = &scene.light_tree.as_ref().unwrap().clusters;
        let inner = clusters.iter().filter(|c| c.inside & LIGHT == 0).count();
        assert_eq!(clusters.len() - inner, scene.lights.len(), "{name}");
        assert!(inner <= 1 + scene.lights.len() / 4, "{name}: {inner} nodes");
        let [strengths, centers, normals, deviations] = [(); 4].map(|_| Worst::default());
        for (cluster, points) in clusters.iter().zip(below(scene, 12)) {
            let strength: f64 = points.iter().map(|p| p.2).sum();
            let mean = |of: &dyn Fn(DVec3, DVec3) -> DVec3| {
                points.iter().map(|&(p, n, weight)| weight / strength * of(p, n)).sum::<DVec3>()
            };
            let center = mean(&|p, _| p);
            let deviation = mean(&|p, _| (p - center) * (p - center)).map(f64::sqrt);
            let slack = 0.02 * deviation.length() + 1e-6 * center.length();
            assert!(strengths.see((f64::from(cluster.strength) / strength - 1.0).abs()) < 1e-5, "{name}");
            let off = centers.see(center.distance(cluster.center.as_dvec3()) / slack);
            assert!(off < 1.0, "{name}: {center} for {cluster:?}");
            let off = normals.see(mean(&|_, n| n).distance(cluster.normal.as_dvec3()));
            assert!(off < 0.01, "{name}: {:?} for {cluster:?}", mean(&|_, n| n));
            let off = deviations.see(deviation.distance(cluster.deviation.as_dvec3()) / slack);
            assert!(off < 1.0, "{name}: {deviation} for {cluster:?}");
        }
        let worst = [strengths, centers, normals, deviations].map(|w| w.get());
        println!("{name}: {} clusters, {} lights, worst {worst:?}", clusters.len(), scene.lights.len());
    }
    const { assert!(MOST_CLUSTERS <= 16, "more do not fit beside the number of the first") };
}

/// What is told of a cluster against the sum over 36 points on each light below it, from three deviations away or more, where
/// it sends a tenth of what it could straight ahead: within a seventh of a light, within a factor of 2.7 of many, and of half of
/// both within 3 %. No estimate that forgets a cosine or a square would be.
#[test]
fn what_clusters_send_is_about_what_the_lights_below_them_do() {
    for (name, world, center) in worlds() {
        let scene = &world.scene;
        let clusters = &scene.light_tree.as_ref().unwrap().clusters;
        let points = points(scene, center, 64);
        let mut numbers = Numbers(64);
        let mut ratios: [Vec<f64>; 2] = Default::default();
        for (cluster, below) in clusters.iter().zip(below(scene, 6)) {
            for _ in 0..4 {
                let point = points[numbers.below(64)];
                let away = (cluster.center - point).length();
                if away < 3.0 * cluster.deviation.length() || away < 1e-5 * point.length() {
                    continue;
                }
                let normal = numbers.direction();
                let told = importance(point, normal.as_vec3(), cluster);
                let sent = |facing: bool| {
                    let one = |&(p, n, weight): &(DVec3, DVec3, f64)| {
                        let to = p - point.as_dvec3();
                        let wi = to.normalize();
                        let arriving = if facing { wi.dot(normal).max(0.0) } else { 1.0 };
                        weight * (-n.dot(wi)).max(0.0) * arriving / to.length_squared()
                    };
                    below.iter().map(one).sum::<f64>()
                };
                for (told, sent) in [(told.anywhere, sent(false)), (told.facing, sent(true))] {
                    if sent > 0.1 * f64::from(cluster.strength / (away * away)) {
                        ratios[usize::from(cluster.inside & LIGHT == 0)].push(f64::from(told) / sent);
                    }
                }
            }
        }
        for (ratios, factor) in ratios.iter_mut().zip([1.14, 2.7]).filter(|(ratios, _)| !ratios.is_empty()) {
            ratios.sort_by(f64::total_cmp);
            let (n, least, most) = (ratios.len(), ratios[0], ratios[ratios.len() - 1]);
            let (low, high) = (ratios[n / 4], ratios[n - 1 - n / 4]);
            println!(
                "{name}: {n} told {least:.3} to {most:.3} times what is sent, half {low:.3} to {high:.3}"
            );
            assert!(least > 1.0 / factor && most < factor, "{name}: {least} to {most}");
            assert!(low > 1.0 / 1.03 && high < 1.03, "{name}: half of {n} from {low} to {high}");
        }
    }
}

/// A sliver whose normal f32 does not know may face anywhere.
#[test]
fn a_sliver_may_face_anywhere() {
    let sliver = |i: usize| {
        let x = i as f64;
        [DVec3::new(x, 0.0, 0.0), DVec3::new(x + 1.0, 1e-9, 0.0), DVec3::new(x + 2.0, 0.0, 3e-8)]
    };
    let positions: Vec<DVec3> = (0..20).flat_map(sliver).collect();
    let triangles = (0..20).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let mesh = qtracer::scene::MeshData { positions, normals: Vec::new(), uvs: Vec::new(), triangles };
    let scene = built(Scene::builder("slivers").material("lamp", lamp(1.0)).mesh(mesh, "lamp"));
    let tree = scene.light_tree.unwrap();
    assert!(tree.clusters.iter().all(|c| c.normal == Vec3::ZERO), "{:?}", tree.clusters);
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
