//! Directions to lights.

use super::twins::{SIDES, Twins, World, Worst};
use crate::oracles::sampling::{Cap, ROUNDING, cap};
use crate::probe::{Numbers, floats, row};
use glam::{DVec3, Vec3, Vec3Swizzles};
use qtracer::scene::compiled::{CompiledScene, Light, Material, Quad, ShapeIndex, Sphere, Triangle};
use qtracer::scene::rows::Row;
use qtracer::scene::shapes::{Ray, T_MISS, intersect_quad, intersect_sphere};
use qtracer::scene::triangle::{intersect_triangle, ray_shear};
use qtracer::transport::light::{pdf_light, sample_light};
use std::f64::consts::PI;

/// A direction from a.xyz to the light a.w by two numbers, where it meets that light, and its density there; the same for
/// the direction c, chosen elsewhere.
const ASK: (&str, &str) = (
    "import package::scene::data::{sphere_at, sphere_count, quad_at};
    import package::scene::shapes::{Ray, T_MISS, intersect_sphere, refine_sphere_distance, intersect_quad};
    import package::transport::light::{sample_light, pdf_light};",
    "let origin = bitcast<vec3<f32>>(a.xyz);
    let s = sample_light(origin, a.w, bitcast<vec2<f32>>(b.xy));
    var directions = array<vec3<f32>, 2>(s.wi, bitcast<vec3<f32>>(c.xyz));
    var met = array<f32, 2>(T_MISS, T_MISS);
    for (var i = 0u; i < 2u; i++) {
        let ray = Ray(origin, directions[i]);
        if a.w < sphere_count() {
            let sphere = sphere_at(a.w);
            met[i] = intersect_sphere(ray, sphere.center, sphere.radius * sphere.radius);
            if met[i] < T_MISS { met[i] = refine_sphere_distance(ray, sphere.center, sphere.radius, met[i]); }
        } else {
            let quad = quad_at(a.w - sphere_count());
            met[i] = intersect_quad(ray, quad.corner, quad.normal, quad.dual1, quad.dual2);
        }
    }
    out0 = vec4<u32>(bitcast<vec3<u32>>(s.wi), bitcast<u32>(s.t));
    out1 = bitcast<vec4<u32>>(vec4<f32>(s.pdf, met[0], pdf_light(origin, a.w, s.wi, met[0]), 0.0));
    out2 = bitcast<vec4<u32>>(vec4<f32>(met[1], pdf_light(origin, a.w, directions[1], met[1]), 0.0, 0.0));",
);

fn ask(world: &World, [a, b, c]: &[Row; 3]) -> [Row; 3] {
    let (origin, shape) = (floats(*a).0, a[3]);
    let s = sample_light(&world.scene, origin, shape, floats(*b).0.xy());
    let [(met, pdf), (other, other_pdf)] = [s.wi, floats(*c).0].map(|wi| {
        let t = distance(&world.scene, shape, origin, wi);
        (t, pdf_light(&world.scene, origin, shape, wi, t))
    });
    [
        row(s.wi, s.t.to_bits()),
        [s.pdf, met, pdf, 0.0].map(f32::to_bits),
        [other, other_pdf, 0.0, 0.0].map(f32::to_bits),
    ]
}

/// Distance at which a ray meets the shape; T_MISS if it does not.
pub fn distance(scene: &CompiledScene, shape: u32, origin: Vec3, direction: Vec3) -> f32 {
    let ray = Ray { origin, direction };
    match scene.shape_index(shape) {
        ShapeIndex::Sphere(i) => intersect_sphere(&ray, &scene.spheres[i]),
        ShapeIndex::Quad(i) => intersect_quad(&ray, &scene.quads[i]),
        ShapeIndex::Triangle(i) => {
            let Triangle { a, b, c, .. } = scene.triangles[i];
            let t = intersect_triangle(origin, &ray_shear(direction), a, b, c);
            if t > 0.0 { t } else { T_MISS }
        }
    }
}

/// An answer to [`ASK`].
#[derive(Clone, Copy, Debug)]
struct Found {
    wi: Vec3,
    t: f32,
    pdf: f32,
    /// Where the sampled direction meets the light, and the density that belongs to it there.
    met: f32,
    met_pdf: f32,
    /// The same of the direction chosen elsewhere.
    other: f32,
    other_pdf: f32,
}

fn found([a, b, c]: [Row; 3]) -> Found {
    let ((wi, t), b, c) = (floats(a), b.map(f32::from_bits), c.map(f32::from_bits));
    Found { wi, t, pdf: b[0], met: b[1], met_pdf: b[2], other: c[0], other_pdf: c[1] }
}

const LAMPS: u32 = 1024;

/// Lamps anywhere within 1e3 of the origin: spheres of radius 1e-4 to 1e4, a quarter of which shine inwards.
fn sphere_lamps() -> World {
    let mut numbers = Numbers(21);
    let sphere = |i: u32| {
        let center = (numbers.direction() * numbers.of_any_size(1e-3, 1e3)).as_vec3();
        let radius = numbers.of_any_size(1e-4, 1e4) as f32;
        Sphere { center, radius, light: i, inward: u32::from(i.is_multiple_of(4)), ..Default::default() }
    };
    let spheres = (0..LAMPS).map(sphere).collect();
    lamps_of(CompiledScene { spheres, quads: vec![Quad::default()], ..Default::default() })
}

/// Parallelograms of sides 1e-2 to 1e2 within 1e2 of the origin.
fn quad_lamps() -> World {
    let mut numbers = Numbers(22);
    let quad = |i: u32| {
        let (a, b) = (numbers.direction(), numbers.direction());
        let corner = numbers.direction() * numbers.of_any_size(1e-2, 1e2);
        let (e1, e2) =
            (a * numbers.of_any_size(1e-2, 1e2), (a.cross(b) + 0.5 * a) * numbers.of_any_size(1e-2, 1e2));
        let cross = e1.cross(e2);
        let n = cross.normalize();
        let (d1, d2) = (e2.cross(n), n.cross(e1));
        let [dual1, dual2] = [d1 / e1.dot(d1), d2 / e2.dot(d2)].map(|d| d.as_vec3());
        let [corner, e1, e2, normal] = [corner, e1, e2, n].map(|v| v.as_vec3());
        Quad {
            corner,
            e1,
            e2,
            normal,
            area: cross.length() as f32,
            dual1,
            dual2,
            light: i,
            ..Default::default()
        }
    };
    let quads = (0..LAMPS).map(quad).collect();
    lamps_of(CompiledScene { spheres: vec![Sphere::default()], quads, ..Default::default() })
}

fn lamps_of(scene: CompiledScene) -> World {
    let count = scene.spheres.len() + scene.quads.len();
    let light = |shape| Light { shape, ..Default::default() };
    let lights = (0..count as u32).map(light).collect();
    World::of(CompiledScene { lights, materials: vec![Material::default()], ..scene })
}

/// What was found of spheres.
#[derive(Debug, Default)]
struct SphereFigures {
    sampled: u32,
    /// Directions sampled from within two radii, a thousand, and farther; and those that f32 does not see meet the lamp.
    seen: [u32; 3],
    missed: [u32; 3],
    /// Lamps not sampled that are seen, but from within rounding of the surface; sampled that are not.
    wrong: u32,
    /// Relative error of the density, in roundings for each that its conditioning costs; and told.
    pdf: Worst,
    pdf_told: Worst,
    /// How far outside the cone a direction points, in the same measure.
    outside: Worst,
    /// Distance of the point at `t` from the sphere, in roundings of the distance to its centre plus the radius.
    residual: Worst,
    /// Relative difference of the densities drawn and evaluated, in roundings.
    both: Worst,
}

impl SphereFigures {
    /// From outside: all densities are those of the cone.
    fn judge_outside(&mut self, origin: DVec3, sphere: &Sphere, found: &Found) {
        let radius = f64::from(sphere.radius);
        let to_center = sphere.center.as_dvec3() - origin;
        let Cap { distance, cos_max, pdf } = cap(to_center, radius);
        // The square of the cosine is a difference: of its error, in roundings, the cosine has this many.
        let conditioning = 1.0 / cos_max.max(ROUNDING.sqrt());
        let error = |p: f32| (f64::from(p) / pdf - 1.0).abs();
        self.pdf.see(error(found.pdf) / (ROUNDING * conditioning));
        self.pdf_told.see(error(found.pdf));
        let wi = found.wi.as_dvec3();
        let sin = to_center.cross(wi).length() / (distance * wi.length());
        let outside = (sin.asin() - (radius / distance).min(1.0).asin()) / (ROUNDING * conditioning);
        self.outside.see(outside);
        if found.other < T_MISS {
            self.both.see((f64::from(found.other_pdf) / f64::from(found.pdf) - 1.0).abs() / ROUNDING);
        }
    }

    fn judge(&mut self, origin: Vec3, sphere: &Sphere, found: &Found) {
        let radius = f64::from(sphere.radius);
        let distance = (sphere.center.as_dvec3() - origin.as_dvec3()).length();
        let (outside, inward) = (distance > radius, sphere.inward != 0);
        let at_surface = (distance - radius).abs() < 4.0 * ROUNDING * radius;
        if (found.pdf > 0.0) != (outside != inward) {
            self.wrong += u32::from(!at_surface);
            return;
        }
        if found.pdf == 0.0 {
            return;
        }
        self.sampled += 1;
        let zone = usize::from(distance > 2.0 * radius) + usize::from(distance > 1e3 * radius);
        self.seen[zone] += 1;
        self.missed[zone] += u32::from(found.met >= T_MISS);
        self.wrong += u32::from(!(found.pdf.is_finite() && (found.wi.length() - 1.0).abs() < 1e-6));
        let end = origin.as_dvec3() + found.wi.as_dvec3() * f64::from(found.t) - sphere.center.as_dvec3();
        self.residual.see((end.length() - radius).abs() / (ROUNDING * (distance + radius)));
        self.both.see((f64::from(found.met_pdf) / f64::from(found.pdf) - 1.0).abs() / ROUNDING);
        if outside {
            self.judge_outside(origin.as_dvec3(), sphere, found);
        } else {
            self.wrong += u32::from((f64::from(found.pdf) * 4.0 * PI - 1.0).abs() > 3.0 * ROUNDING);
        }
    }
}

/// A point from 1e-8 radii off the surface, in, on or out, to 1e7 radii away; two numbers; a direction to somewhere on the lamp.
fn sphere_question(numbers: &mut Numbers, i: u32, sphere: &Sphere) -> [Row; 3] {
    let (center, radius) = (sphere.center.as_dvec3(), f64::from(sphere.radius));
    let away = match numbers.below(5) {
        0 => 1.0,
        1 => 1.0 + numbers.sign() * numbers.of_any_size(1e-8, 0.5),
        2 => numbers.between(0.0, 1.0),
        3 => numbers.of_any_size(1.1, 1e3),
        _ => numbers.of_any_size(1e3, 1e7),
    };
    let origin = (center + numbers.direction() * radius * away).as_vec3();
    let target = center + numbers.direction() * radius * 0.9;
    let u = [numbers.below(1 << 24), numbers.below(1 << 24)].map(|k| (k as f32 / 16_777_216.0).to_bits());
    [row(origin, i), [u[0], u[1], 0, 0], row((target - origin.as_dvec3()).normalize().as_vec3(), 0)]
}

/// Tiny and near, huge and enclosing, far, and from the surface itself.
fn spheres_are_sampled(seed: u64, count: u32) {
    let world = sphere_lamps();
    let twins = Twins::new(&world, ASK, ask);
    let mut numbers = Numbers(seed);
    let lamp = |i: u32| &world.scene.spheres[i as usize];
    let questions: Vec<_> =
        (0..count).map(|i| i % LAMPS).map(|i| sphere_question(&mut numbers, i, lamp(i))).collect();
    for side in SIDES {
        let mut figures = SphereFigures::default();
        for ([a, ..], answer) in questions.iter().zip(twins.answer(side, &questions)) {
            figures.judge(floats(*a).0, lamp(a[3]), &found(answer));
        }
        println!("{side:?}: {figures:?}");
        assert!(figures.sampled > count / 3 && figures.wrong == 0, "seed {seed}, {side:?}: {figures:?}");
        // The H100's sines and roots: 9.1 and 5.6.
        let (residual, both) = if twins.compute_to_the_letter() { (8.0, 2.0) } else { (16.0, 8.0) };
        let within = [
            (&figures.pdf, 8.0),
            (&figures.outside, 8.0),
            (&figures.residual, residual),
            (&figures.both, both),
        ];
        for (worst, bound) in within {
            assert!(worst.get() <= bound, "seed {seed}, {side:?}: {figures:?}");
        }
        let rate = |zone: usize| f64::from(figures.missed[zone]) / f64::from(figures.seen[zone]);
        assert!(rate(0) < 0.02 && rate(1) < 1e-3, "seed {seed}, {side:?}: {figures:?}");
        // Negative control: spheres a thousandth larger than those sampled.
        let mut wrong = SphereFigures::default();
        let larger = |i: u32| Sphere { radius: 1.001 * lamp(i).radius, ..*lamp(i) };
        for ([a, ..], answer) in questions.iter().zip(twins.answer(side, &questions)) {
            wrong.judge(floats(*a).0, &larger(a[3]), &found(answer));
        }
        assert!(wrong.pdf.get() > 1000.0 && wrong.residual.get() > 1000.0, "{wrong:?}");
    }
}

#[test]
fn sphere_lights_are_sampled_from_1e_8_to_1e7_radii_away() {
    spheres_are_sampled(31, 1 << 17);
}

#[test]
#[ignore = "long: 8 million directions; tests/run --long"]
fn millions_of_directions_to_sphere_lights_are_right() {
    (100..108).for_each(|seed| spheres_are_sampled(seed, 1 << 20));
}

/// What was found of quads, in roundings for each that conditioning costs; and told.
#[derive(Debug, Default)]
struct QuadFigures {
    sampled: u32,
    unsampled: u32,
    /// Directions to lamps that are neither edge-on nor far, and those of them that f32 does not see meet the lamp.
    clear: u32,
    missed: u32,
    wrong: u32,
    pdf: Worst,
    both: Worst,
    other: Worst,
    told: Worst,
}

impl QuadFigures {
    fn judge(&mut self, question: &[Row; 3], quad: &Quad, found: &Found) {
        let (origin, u) = (floats(question[0]).0.as_dvec3(), floats(question[1]).0.as_dvec3());
        let n = quad.normal.as_dvec3();
        let height = -n.dot(quad.corner.as_dvec3() - origin);
        let size = origin.abs().max_element()
            + f64::from(quad.corner.abs().max_element())
            + f64::from(quad.e1.length() + quad.e2.length());
        // A density ∝ t²/cosθ = t³/height: with errors of a few roundings of all coordinates in both.
        let sliver = f64::from(quad.e1.length() * quad.e2.length() / quad.area);
        let conditioning = |t: f64| sliver + size / t + (size + t) / height.abs();
        if found.pdf == 0.0 {
            self.unsampled += 1;
            self.wrong += u32::from(height > 8.0 * ROUNDING * size);
            return;
        }
        self.sampled += 1;
        let to = quad.corner.as_dvec3() + quad.e1.as_dvec3() * u.x + quad.e2.as_dvec3() * u.y - origin;
        let area = quad.e1.as_dvec3().cross(quad.e2.as_dvec3()).length();
        let exact = |to: DVec3| to.length().powi(3) / (height.abs() * area);
        // Relative to the greater, since heights within rounding of 0 make densities of any size.
        let off = |p: f32, exact: f64, t: f64| {
            (f64::from(p) - exact).abs() / (exact.max(p.into()) * ROUNDING * conditioning(t))
        };
        self.wrong += u32::from(height < -8.0 * ROUNDING * size || !found.pdf.is_finite());
        self.pdf.see(off(found.pdf, exact(to), to.length()));
        if height > 1e-2 * size {
            self.told.see((f64::from(found.pdf) / exact(to) - 1.0).abs());
        }
        // Where f32 tells points on the quad apart by a ten-thousandth of its shorter side.
        let blur = ROUNDING * (size + to.length()).powi(2) / height.abs() * sliver;
        let clear = height > 0.0 && blur < 1e-4 * f64::from(quad.e1.length().min(quad.e2.length()));
        self.clear += u32::from(clear);
        if found.met < T_MISS {
            self.both.see(off(found.met_pdf, found.pdf.into(), to.length()));
        } else {
            self.missed += u32::from(clear);
        }
        let aim = floats(question[2]).0.as_dvec3();
        if found.other < T_MISS && height > 64.0 * ROUNDING * size {
            let t = height / -n.dot(aim);
            self.other.see(off(found.other_pdf, exact(aim * t), t));
        }
    }
}

/// A point before a quad, from 1e-6 of its size to 1e4 times that away, straight before it or edge-on; as above.
fn quad_question(numbers: &mut Numbers, i: u32, quad: &Quad) -> [Row; 3] {
    let [corner, e1, e2, n] = [quad.corner, quad.e1, quad.e2, quad.normal].map(Vec3::as_dvec3);
    let size = e1.length() + e2.length();
    let on =
        |numbers: &mut Numbers| corner + e1 * numbers.between(0.02, 0.98) + e2 * numbers.between(0.02, 0.98);
    let height = size * numbers.of_any_size(1e-6, 1e2);
    let aside = numbers.of_any_size(1e-3, 1e4) * size * f64::from(u32::from(numbers.below(2) == 0));
    let across = n.cross(numbers.direction()).normalize();
    let origin = (on(numbers) + n * height + across * aside).as_vec3();
    let target = on(numbers);
    let u = [numbers.below(1 << 24), numbers.below(1 << 24)].map(|k| (k as f32 / 16_777_216.0).to_bits());
    [row(origin, i), [u[0], u[1], 0, 0], row((target - origin.as_dvec3()).normalize().as_vec3(), 0)]
}

/// Near, far and edge-on.
#[test]
fn quad_lights_are_sampled_from_near_far_and_the_side() {
    let world = quad_lamps();
    let twins = Twins::new(&world, ASK, ask);
    let mut numbers = Numbers(32);
    // The first shape is a sphere, which no one asks about.
    let lamp = |i: u32| &world.scene.quads[i as usize - 1];
    let count = 1u32 << 17;
    let questions: Vec<_> =
        (0..count).map(|i| 1 + i % LAMPS).map(|i| quad_question(&mut numbers, i, lamp(i))).collect();
    for side in SIDES {
        let (mut figures, mut wrong) = (QuadFigures::default(), QuadFigures::default());
        for (question, answer) in questions.iter().zip(twins.answer(side, &questions)) {
            let quad = lamp(question[0][3]);
            figures.judge(question, quad, &found(answer));
            wrong.judge(question, &Quad { e1: quad.e1 * 1.001, ..*quad }, &found(answer));
        }
        println!("{side:?}: {figures:?}");
        assert!(figures.sampled > count * 9 / 10 && figures.wrong == 0, "{side:?}: {figures:?}");
        for worst in [&figures.pdf, &figures.both, &figures.other] {
            assert!(worst.get() < 8.0, "{side:?}: {figures:?}");
        }
        assert!(figures.missed < figures.clear / 1000, "{side:?}: {figures:?}");
        // Negative control: a side a thousandth longer.
        assert!(wrong.pdf.get() > 1000.0, "{wrong:?}");
    }
}
