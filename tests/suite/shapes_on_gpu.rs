//! Intersection and leaving of shapes, by the kernels themselves on the adapter under test, against geometry in f64.
//! `cargo test … -- --nocapture` shows the worst errors measured, which docs/ACCURACY.md lists.

use crate::probe::{Input, Numbers, Probe, floats, row};
use crate::support::{estimators, open_gpu};
use glam::{DVec3, Vec3};
use qtracer::gpu::device::Gpu;
use qtracer::gpu::key::{KernelKey, SmallScene};
use qtracer::guiding::GuideMode;
use qtracer::scene::bvh::{Bvh, NODE_ROWS};
use qtracer::scene::compiled::{CompiledScene, Material, NONE, Quad, ShapeIndex, Sphere};
use qtracer::scene::rows::{self, Row};
use qtracer::scene::shapes::{RELATIVE_OFFSET, T_MISS};
use qtracer::scene::{Camera, Material as SceneMaterial, Scene, SceneBuilder};
use qtracer::transport::roulette::Roulette;
use wgpu::BufferUsages;

/// Half the distance of 1 from the next number: the relative error of one operation.
const ROUNDING: f64 = f32::EPSILON as f64 / 2.0;

fn key(scene: &CompiledScene) -> KernelKey {
    KernelKey::new(scene, &estimators(GuideMode::Off, Roulette::Off))
}

/// Asks a probe that reads shapes of this scene.
fn ask<const Q: usize, const A: usize>(
    gpu: &Gpu,
    probe: &Probe<Q, A>,
    scene: &CompiledScene,
    hot: &[Row],
    questions: &[[Row; Q]],
) -> Vec<[Row; A]> {
    // Any: no test looks through it.
    let camera = Camera {
        origin: DVec3::ZERO,
        target: DVec3::NEG_Z,
        up: DVec3::Y,
        fov_y_deg: 45.0,
        width: 1,
        height: 1,
    };
    let uniforms = scene.uniforms(&camera, 1, 1, 0);
    let packed = rows::pack(scene);
    let inputs: [Input<'_>; 3] = [
        ("uniforms", bytemuck::bytes_of(&uniforms), BufferUsages::UNIFORM),
        ("scene_rows", bytemuck::cast_slice(&packed), BufferUsages::STORAGE),
        ("hot_rows", bytemuck::cast_slice(hot), BufferUsages::UNIFORM),
    ];
    probe.ask(gpu, &inputs, questions)
}

/// A unit vector in single precision: what a ray's direction is.
fn unit(v: DVec3) -> Vec3 {
    v.normalize().as_vec3()
}

/// A unit vector at right angles to `n`.
fn tangent(numbers: &mut Numbers, n: DVec3) -> DVec3 {
    let d = numbers.direction();
    (d - n * d.dot(n)).normalize()
}

// Spheres

/// Spheres of these radii anywhere within 1e4 of the origin. Left out are those smaller than ten spawn offsets: f32 does not
/// tell points on them apart.
fn some_spheres(count: usize) -> CompiledScene {
    let mut numbers = Numbers(1);
    let sphere = |_| loop {
        let center = (numbers.direction() * numbers.of_any_size(1e-3, 1e4)).as_vec3();
        let radius = numbers.of_any_size(1e-3, 1e5) as f32;
        if radius > 10.0 * RELATIVE_OFFSET * center.abs().max_element() {
            return Sphere { center, radius, light: NONE, ..Default::default() };
        }
    };
    let spheres = (0..count).map(sphere).collect();
    CompiledScene { spheres, materials: vec![Material::default()], ..Default::default() }
}

/// Where the line of a ray meets a sphere, in f64: middle and half length of the chord, which is NaN if there is none.
fn chord(origin: Vec3, direction: Vec3, center: Vec3, radius: f64) -> (f64, f64) {
    let (f, d) = (origin.as_dvec3() - center.as_dvec3(), direction.as_dvec3());
    let length = d.length();
    let middle = -f.dot(d) / (length * length);
    let approach = f + d * middle;
    (middle, (radius * radius - approach.length_squared()).sqrt() / length)
}

/// How far the point at `t` lies off the sphere.
fn residual(origin: Vec3, direction: Vec3, t: f32, sphere: &Sphere) -> f64 {
    let p = origin.as_dvec3() + direction.as_dvec3() * f64::from(t) - sphere.center.as_dvec3();
    (p.length() - f64::from(sphere.radius)).abs()
}

const SURFACE: (&str, &str) = (
    "import package::scene::data::sphere_at;
    import package::scene::shapes::{Hit, Ray, Surface, intersect_sphere, refine_sphere_distance, surface_at};",
    "let ray = Ray(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz));
    let sphere = sphere_at(a.w);
    let raw = intersect_sphere(ray, sphere.center, sphere.radius * sphere.radius);
    let t = refine_sphere_distance(ray, sphere.center, sphere.radius, raw);
    let surface = surface_at(ray, Hit(t, a.w));
    out0 = vec4<u32>(bitcast<vec3<u32>>(surface.position), bitcast<u32>(t));
    out1 = vec4<u32>(bitcast<vec3<u32>>(surface.normal), bitcast<u32>(surface.offset));
    out2.x = bitcast<u32>(raw);",
);
const SPAWN: (&str, &str) = (
    "import package::scene::data::sphere_at;
    import package::scene::shapes::{Surface, intersect_sphere, refine_sphere_distance, spawn_ray};",
    "let surface = Surface(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz), bitcast<f32>(b.w));
    let ray = spawn_ray(surface, bitcast<vec3<f32>>(c.xyz));
    let sphere = sphere_at(a.w);
    let raw = intersect_sphere(ray, sphere.center, sphere.radius * sphere.radius);
    let t = select(raw, refine_sphere_distance(ray, sphere.center, sphere.radius, raw), raw < 3.0e38);
    out0 = vec4<u32>(bitcast<vec3<u32>>(ray.origin), bitcast<u32>(t));",
);

/// What rays did that left spheres.
#[derive(Debug, Default)]
struct Left {
    outwards: u32,
    inwards: u32,
    /// Rays that started on the wrong side, met what they left, or missed the far side.
    wrong: u32,
    /// Worst distance of a hit on the far side from the sphere, in spawn offsets.
    worst_residual: f64,
    /// Worst relative error of the distance to the far side, where the cosine is above 0.1, and of all.
    worst_distance: [f64; 2],
    /// Worst relative deviation of a start's height over the sphere from the offset.
    worst_height: f64,
    /// Worst distance of a hit point from the sphere, in offsets.
    worst_point: f64,
}

impl Left {
    /// `count` rays that leave spheres from offsets `scale` times the used ones, one half outwards, cosines from 1e-7.
    fn add(&mut self, gpu: &Gpu, seed: u64, count: usize, scale: f32) {
        let scene = some_spheres(4096);
        let surface = Probe::<2, 3>::new(gpu, &key(&scene), SURFACE.0, SURFACE.1);
        let spawn = Probe::<3, 1>::new(gpu, &key(&scene), SPAWN.0, SPAWN.1);
        let mut numbers = Numbers(seed);
        let first_ray = |i: usize| {
            let Sphere { center, radius, .. } = scene.spheres[i % scene.spheres.len()];
            let (center, radius) = (center.as_dvec3(), f64::from(radius));
            let away = [numbers.between(0.0, 0.99), numbers.of_any_size(1.01, 1e3)][numbers.below(2)];
            let origin = (center + numbers.direction() * radius * away).as_vec3();
            let target = center + numbers.direction() * radius * 0.999;
            [row(origin, (i % scene.spheres.len()) as u32), row(unit(target - origin.as_dvec3()), 0)]
        };
        let rays: Vec<_> = (0..count).map(first_ray).collect();
        let surfaces = ask(gpu, &surface, &scene, &[], &rays);
        let leave = |([a, _], [point, normal, _]): (&[Row; 2], &[Row; 3])| {
            let (n, offset) = floats(*normal);
            let n = n.as_dvec3().normalize();
            let cos = numbers.sign() * numbers.of_any_size(1e-7, 1.0);
            let direction = unit(n * cos + tangent(&mut numbers, n) * (1.0 - cos * cos).sqrt());
            [
                row(floats(*point).0, a[3]),
                row(floats(*normal).0, (offset * scale).to_bits()),
                row(direction, 0),
            ]
        };
        let leaving: Vec<_> = rays.iter().zip(&surfaces).map(leave).collect();
        for (question, answer) in leaving.iter().zip(ask(gpu, &spawn, &scene, &[], &leaving)) {
            self.judge(&scene.spheres[question[0][3] as usize], question, answer[0]);
        }
    }

    fn judge(&mut self, sphere: &Sphere, [point, normal, direction]: &[Row; 3], answer: Row) {
        let (origin, t) = floats(answer);
        let ((n, offset), direction) = (floats(*normal), floats(*direction).0);
        let offset = f64::from(offset).max(f64::MIN_POSITIVE);
        let radius = f64::from(sphere.radius);
        let height = (origin.as_dvec3() - sphere.center.as_dvec3()).length() - radius;
        let cos = n.as_dvec3().dot(direction.as_dvec3());
        self.worst_point = self.worst_point.max(residual(floats(*point).0, n, 0.0, sphere) / offset);
        self.worst_height = self.worst_height.max((height.abs() / offset - 1.0).abs());
        // The kernel's cosine has the error of three products.
        let right_side = (height > 0.0) == (cos >= 0.0) || cos.abs() < 3.0 * ROUNDING;
        if height > 0.0 {
            self.outwards += 1;
            self.wrong += u32::from(!right_side || t < T_MISS);
            return;
        }
        self.inwards += 1;
        let (middle, half) = chord(origin, direction, sphere.center, radius);
        let off = residual(origin, direction, t, sphere) / offset;
        if !right_side || t >= T_MISS || f64::from(t) <= middle || off > 1.0 {
            self.wrong += 1;
            return;
        }
        let error = (f64::from(t) / (middle + half) - 1.0).abs();
        self.worst_residual = self.worst_residual.max(off);
        self.worst_distance[0] = self.worst_distance[0].max(if cos < -0.1 { error } else { 0.0 });
        self.worst_distance[1] = self.worst_distance[1].max(error);
    }
}

/// Rays that leave a sphere outwards never meet it again; those that leave it inwards meet its far side, at a point less
/// than half an offset off the sphere. However grazing.
fn rays_leave_spheres(batches: u64) {
    const BATCH: usize = 1 << 20;
    let gpu = open_gpu();
    let mut left = Left::default();
    for seed in 0..batches {
        left.add(&gpu, 100 + seed, BATCH, 1.0);
    }
    println!("{left:?}");
    assert!(u64::from(left.outwards.min(left.inwards)) > batches * BATCH as u64 / 3);
    assert_eq!(left.wrong, 0, "{left:?}");
    assert!(left.worst_residual < 0.5 && left.worst_point < 0.5 && left.worst_height < 0.5, "{left:?}");
    // Negative control: without an offset, and with a sixteenth of it, rays are lost.
    for scale in [0.0, 1.0 / 16.0] {
        let mut lost = Left::default();
        lost.add(&gpu, 99, BATCH / 16, scale);
        assert!(lost.wrong > 100, "{scale}: {lost:?}");
    }
}

#[test]
fn rays_that_leave_a_sphere_outwards_never_meet_it_and_those_inwards_meet_its_far_side() {
    rays_leave_spheres(1);
}

#[test]
#[ignore = "long: 100 million rays; tests/run --long"]
fn a_hundred_million_rays_leave_spheres_rightly() {
    rays_leave_spheres(96);
}

/// What rays from elsewhere found of spheres.
#[derive(Debug, Default)]
struct Found {
    hits: u32,
    misses: u32,
    /// Missed spheres, spheres met where there are none, and far sides taken for near ones.
    wrong: u32,
    /// Worst distance of a hit from the sphere, in roundings of the ray's distance from the centre plus the radius.
    worst_residual: f64,
    /// Worst relative error of the distance from two radii and farther, where the ray passes the centre within 0.9 radii.
    worst_from_afar: f64,
    /// Error of distances of which b ± root cancels half or more, refined and before, in roundings of the radius, for cosines
    /// above 0.3: the worst, and the sum.
    worst_from_nearby: [f64; 2],
    sum_from_nearby: [f64; 2],
    nearby: u32,
}

/// How many roundings of (distance + radius) off the sphere a hit may lie.
const SPHERE_BOUND: f64 = 8.0;

fn seen_ray(numbers: &mut Numbers, sphere: &Sphere) -> (Vec3, Vec3) {
    let (center, radius) = (sphere.center.as_dvec3(), f64::from(sphere.radius));
    let away = match numbers.below(5) {
        0 => numbers.between(0.0, 1.0),
        4 => 1.0 - numbers.of_any_size(1e-6, 1.0),
        1 => 1.0 + numbers.of_any_size(1e-6, 1.0),
        2 => numbers.of_any_size(2.0, 1e3),
        _ => numbers.of_any_size(1e3, 1e7),
    };
    let outward = numbers.direction();
    let origin = (center + outward * radius * away).as_vec3();
    // Where the line passes the centre, in radii: anywhere, or within 1e-7 to 1e-2 of the edge.
    let pass = match numbers.below(3) {
        0 => 1.0 + numbers.sign() * numbers.of_any_size(1e-7, 1e-2),
        _ => 1.2 * numbers.between(0.0, 1.0f64).sqrt(),
    };
    let to_center = center - origin.as_dvec3();
    let sin = (pass * radius / to_center.length()).min(1.0);
    let axis = to_center.normalize();
    let direction =
        axis * (1.0 - sin * sin).sqrt() * numbers.sign().max(-0.5).signum() + tangent(numbers, axis) * sin;
    (origin, unit(direction))
}

impl Found {
    fn add(&mut self, gpu: &Gpu, seed: u64, count: usize, moved: f32) {
        let scene = some_spheres(4096);
        let probe = Probe::<2, 3>::new(gpu, &key(&scene), SURFACE.0, SURFACE.1);
        let mut numbers = Numbers(seed);
        let ray = |i: usize| {
            let (origin, direction) = seen_ray(&mut numbers, &scene.spheres[i % 4096]);
            [row(origin, (i % 4096) as u32), row(direction, 0)]
        };
        let rays: Vec<_> = (0..count).map(ray).collect();
        for ([a, b], [hit, _, raw]) in rays.iter().zip(ask(gpu, &probe, &scene, &[], &rays)) {
            let t = floats(hit).1 * (1.0 + moved);
            let raw = f32::from_bits(raw[0]);
            self.judge(&scene.spheres[a[3] as usize], floats(*a).0, floats(*b).0, [t, raw]);
        }
    }

    fn judge(&mut self, sphere: &Sphere, origin: Vec3, direction: Vec3, [t, raw]: [f32; 2]) {
        let radius = f64::from(sphere.radius);
        let distance = (origin.as_dvec3() - sphere.center.as_dvec3()).length();
        let rounding = ROUNDING * (distance + radius);
        let slack = SPHERE_BOUND * rounding;
        let (middle, half) = chord(origin, direction, sphere.center, radius);
        if raw >= T_MISS {
            self.misses += 1;
            // It must not be missed by one who thinks it a little smaller.
            let (_, inner) = chord(origin, direction, sphere.center, (radius - slack).max(0.0));
            let must = inner >= 0.0 && (distance < radius - slack || middle > slack);
            self.wrong += u32::from(must);
            return;
        }
        self.hits += 1;
        let off = residual(origin, direction, t, sphere) / rounding;
        self.worst_residual = self.worst_residual.max(off);
        let far_side = f64::from(t) > middle + slack && distance > radius + slack;
        self.wrong += u32::from(off > SPHERE_BOUND || far_side);
        if half.is_nan() {
            return;
        }
        let exact = if middle > half { middle - half } else { middle + half };
        let error = |t: f32| (f64::from(t) - exact).abs();
        let pass = (1.0 - (half / radius).powi(2)).max(0.0).sqrt();
        if distance > 2.0 * radius && pass < 0.9 {
            self.worst_from_afar = self.worst_from_afar.max(error(t) / exact);
        }
        if exact > 0.0
            && exact < 0.5 * (middle.abs() + half)
            && distance < 2.0 * radius
            && (distance - radius).abs() > slack
            && pass < 0.95
        {
            self.nearby += 1;
            for (i, t) in [t, raw].into_iter().enumerate() {
                let roundings = error(t) / (ROUNDING * radius);
                self.worst_from_nearby[i] = self.worst_from_nearby[i].max(roundings);
                self.sum_from_nearby[i] += roundings;
            }
        }
    }
}

/// Where a ray meets a sphere lies on that sphere to within a few roundings of the ray's distance from it, from a
/// millionth to ten million radii away; spheres are met and missed as geometry says where it is not closer than that.
#[test]
fn distances_to_spheres_are_right_to_a_few_roundings_from_anywhere() {
    let gpu = open_gpu();
    let mut found = Found::default();
    found.add(&gpu, 7, 1 << 20, 0.0);
    println!("{found:?}");
    assert!(found.hits.min(found.misses) > 150_000, "{found:?}");
    assert_eq!(found.wrong, 0, "{found:?}");
    // Negative control: distances a millionth too long.
    let mut wrong = Found::default();
    wrong.add(&gpu, 7, 1 << 16, 1e-6);
    assert!(wrong.wrong > 1000, "{wrong:?}");
}

// Rectangles along axes

fn empty() -> SceneBuilder {
    let builder = Scene::builder("shapes").camera([0.0, 0.0, 1.0], [0.0; 3], 40.0);
    builder.material("m", SceneMaterial::diffuse([0.5; 3]))
}

/// Twenty rectangles at right angles to each axis, of both windings, with sides of both signs.
fn some_rectangles(numbers: &mut Numbers, size: f64) -> CompiledScene {
    let mut builder = empty();
    for i in 0..60 {
        let mut side =
            |axis: usize| DVec3::AXES[axis % 3] * numbers.sign() * size * numbers.of_any_size(1e-2, 1.0);
        let (u, v) = (side(i + 1), side(i + 2));
        let corner = numbers.in_box(size);
        builder = match numbers.below(2) {
            0 => builder.quad(corner, u, v, "m"),
            _ => builder.quad(corner, v, u, "m"),
        };
    }
    let scene = CompiledScene::new(&builder.build().unwrap());
    assert_eq!(scene.aligned, [20; 3]);
    scene
}

const ALIGNED: (&str, &str) = (
    "import package::scene::data::{aligned_counts, aligned_test, quad_at, quad_count, NONE};
    import package::scene::shapes::{Hit, Ray, T_MISS, from_y, from_z, intersect, intersect_aligned, intersect_quad};",
    "let ray = Ray(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz));
    let quad = quad_at(a.w);
    let t = intersect_quad(ray, quad.corner, quad.normal, quad.dual1, quad.dual2);
    var turned = ray;
    if a.w >= aligned_counts().x { turned = from_y(ray); }
    if a.w >= aligned_counts().x + aligned_counts().y { turned = from_z(ray); }
    let brief = intersect_aligned(turned.origin, turned.direction, 1.0 / turned.direction.x, aligned_test(a.w));
    var all = Hit(T_MISS, NONE);
    for (var i = 0u; i < quad_count(); i++) {
        let other = quad_at(i);
        let distance = intersect_quad(ray, other.corner, other.normal, other.dual1, other.dual2);
        if distance < all.t { all = Hit(distance, i); }
    }
    let nearest = intersect(ray);
    out0 = vec4<u32>(bitcast<u32>(t), bitcast<u32>(brief), 0u, 0u);
    out1 = vec4<u32>(bitcast<u32>(all.t), all.shape, bitcast<u32>(nearest.t), nearest.shape);",
);

/// A ray at a rectangle, and whether it is parallel to its plane: to points in it and around it, to its edges, in its plane.
fn ray_at(numbers: &mut Numbers, quad: &Quad, size: f64) -> (Vec3, Vec3, bool) {
    let axis = quad.axis().unwrap();
    let share = |numbers: &mut Numbers| match numbers.below(4) {
        0 => [0.0, 1.0][numbers.below(2)] + numbers.sign() * numbers.of_any_size(1e-8, 1e-3),
        _ => numbers.between(-0.2, 1.2),
    };
    let (a, b) = (share(numbers), share(numbers));
    let target = quad.corner.as_dvec3() + quad.e1.as_dvec3() * a + quad.e2.as_dvec3() * b;
    let mut origin = target + numbers.direction() * size * numbers.of_any_size(1e-3, 10.0);
    let kind = numbers.below(8);
    if kind == 0 {
        origin[axis] = quad.corner[axis].into();
    }
    let origin = origin.as_vec3();
    let mut direction = target - origin.as_dvec3();
    let zero = |numbers: &mut Numbers| 0.0f64.copysign(numbers.sign());
    if kind <= 1 {
        direction[axis] = zero(numbers);
    }
    // One more component, or both others, exactly zero.
    if numbers.below(4) == 0 {
        direction[(axis + 1 + numbers.below(2)) % 3] = zero(numbers);
    }
    if numbers.below(16) == 0 {
        direction = DVec3::from_array([(); 3].map(|()| zero(numbers)));
        direction[numbers.below(3)] = numbers.sign();
    }
    let direction = unit(direction);
    (origin, direction, direction[axis] == 0.0)
}

/// In f64: the distance to the plane of a rectangle, and how far within it the ray passes, as a share of the sides, with the
/// share that `roundings` of the ray's length are.
fn inside(quad: &Quad, origin: Vec3, direction: Vec3, roundings: f64) -> (f64, f64, f64) {
    let [corner, e1, e2] = [quad.corner, quad.e1, quad.e2].map(|v| v.as_dvec3());
    let (f, d, axis) = (origin.as_dvec3() - corner, direction.as_dvec3(), quad.axis().unwrap());
    let t = -f[axis] / d[axis];
    let p = f + d * t;
    let [a, b] = [e1, e2].map(|e| p.dot(e) / e.length_squared());
    let length = f.abs().max_element() + t.abs();
    let share = roundings * ROUNDING * length / e1.length().min(e2.length());
    (t, a.min(1.0 - a).min(b).min(1.0 - b), share)
}

/// What brief tests gave for rectangles.
#[derive(Debug, Default)]
struct Aligned {
    hits: u32,
    parallel: u32,
    /// Hits of rays parallel to the plane, and distances that are none.
    impossible: u32,
    /// Hits and misses unlike those of the general test, or unlike those in f64, away from edges.
    unlike: u32,
    /// … and at edges.
    at_edges: u32,
    /// Nearest shapes that are others than asking all by the general test finds, away from edges.
    other_nearest: u32,
    /// Worst difference from the general test, in numbers between.
    worst_ulps: u32,
    /// Worst error against f64, in roundings of the distance.
    worst_error: f64,
}

impl Aligned {
    fn add(&mut self, gpu: &Gpu, seed: u64, size: f64, count: usize, change: impl Fn(&mut [Row])) {
        let mut numbers = Numbers(seed);
        let scene = some_rectangles(&mut numbers, size);
        let probe = Probe::<2, 2>::new(gpu, &key(&scene), ALIGNED.0, ALIGNED.1);
        let mut hot = rows::hot(&scene);
        change(&mut hot);
        let ray = |i: usize| {
            let (origin, direction, _) = ray_at(&mut numbers, &scene.quads[i % 60], size);
            [row(origin, (i % 60) as u32), row(direction, 0)]
        };
        let rays: Vec<_> = (0..count).map(ray).collect();
        for ([a, b], [one, [all_t, all, near_t, near]]) in
            rays.iter().zip(ask(gpu, &probe, &scene, &hot, &rays))
        {
            let (origin, direction) = (floats(*a).0, floats(*b).0);
            self.judge(&scene.quads[a[3] as usize], origin, direction, [one[0], one[1]].map(f32::from_bits));
            let at_edge = |shape: u32| {
                scene.quads.get(shape as usize).is_some_and(|quad| {
                    let (_, within, share) = inside(quad, origin, direction, 4.0);
                    within.abs() < 1e-6 + share
                })
            };
            let same = all == near && all_t.abs_diff(near_t) <= 2;
            self.other_nearest += u32::from(!same && !at_edge(all) && !at_edge(near));
        }
    }

    fn judge(&mut self, quad: &Quad, origin: Vec3, direction: Vec3, [general, brief]: [f32; 2]) {
        let hit = brief != T_MISS;
        self.impossible += u32::from(!brief.is_finite() || brief <= 0.0);
        if direction[quad.axis().unwrap()] == 0.0 {
            self.parallel += 1;
            self.impossible += u32::from(hit || general != T_MISS);
            return;
        }
        let (t, within, share) = inside(quad, origin, direction, 4.0);
        let right = t > 0.0 && within >= 0.0;
        let alike = hit == (general != T_MISS) && hit == right;
        if within.abs() < 1e-6 + share {
            self.at_edges += u32::from(!alike);
        } else {
            self.unlike += u32::from(!alike);
        }
        if hit && general != T_MISS {
            self.hits += 1;
            self.worst_ulps = self.worst_ulps.max(brief.to_bits().abs_diff(general.to_bits()));
            self.worst_error = self.worst_error.max((f64::from(brief) / t - 1.0).abs() / ROUNDING);
        }
    }
}

/// The brief test of rectangles along axes gives the hits and, to two units in the last place, the distances of the general
/// one, and both are right; rays parallel to a plane never meet it, nothing is NaN.
#[test]
fn rectangles_along_axes_are_met_as_other_quads_are() {
    let gpu = open_gpu();
    let mut aligned = Aligned::default();
    for seed in 0..4 {
        aligned.add(&gpu, seed, [1.0, 1000.0][seed as usize % 2], 1 << 18, |_| ());
    }
    println!("{aligned:?}");
    assert!(aligned.hits > 200_000 && aligned.parallel > 100_000, "{aligned:?}");
    assert_eq!([aligned.impossible, aligned.unlike, aligned.other_nearest], [0; 3], "{aligned:?}");
    assert!(aligned.worst_ulps <= 2 && aligned.worst_error <= 4.0, "{aligned:?}");
    assert!(aligned.at_edges < aligned.hits / 10, "{aligned:?}");
    // Negative controls: a side, or a level, off by a ten thousandth.
    let scaled = |word: usize| {
        move |hot: &mut [Row]| {
            hot.iter_mut()
                .step_by(2)
                .for_each(|row| row[word] = (f32::from_bits(row[word]) * 1.0001).to_bits())
        }
    };
    for word in [3, 0] {
        let mut wrong = Aligned::default();
        wrong.add(&gpu, 0, 1.0, 1 << 16, scaled(word));
        assert!(wrong.unlike > 10 && wrong.other_nearest > 10, "{word}: {wrong:?}");
    }
}

// The hierarchy

/// 50 to 500 spheres and quads within 10 of the origin: nested, coincident, doubled, flat, tiny; and walls of radius 2000.
fn crowd(numbers: &mut Numbers) -> CompiledScene {
    let count = 50 + numbers.below(451);
    let mut builder = empty();
    let mut last = (DVec3::ZERO, 1.0, DVec3::X, DVec3::Y);
    let mut made = 0;
    while made < count {
        made += 1;
        let (center, radius, e1, e2) = last;
        builder = match numbers.below(12) {
            0 => builder.sphere(center, radius, "m"),
            1 => builder.sphere(center, radius * numbers.between(0.3, 0.999), "m"),
            2 => builder.quad(center, e1, e2, "m"),
            // In the same plane.
            3 => builder.quad(center + e1 * 0.25, e1, e2 * 0.5, "m"),
            4 => builder.sphere(numbers.direction() * 2010.0, 2000.0, "m"),
            5 => {
                made += 5;
                let size = numbers.in_box(3.0).abs() * DVec3::new(1.0, 1e-3, 1.0) + 1e-4;
                builder.boxed(
                    numbers.in_box(10.0),
                    size,
                    [0.0, numbers.between(0.0, 360.0)][numbers.below(2)],
                    "m",
                )
            }
            kind => {
                let e1 = numbers.direction() * numbers.of_any_size(1e-2, 10.0);
                let e2 = tangent(numbers, e1.normalize()) * numbers.of_any_size(1e-2, 10.0);
                last = (
                    numbers.in_box(10.0),
                    numbers.of_any_size(1e-4, 3.0),
                    e1,
                    e2 + e1 * numbers.between(-1.0, 1.0),
                );
                match kind {
                    6 => builder.quad(last.0, DVec3::X * e1.length(), DVec3::NEG_Z * e2.length(), "m"),
                    7 | 8 => builder.quad(last.0, last.2, last.3, "m"),
                    _ => builder.sphere(last.0, last.1, "m"),
                }
            }
        };
    }
    CompiledScene::new(&builder.build().unwrap())
}

/// A point of a shape, or of the box around it.
fn place(numbers: &mut Numbers, scene: &CompiledScene) -> DVec3 {
    let i = numbers.below(scene.spheres.len() + scene.quads.len());
    match scene.shape_index(i as u32) {
        ShapeIndex::Sphere(i) => {
            let Sphere { center, radius, .. } = scene.spheres[i];
            let around = [numbers.direction(), numbers.in_box(1.0).signum(), DVec3::ZERO][numbers.below(3)];
            center.as_dvec3() + around * f64::from(radius) * [1.0, 0.999, 1.0 + 1e-6][numbers.below(3)]
        }
        ShapeIndex::Quad(i) => {
            let quad = &scene.quads[i];
            let share = |numbers: &mut Numbers| [0.0, 1.0, numbers.between(0.0, 1.0)][numbers.below(3)];
            let (a, b) = (share(numbers), share(numbers));
            quad.corner.as_dvec3() + quad.e1.as_dvec3() * a + quad.e2.as_dvec3() * b
        }
        ShapeIndex::Triangle(_) => unreachable!("crowds have no meshes"),
    }
}

/// A ray that grazes a shape: the edge of a sphere as seen along it, or a quad's plane, by 1e-8 to 1e-3 of the size. Directions
/// have components of any size.
fn grazing(numbers: &mut Numbers, scene: &CompiledScene) -> (DVec3, DVec3) {
    let mut small = || numbers.sign() * numbers.of_any_size(1e-8, 1e-3);
    let (by, along) = (small(), DVec3::new(small(), small(), small()) * 1e3);
    let i = numbers.below(scene.spheres.len() + scene.quads.len());
    match scene.shape_index(i as u32) {
        ShapeIndex::Sphere(i) => {
            let Sphere { center, radius, .. } = scene.spheres[i];
            let direction = along.normalize();
            // As far out as it goes along an axis, or any edge.
            let out = match numbers.below(2) {
                0 => DVec3::AXES[numbers.below(3)].reject_from_normalized(direction),
                _ => tangent(numbers, direction),
            };
            (center.as_dvec3() + out.normalize() * f64::from(radius) * (1.0 + by), direction)
        }
        ShapeIndex::Quad(i) => {
            let Quad { corner, e1, e2, normal, .. } = scene.quads[i];
            let [corner, e1, e2, normal] = [corner, e1, e2, normal].map(|v| v.as_dvec3());
            let target =
                corner + e1 * numbers.between(-0.01, 1.01) + e2 * [by.abs(), 1.0 + by][numbers.below(2)];
            (target, (e1 * along.x + e2 * along.y).normalize() + normal * by)
        }
        ShapeIndex::Triangle(_) => unreachable!("crowds have no meshes"),
    }
}

/// A ray through a scene of size 10 from a distance of up to `farthest`, and a question about shadows: `[ray's origin and how
/// far as a multiple of the hit's distance, direction and the shape left out]`.
fn ray_through(numbers: &mut Numbers, scene: &CompiledScene, farthest: f64) -> [Row; 2] {
    let target = place(numbers, scene);
    let origin = match numbers.below(4) {
        0 => place(numbers, scene),
        1 => numbers.in_box(12.0),
        _ => target + numbers.direction() * numbers.of_any_size(1e-3, farthest),
    };
    let mut origin = origin.as_vec3();
    let mut direction = target - origin.as_dvec3();
    let grazes = numbers.below(4) == 0;
    if grazes {
        let (target, along) = grazing(numbers, scene);
        direction = along;
        origin = (target - along * numbers.of_any_size(1e-3, farthest)).as_vec3();
    } else if numbers.below(3) == 0 || direction.length() < 1e-6 {
        direction = numbers.direction();
    }
    for _ in 0..[0, 0, 1, 2][if grazes { 0 } else { numbers.below(4) }] {
        direction[numbers.below(3)] = 0.0f64.copysign(numbers.sign());
    }
    let direction = if direction == DVec3::ZERO { DVec3::X } else { direction };
    let factor = [0.5, 0.999_999, 1.0, 1.000_001, 2.0, 1e9][numbers.below(6)];
    let shapes = scene.spheres.len() + scene.quads.len();
    let excluded = [NONE, HIT_SHAPE, numbers.below(shapes) as u32][numbers.below(3)];
    [row(origin, f32::to_bits(factor)), row(unit(direction), excluded)]
}

/// Stands for the shape that the ray meets first.
const HIT_SHAPE: u32 = NONE - 1;
const WALK: (&str, &str) = (
    "@if(bvh) import package::scene::bvh::{intersect, occluded};
    @if(!bvh) import package::scene::shapes::{intersect, occluded};
    import package::scene::data::NONE;
    import package::scene::shapes::{Ray, T_MISS};",
    "let ray = Ray(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz));
    let hit = intersect(ray);
    let t_max = min(hit.t * bitcast<f32>(a.w), T_MISS);
    let dark = occluded(ray, t_max, select(b.w, hit.shape, b.w == NONE - 1u));
    out0 = vec4<u32>(bitcast<u32>(hit.t), hit.shape, u32(dark), 0u);",
);

/// Answers by the hierarchy, changed so, and by asking all: how many there were, how many hits and shadows, how many differ.
fn walked(gpu: &Gpu, seed: u64, farthest: f64, change: impl Fn(&mut Bvh)) -> [usize; 4] {
    let mut numbers = Numbers(seed);
    let mut scene = crowd(&mut numbers);
    let mut bvh = Bvh::new(&scene);
    change(&mut bvh);
    // The hierarchy asks quads along axes as it asks all.
    scene.aligned = [0; 3];
    let (spheres, quads) = (scene.spheres.len() as u32, scene.quads.len() as u32);
    let hot = rows::hot(&scene);
    let questions: Vec<_> = (0..1 << 15).map(|_| ray_through(&mut numbers, &scene, farthest)).collect();
    let [by_walk, by_all] = [None, Some(SmallScene { spheres, quads, aligned: [0; 3] })].map(|small_scene| {
        scene.bvh = small_scene.is_none().then(|| bvh.clone());
        let key = KernelKey { small_scene, direct_light: true, ..key(&scene) };
        assert_eq!(key.bvh.is_some(), small_scene.is_none());
        ask(gpu, &Probe::<2, 1>::new(gpu, &key, WALK.0, WALK.1), &scene, &hot, &questions)
    });
    let count = |what: &dyn Fn(&Row) -> bool| by_all.iter().flatten().filter(|row| what(row)).count();
    let different: Vec<usize> = (0..questions.len()).filter(|&i| by_walk[i] != by_all[i]).collect();
    if let Some(&i) = different.first() {
        let [a, b] = questions[i].map(floats);
        println!(
            "seed {seed} ({spheres} spheres): {} differ, such as {a:?} {b:?}: {:?} for {:?}",
            different.len(),
            by_walk[i],
            by_all[i]
        );
    }
    [questions.len(), count(&|row| row[1] != NONE), count(&|row| row[2] != 0), different.len()]
}

/// The hierarchy finds the shape and the distance that asking all finds, to the bit, and the same shadows: in scenes of 50 to
/// 500 spheres and quads, from within and from up to 1e5 times their size away. How many rays do not?
fn differing_from_the_hierarchy(gpu: &Gpu, seeds: std::ops::Range<u64>) -> usize {
    let mut total = [0; 4];
    for seed in seeds {
        let farthest = [30.0, 3e3, 1e6][seed as usize % 3];
        let counts = walked(gpu, seed, farthest, |_| ());
        total = std::array::from_fn(|k| total[k] + counts[k]);
    }
    println!("{total:?}");
    let [rays, hits, shadows, different] = total;
    assert!(hits > rays / 2 && shadows > rays / 10, "{total:?}");
    different
}

#[test]
fn the_hierarchy_finds_what_asking_all_finds_to_the_bit() {
    let gpu = open_gpu();
    assert_eq!(differing_from_the_hierarchy(&gpu, 500..548), 0);
    // Negative control: boxes smaller by one per cent.
    let shrunk = |bvh: &mut Bvh| {
        for rows in bvh.rows.chunks_mut(NODE_ROWS / 2) {
            let [low, high] = [floats(rows[0]).0, floats(rows[1]).0];
            let by = (high - low) * 0.005;
            rows[0] = row(low + by, rows[0][3]);
            rows[1] = row(high - by, rows[1][3]);
        }
    };
    assert!(walked(&gpu, 500, 30.0, shrunk)[3] > 100);
}

/// One in a million may differ: from thousands of scene sizes away quads are now and then met where a ray passes beside their
/// box. docs/ACCURACY.md
#[test]
#[ignore = "long: 16 million rays at 480 scenes; tests/run --long"]
fn the_hierarchy_finds_what_asking_all_finds_in_480_scenes_but_for_one_ray_in_a_million() {
    assert!(differing_from_the_hierarchy(&open_gpu(), 500..980) <= 16);
}
