//! Where rays from anywhere meet spheres of any size.

use super::twins::{Aimed, Met, Twin, aimed, both_twins, with_hierarchy};
use super::{empty, tangent};
use crate::guiding_maths::cases;
use crate::oracles::geometry::{ROUNDING, chord, height_over_sphere, unit};
use crate::probe::{Numbers, floats};
use glam::Vec3;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use qtracer::scene::Material as SceneMaterial;
use qtracer::scene::compiled::{CompiledScene, Material, NONE, Sphere};
use qtracer::scene::shapes::{RELATIVE_OFFSET, T_MISS};

/// Which spheres to make: radii, how far from the origin their centres are, and the least radius in spawn offsets there.
#[derive(Clone)]
pub struct SphereRange {
    pub radii: [f64; 2],
    pub places: [f64; 2],
    pub least_offsets: f32,
}

pub fn sphere_scene(spheres: Vec<Sphere>) -> CompiledScene {
    CompiledScene { spheres, materials: vec![Material::default()], ..Default::default() }
}

pub fn some_spheres(count: usize, range: &SphereRange) -> CompiledScene {
    let mut numbers = Numbers(1);
    let SphereRange { radii, places, least_offsets } = *range;
    let sphere = |_| loop {
        let center = (numbers.direction() * numbers.of_any_size(places[0], places[1])).as_vec3();
        let radius = numbers.of_any_size(radii[0], radii[1]) as f32;
        if radius > least_offsets * RELATIVE_OFFSET * center.abs().max_element() {
            return Sphere { center, radius, light: NONE, ..Default::default() };
        }
    };
    sphere_scene((0..count).map(sphere).collect())
}

impl SphereRange {
    /// Spheres whose radii are given in offsets.
    pub fn in_offsets(&self, count: usize) -> CompiledScene {
        let mut scene = some_spheres(count, self);
        for sphere in &mut scene.spheres {
            sphere.radius *= RELATIVE_OFFSET * sphere.center.abs().max_element();
        }
        scene
    }
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
    /// Worst relative error of the distance from two radii and farther, where the ray passes the centre within 0.9 radii
    /// and is not a million radii away.
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
    let away = match numbers.below(7) {
        0 => numbers.between(0.0, 1.0),
        1 => 1.0 + numbers.of_any_size(1e-6, 1.0),
        2 => numbers.of_any_size(2.0, 1e3),
        3 => numbers.of_any_size(1e3, 1e7),
        4 => 1.0 - numbers.of_any_size(1e-6, 1.0),
        // On it, as nearly as f32 can say.
        5 => 1.0,
        _ => numbers.of_any_size(1.0, 1e7) / radius,
    };
    let outward = numbers.direction();
    let origin = (center + outward * radius * away).as_vec3();
    // Where the line passes the centre, in radii: anywhere, or within 1e-7 to 1e-2 of the edge.
    let pass = match numbers.below(3) {
        0 => 1.0 + numbers.sign() * numbers.of_any_size(1e-7, 1e-2),
        _ => 1.2 * numbers.between(0.0, 1.0f64).sqrt(),
    };
    let to_center = center - origin.as_dvec3();
    let axis = if to_center.length() > 0.0 { to_center.normalize() } else { numbers.direction() };
    let sin = (pass * radius / to_center.length().max(1e-30)).min(1.0);
    let direction =
        axis * (1.0 - sin * sin).sqrt() * numbers.sign().max(-0.5).signum() + tangent(numbers, axis) * sin;
    (origin, unit(direction))
}

impl Found {
    fn add(&mut self, twin: &Twin, scene: &CompiledScene, seed: u64, count: usize, moved: f32) {
        let (mut numbers, spheres) = (Numbers(seed), scene.spheres.len());
        let ray = |i: usize| {
            let (origin, direction) = seen_ray(&mut numbers, &scene.spheres[i % spheres]);
            aimed(origin, direction, i % spheres)
        };
        let rays: Vec<Aimed> = (0..count).map(ray).collect();
        for (ray, met) in rays.iter().zip(twin.meet(scene, &rays)) {
            let t = met.t * (1.0 + moved);
            self.judge(&scene.spheres[ray[0][3] as usize], ray, Met { t, ..met });
        }
    }

    fn judge(&mut self, sphere: &Sphere, &[a, b]: &Aimed, Met { t, raw, .. }: Met) {
        let (origin, direction) = (floats(a).0, floats(b).0);
        let radius = f64::from(sphere.radius);
        let distance = (origin.as_dvec3() - sphere.center.as_dvec3()).length();
        let rounding = ROUNDING * (distance + radius);
        let slack = SPHERE_BOUND * rounding;
        let (middle, half) = chord(origin, direction, sphere.center, radius);
        if raw >= T_MISS {
            self.misses += 1;
            // It must not be missed by one who thinks it a little smaller.
            let (_, inner) = chord(origin, direction, sphere.center, (radius - slack).max(0.0));
            let must = radius > slack && inner >= 0.0 && (distance < radius - slack || middle > slack);
            self.wrong += u32::from(must);
            return;
        }
        self.hits += 1;
        let off = height_over_sphere(sphere, origin, direction, t.into()).abs() / rounding;
        self.worst_residual = self.worst_residual.max(off);
        let far_side = f64::from(t) > middle + slack && distance > radius + slack;
        self.wrong += u32::from(!(off <= SPHERE_BOUND && t > 0.0) || far_side);
        if half > 0.0 {
            self.judge_distance([t, raw], [middle, half], [distance, radius]);
        }
    }

    fn judge_distance(&mut self, ts: [f32; 2], [middle, half]: [f64; 2], [distance, radius]: [f64; 2]) {
        let exact = if middle > half { middle - half } else { middle + half };
        let error = |t: f32| (f64::from(t) - exact).abs();
        let pass = (1.0 - (half / radius).powi(2)).max(0.0).sqrt();
        if distance > 2.0 * radius && distance < 1e6 * radius && pass < 0.9 {
            self.worst_from_afar = self.worst_from_afar.max(error(ts[0]) / exact);
        }
        let slack = SPHERE_BOUND * ROUNDING * (distance + radius);
        let cancels = exact > 0.0 && exact < 0.5 * (middle.abs() + half);
        if cancels && distance < 2.0 * radius && (distance - radius).abs() > slack && pass < 0.95 {
            self.nearby += 1;
            for (i, t) in ts.into_iter().enumerate() {
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
    let near = SphereRange { radii: [1e-3, 1e5], places: [1e-3, 1e4], least_offsets: 10.0 };
    let any = SphereRange { radii: [1e-6, 1e7], places: [1e-6, 1e7], least_offsets: 0.0 };
    for twin in both_twins() {
        for range in [near.clone(), any.clone()] {
            let (scene, mut found) = (some_spheres(4096, &range), Found::default());
            found.add(&twin, &scene, 7, 1 << 19, 0.0);
            println!("{}: {found:?}", twin.name());
            assert!(found.hits.min(found.misses) > 75_000, "{found:?}");
            assert_eq!(found.wrong, 0, "seed 7: {found:?}");
            // Negative control: distances a millionth too long.
            let mut wrong = Found::default();
            wrong.add(&twin, &scene, 7, 1 << 16, 1e-6);
            assert!(wrong.wrong > 1000, "{wrong:?}");
        }
    }
}

/// A size between these, every order of magnitude as often.
fn any_size(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low.ln()..high.ln()).prop_map(f64::exp)
}

/// A sphere somewhere on an axis and a ray along another that passes its edge by a share of the radius: exactly along the
/// axis, so that nothing but this share decides.
fn tangent_case() -> impl Strategy<Value = (Sphere, Aimed)> {
    let share = prop_oneof![Just(0.0), any_size(1e-8, 1e-7), any_size(1e-8, 1e-7).prop_map(|share| -share)];
    let start = prop_oneof![Just(0.0), any_size(1e-7, 1e7), any_size(1e-7, 1e7).prop_map(|start| -start)];
    (any_size(1e-6, 1e7), -1e4..1e4f64, share, start, 0..3usize).prop_map(
        |(radius, place, share, start, axis)| {
            let mut center = Vec3::ZERO;
            center[(axis + 2) % 3] = place as f32;
            let mut origin = center;
            origin[axis] = start as f32;
            origin[(axis + 1) % 3] = (radius * (1.0 + share)) as f32;
            let sphere = Sphere { center, radius: radius as f32, light: NONE, ..Default::default() };
            (sphere, aimed(origin, Vec3::AXES[axis], 0))
        },
    )
}

/// Rays within 1e-7 of the tangent, or the tangent itself, starting at, before and behind the point where it touches.
#[test]
fn tangents_are_hits_or_misses_but_never_anything_else() {
    for twin in both_twins() {
        let many = prop::collection::vec(tangent_case(), 1..2000);
        TestRunner::new(cases(8))
            .run(&many, |cases| {
                let mut rays: Vec<Aimed> = cases.iter().map(|case| case.1).collect();
                rays.iter_mut().zip(0..).for_each(|(ray, number)| ray[0][3] = number);
                let spheres: Vec<Sphere> = cases.iter().map(|case| case.0).collect();
                let met = twin.meet(&sphere_scene(spheres.clone()), &rays);
                for ((sphere, ray), met) in spheres.iter().zip(&rays).zip(met) {
                    let mut found = Found::default();
                    found.judge(sphere, ray, met);
                    prop_assert_eq!(found.wrong, 0, "{:?}: {:?}", met, found);
                }
                Ok(())
            })
            .unwrap_or_else(|e| panic!("{}: {e}", twin.name()));
    }
}

/// Seven shells about one centre, outermost first, a fifty-thousandth of the radius apart.
fn shells(center: Vec3, radius: f32) -> CompiledScene {
    let shell =
        |i: i32| Sphere { center, radius: shell_radius(radius, i), light: NONE, ..Default::default() };
    sphere_scene((0..7).map(shell).collect())
}

fn shell_radius(radius: f32, i: i32) -> f32 {
    radius * (1.0 - 2e-5 * i as f32)
}

/// Rays of up to ten radii meet the shell in front of them: the outermost from outside, the innermost from the middle, the
/// one outside where they start between two. They start half a gap off: 130 roundings of the radius.
#[test]
fn nested_spheres_are_met_in_their_order() {
    let mut numbers = Numbers(9);
    for (place, radius) in [(0.0f32, 1.0f32), (3.0, 1e-6), (-70.0, 1e3), (1e3, 1e7)] {
        let center = Vec3::splat(place * radius.min(1.0));
        let scene = shells(center, radius);
        let ray = |i: usize| {
            let outward = numbers.direction();
            let between = shell_radius(radius, i as i32 % 7) - 1e-5 * radius;
            let (at, sign, shape) = match i % 3 {
                0 => (f64::from(radius) * numbers.between(1.001, 10.0), -1.0, 0),
                1 => (0.0, 1.0, 6),
                _ => (f64::from(between), 1.0, i % 7),
            };
            aimed((center.as_dvec3() + outward * at).as_vec3(), unit(outward * sign), shape)
        };
        let rays: Vec<Aimed> = (0..50_000).map(ray).collect();
        for twin in both_twins() {
            for scene in [scene.clone(), with_hierarchy(&scene)] {
                let nearest = twin.nearest(&scene, &rays);
                let wrong = rays.iter().zip(nearest).filter(|(ray, shape)| ray[0][3] != *shape).count();
                assert_eq!(wrong, 0, "{}: shells of {radius} at {place}, seed 9", twin.name());
            }
        }
    }
}

/// Of spheres in one place the first in the file is met, or the lamp if one is a lamp, whichever way they are asked.
#[test]
fn of_coincident_spheres_the_lamp_is_met_or_the_first() {
    let mut numbers = Numbers(10);
    let (center, radius) = ([3.0, -0.7, 12.1], 2.3);
    let add = |builder: qtracer::scene::SceneBuilder, name: &&str| builder.sphere(center, radius, *name);
    let builder = empty().material("lamp", SceneMaterial::diffuse([0.5; 3]).emitting([1.0; 3]));
    for names in [["m", "m", "lamp", "m"], ["m", "m", "m", "m"]] {
        let scene = names.iter().fold(builder.clone(), add).build().unwrap();
        let scene = CompiledScene::new(&scene);
        assert_eq!(scene.spheres[0].light == NONE, names[2] == "m");
        let from = |numbers: &mut Numbers| numbers.direction() * [0.5, 2.0, 100.0][numbers.below(3)] * radius;
        let ray = |_| {
            let (from, to) = (from(&mut numbers), numbers.direction() * radius * numbers.between(0.0, 0.99));
            aimed((from + glam::DVec3::from(center)).as_vec3(), unit(to - from), 0)
        };
        let rays: Vec<Aimed> = (0..50_000).map(ray).collect();
        for twin in both_twins() {
            for scene in [scene.clone(), with_hierarchy(&scene)] {
                let others = twin.nearest(&scene, &rays).into_iter().filter(|shape| *shape != 0).count();
                assert_eq!(others, 0, "{}: {names:?}, seed 10", twin.name());
            }
        }
    }
}
