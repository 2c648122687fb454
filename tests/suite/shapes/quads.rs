//! Where rays meet parallelograms: slivers, edge-on ones, tiny and huge ones.

use super::twins::{Aimed, Met, Twin, aimed, both_twins};
use super::{empty, tangent};
use crate::guiding_maths::cases;
use crate::oracles::geometry::{Parallelogram, ROUNDING, unit};
use crate::probe::{Numbers, floats};
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::shapes::{RELATIVE_OFFSET, T_MISS};

/// Which quads to make: lengths of sides, how many times longer the longer may be, the sine of the least angle, how far from
/// the origin the corner is, and the least side in spawn offsets there.
#[derive(Clone)]
pub struct QuadRange {
    pub sides: [f64; 2],
    pub aspect: f64,
    pub least_sine: f64,
    pub places: [f64; 2],
    pub least_offsets: f64,
}

impl QuadRange {
    pub const ANY: QuadRange = QuadRange {
        sides: [1e-6, 1e6],
        aspect: 1e6,
        least_sine: 1e-3,
        places: [1e-6, 1e6],
        least_offsets: 0.0,
    };
}

/// Corner and sides as the program can hold them, and the sine of the angle between.
fn some_sides(numbers: &mut Numbers, range: &QuadRange) -> [DVec3; 3] {
    let single = |v: DVec3| v.as_vec3().as_dvec3();
    let (along, long) = (numbers.direction(), numbers.of_any_size(range.sides[0], range.sides[1]));
    let aspect = [1.0, numbers.of_any_size(1.0, range.aspect)][numbers.below(2)];
    let sine = [1.0, numbers.of_any_size(range.least_sine, 1.0)][numbers.below(2)];
    let other = along * numbers.sign() * (1.0 - sine * sine).sqrt() + tangent(numbers, along) * sine;
    let short = (long / aspect).max(range.sides[0]);
    let corner = numbers.direction() * numbers.of_any_size(range.places[0], range.places[1]);
    let sides = [single(along * long), single(other * short)];
    let turned = numbers.below(2);
    [single(corner), sides[turned], sides[1 - turned]]
}

pub fn some_quads(count: usize, range: &QuadRange) -> CompiledScene {
    let mut numbers = Numbers(2);
    let mut builder = empty();
    let mut made = 0;
    while made < count {
        let [corner, e1, e2] = some_sides(&mut numbers, range);
        let height = e1.cross(e2).length() / e1.length().max(e2.length());
        let far = (corner.abs() + e1.abs() + e2.abs()).max_element();
        if height > range.least_offsets * f64::from(RELATIVE_OFFSET) * far {
            builder = builder.quad(corner, e1, e2, "m");
            made += 1;
        }
    }
    let scene = CompiledScene::new(&builder.build().unwrap());
    CompiledScene { aligned: [0; 3], bvh: None, ..scene }
}

/// How many roundings of (distance to the corner + t) off its quad a hit may lie.
const QUAD_BOUND: f64 = 6.0;

/// What rays found of quads.
#[derive(Debug, Default)]
struct Found {
    hits: u32,
    misses: u32,
    /// Hits that are none, distances that are none, and missed quads.
    wrong: u32,
    /// … of rays parallel to the plane to rounding.
    parallel: u32,
    /// Worst distance of a hit from the plane, and beyond an edge, in roundings of (distance to the corner + t).
    worst_off_plane: f64,
    worst_beyond: f64,
    /// How far within all edges a missed ray passed at most, in those roundings through the cosine.
    worst_missed: f64,
    /// Worst relative error of t of rays from as far as the quad is large and farther, at cosines above 0.3.
    worst_from_afar: f64,
}

fn seen_ray(numbers: &mut Numbers, quad: &Parallelogram) -> (Vec3, Vec3) {
    let share = |numbers: &mut Numbers| match numbers.below(4) {
        0 => [0.0, 1.0][numbers.below(2)] + numbers.sign() * numbers.of_any_size(1e-8, 1e-3),
        _ => numbers.between(-0.2, 1.2),
    };
    let target = quad.corner + quad.e1 * share(numbers) + quad.e2 * share(numbers);
    let size = quad.e1.length().max(quad.e2.length());
    let cos = [numbers.between(0.0, 1.0), numbers.of_any_size(1e-8, 1.0), 0.0][numbers.below(3)];
    // Edge-on: across, and along each of the sides.
    let flat = match numbers.below(4) {
        0 => quad.e1.normalize() * numbers.sign(),
        1 => quad.e2.normalize() * numbers.sign(),
        _ => tangent(numbers, quad.normal),
    };
    let direction = quad.normal * numbers.sign() * cos + flat * (1.0 - cos * cos).sqrt();
    let away = [size * numbers.of_any_size(1e-3, 1e3), numbers.of_any_size(1e-3, 1e6)][numbers.below(2)];
    ((target - direction * away).as_vec3(), unit(direction))
}

impl Found {
    fn add(&mut self, twin: &Twin, scene: &CompiledScene, seed: u64, count: usize, moved: f32) {
        let (mut numbers, quads) = (Numbers(seed), scene.quads.len());
        let ray = |i: usize| {
            let (origin, direction) = seen_ray(&mut numbers, &Parallelogram::new(&scene.quads[i % quads]));
            aimed(origin, direction, i % quads)
        };
        let rays: Vec<Aimed> = (0..count).map(ray).collect();
        for (ray, met) in rays.iter().zip(twin.meet(scene, &rays)) {
            let quad = Parallelogram::new(&scene.quads[ray[0][3] as usize]);
            self.judge(&quad, ray, Met { t: met.t * (1.0 + moved), ..met });
        }
    }

    fn judge(&mut self, quad: &Parallelogram, &[a, b]: &Aimed, met: Met) {
        let (origin, direction) = (floats(a).0, floats(b).0);
        let at = |t: f64| quad.at(origin, direction, t);
        let (from_corner, cos) = (at(0.0).length(), quad.normal.dot(direction.as_dvec3()).abs());
        let parallel = cos < 4.0 * ROUNDING;
        self.parallel += u32::from(parallel);
        let exact = quad.plane_distance(origin, direction);
        if !met.hit() {
            self.misses += 1;
            let rounding = ROUNDING * (from_corner + exact.abs()) / cos;
            if parallel || exact < QUAD_BOUND * rounding {
                return;
            }
            let within = quad.within(at(exact)) / rounding;
            self.worst_missed = self.worst_missed.max(within);
            self.wrong += u32::from(within > QUAD_BOUND);
            return;
        }
        self.hits += 1;
        let t = f64::from(met.t);
        let rounding = ROUNDING * (from_corner + t);
        let (off, beyond) = (quad.height(at(t)).abs() / rounding, -quad.within(at(t)) / rounding);
        self.worst_off_plane = self.worst_off_plane.max(off);
        self.worst_beyond = self.worst_beyond.max(beyond);
        self.wrong +=
            u32::from(!(t > 0.0 && t < f64::from(T_MISS) && off < QUAD_BOUND && beyond < QUAD_BOUND));
        if cos > 0.3 && t > quad.e1.length().max(quad.e2.length()) {
            self.worst_from_afar = self.worst_from_afar.max((t / exact - 1.0).abs());
        }
    }
}

/// A hit lies in its parallelogram to within a few roundings of (distance to the corner + t), in the plane and across it,
/// however thin the parallelogram or flat the ray; a ray is missed only where it passes an edge as closely as that through
/// the cosine. Rays along the plane give a distance or none, never NaN.
#[test]
fn parallelograms_are_met_where_they_are_to_a_few_roundings() {
    let scene = some_quads(4096, &QuadRange::ANY);
    for twin in both_twins() {
        let mut found = Found::default();
        found.add(&twin, &scene, 8, 1 << 20, 0.0);
        println!("{}: {found:?}", twin.name());
        assert!(found.hits.min(found.misses) > 100_000 && found.parallel > 100_000, "{found:?}");
        assert_eq!(found.wrong, 0, "seed 8: {found:?}");
        // Negative control: distances a millionth too long.
        let mut wrong = Found::default();
        wrong.add(&twin, &scene, 8, 1 << 16, 2e-6);
        assert!(wrong.wrong > 1000, "{wrong:?}");
    }
}

/// Side lengths, a sine, a place, shares of the sides, a cosine, a distance: all of any size.
fn hard_case() -> impl Strategy<Value = ([f64; 4], [f64; 2], [f64; 2])> {
    let exponent = |low: f64, high: f64| low..high;
    let numbers = [exponent(-6.0, 6.0), exponent(0.0, 6.0), exponent(-3.0, 0.0), exponent(-6.0, 6.0)];
    (numbers, [-0.2..1.2, -0.2..1.2], [exponent(-9.0, 0.0), exponent(-3.0, 6.0)])
}

/// One sliver in the plane of two axes, and a ray that nearly lies in it.
fn sliver(
    [long, aspect, sine, place]: [f64; 4],
    shares: [f64; 2],
    [cos, away]: [f64; 2],
) -> ([DVec3; 3], Aimed) {
    let [long, aspect, sine, place, cos, away] =
        [long, aspect, sine, place, cos, away].map(|x| 10f64.powf(x));
    let single = |v: DVec3| v.as_vec3().as_dvec3();
    let e1 = single(DVec3::new(long, 0.0, long * 0.3));
    let e2 = single((e1 * (1.0 - sine * sine).sqrt() + DVec3::Y * e1.length() * sine) / aspect);
    let corner = single(DVec3::new(place, -place, place * 0.7));
    let normal = e1.cross(e2).normalize();
    let direction = unit(e1.normalize() * (1.0 - cos * cos).sqrt() + normal * cos);
    let target = corner + e1 * shares[0] + e2 * shares[1];
    ([corner, e1, e2], aimed((target - direction.as_dvec3() * away).as_vec3(), direction, 0))
}

/// The same law for single slivers that shrink to the simplest failing one.
#[test]
fn slivers_that_rays_nearly_lie_in_are_met_where_they_are() {
    for twin in both_twins() {
        let many = prop::collection::vec(hard_case(), 1..1000);
        TestRunner::new(cases(8))
            .run(&many, |cases| {
                let slivers: Vec<_> =
                    cases.iter().map(|&(numbers, shares, ray)| sliver(numbers, shares, ray)).collect();
                let add = |b: qtracer::scene::SceneBuilder, ([corner, e1, e2], _): &([DVec3; 3], Aimed)| {
                    b.quad(*corner, *e1, *e2, "m")
                };
                let scene = CompiledScene::new(&slivers.iter().fold(empty(), add).build().unwrap());
                let scene = CompiledScene { aligned: [0; 3], bvh: None, ..scene };
                let mut rays: Vec<Aimed> = slivers.iter().map(|sliver| sliver.1).collect();
                rays.iter_mut().zip(0..).for_each(|(ray, number)| ray[0][3] = number);
                for ((quad, ray), met) in scene.quads.iter().zip(&rays).zip(twin.meet(&scene, &rays)) {
                    let mut found = Found::default();
                    found.judge(&Parallelogram::new(quad), ray, met);
                    prop_assert_eq!(found.wrong, 0, "{:?}: {:?}", met, found);
                }
                Ok(())
            })
            .unwrap_or_else(|e| panic!("{}: {e}", twin.name()));
    }
}
