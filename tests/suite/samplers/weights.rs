//! Weights: of two strategies for the same light, and of paths that outlive roulette.

use super::twins::{SIDES, Twins, World, Worst, all_obey, of_any_size};
use crate::oracles::sampling::ROUNDING;
use crate::probe::{floats, row};
use glam::Vec3;
use proptest::prelude::*;
use qtracer::math::mis_weight;
use qtracer::scene::compiled::{CompiledScene, KIND_DIELECTRIC, Material, NONE, Sphere};
use qtracer::scene::rows::Row;
use qtracer::scene::shapes::Hit;
use qtracer::transport::items::RayItem;
use qtracer::transport::roulette::{LEAST_SURVIVAL_BY_THROUGHPUT, ROULETTE_FROM_BOUNCE};

const MIS: (&str, &str) = (
    "import package::base::vector::mis_weight;",
    "let p = bitcast<vec2<f32>>(a.xy);
    out0 = vec4<u32>(bitcast<u32>(mis_weight(p.x, p.y)), bitcast<u32>(mis_weight(p.y, p.x)),
        bitcast<u32>(mis_weight(p.x, 0.0)), 0u);",
);

/// The two weights share everything between them, whatever the densities: no ratio overflows into something that is no weight.
#[test]
fn mis_weights_add_up_to_one() {
    let world = World::of_all_materials();
    let twins = Twins::new(&world, MIS, |_, [[p, q, ..]]| {
        let [p, q] = [*p, *q].map(f32::from_bits);
        [[mis_weight(p, q), mis_weight(q, p), mis_weight(p, 0.0), 0.0].map(f32::to_bits)]
    });
    let density = || of_any_size(-30.0, 30.0).prop_map(|p| p as f32);
    let close =
        (density(), -1e-3..1e-3f64).prop_map(|(p, off)| (p, (f64::from(p) * (1.0 + off)) as f32)).boxed();
    for side in SIDES {
        let worst = Worst::default();
        let faults = |pairs: &[(f32, f32)]| {
            let questions: Vec<_> = pairs.iter().map(|(p, q)| [[p.to_bits(), q.to_bits(), 0, 0]]).collect();
            let fault = |(&(p, q), [answer]): (&(f32, f32), [Row; 1])| {
                let [a, b, alone] = [answer[0], answer[1], answer[2]].map(|w| f64::from(f32::from_bits(w)));
                let ratio = f64::from(q) / f64::from(p);
                let exact = 1.0 / (1.0 + ratio * ratio);
                let sum = worst.see((a + b - 1.0).abs() / ROUNDING);
                let off = ((a / exact - 1.0).abs() / ROUNDING).min((a - exact).abs() / 1e-37);
                let right = sum < 4.0 && off < 10.0 && alone == 1.0 && (0.0..=1.0).contains(&a);
                (!right).then(|| format!("{a} + {b}, {off} roundings off; alone {alone}"))
            };
            pairs.iter().zip(twins.answer(side, &questions)).map(fault).collect()
        };
        all_obey("weights", prop_oneof![(density(), density()).boxed(), close.clone()], 50_000, faults);
        println!("{side:?}: MIS weights add up to 1 to {} roundings", worst.get());
    }
    // Negative control: as squares, which overflow.
    let squares = |p: f32, q: f32| p * p / (p * p + q * q);
    assert!(!(squares(1e25, 1e-25) + squares(1e-25, 1e25) == 1.0));
}

/// a: throughput and bounce; b: number of the path. Whether it goes on, and with which throughput.
const SHADE: (&str, &str) = (
    "import package::items::RayItem;
    import package::scene::shapes::Hit;
    import package::transport::path::{sample_key, shade};",
    "var ray: RayItem;
    ray.origin = vec3<f32>(0.3, 0.2, 0.1);
    ray.direction = vec3<f32>(0.0, 0.0, -1.0);
    ray.throughput = bitcast<vec3<f32>>(a.xyz);
    ray.bounce = a.w;
    ray.path = b.x;
    let outcome = shade(ray, sample_key(ray.path), Hit(2.0, b.y));
    out0 = vec4<u32>(bitcast<vec3<u32>>(outcome.ray.throughput), u32(outcome.alive));",
);

fn shade(world: &World, [a, b]: &[Row; 2]) -> [Row; 1] {
    let ray = RayItem {
        origin: Vec3::new(0.3, 0.2, 0.1),
        direction: Vec3::NEG_Z,
        throughput: floats(*a).0,
        bounce: a[3],
        path: b[0],
        pdf: 0.0,
    };
    let outcome = world.transport().shade(&ray, &Default::default(), Hit { t: 2.0, shape: b[1] });
    [outcome.ray.map_or([0; 4], |next| row(next.throughput, 1))]
}

/// A grey ball and one of glass, of which the albedo is 1/2.
fn balls() -> World {
    let ball = |(material, kind)| Sphere { radius: 2.0, material, kind, light: NONE, ..Default::default() };
    let material = |kind| Material { color: Vec3::splat(0.5), kind, parameter: 1.5, ..Default::default() };
    let kinds = [0, KIND_DIELECTRIC];
    let mut world = World::of(CompiledScene {
        spheres: (0..).zip(kinds).map(ball).collect(),
        materials: kinds.map(material).to_vec(),
        ..Default::default()
    });
    world.uniforms.max_bounces = 64;
    world.uniforms.pixel_count = 1;
    world.uniforms.roulette_scale = 1.0;
    world
}

/// A path goes on as often as its brightest throughput says, and carries that much more: what goes on is what came, on
/// average. Dark paths too, of which one in 1024 is let live, as far as paths go on at all: to 2⁻¹⁰⁰ = 8e-31. α = 6.3e-5 each.
#[test]
fn roulette_keeps_paths_by_their_throughput_and_their_sum() {
    const PATHS: u32 = 1 << 18;
    let world = balls();
    let twins = Twins::new(&world, SHADE, shade);
    let tints = [1.0f32, 0.7, 0.1].map(|v| Vec3::new(v, 0.5 * v, 0.25 * v));
    let throughputs = [tints[0], tints[1], tints[2], tints[2] * 1e-2, tints[0] * 1e-9, tints[0] * 1e-28];
    for (side, throughput) in SIDES.into_iter().flat_map(|side| throughputs.map(|t| (side, t))) {
        let ask = |bounce: u32, shape: u32, paths: u32| -> Vec<Row> {
            let questions: Vec<_> =
                (0..paths).map(|path| [row(throughput, bounce), [path, shape, 0, 0]]).collect();
            twins.answer(side, &questions).into_iter().flatten().collect()
        };
        let next = throughput * 0.5;
        let chance = f64::from(next.x).max(f64::from(LEAST_SURVIVAL_BY_THROUGHPUT));
        let alive: Vec<Row> =
            ask(ROULETTE_FROM_BOUNCE, 0, PATHS).into_iter().filter(|row| row[3] == 1).collect();
        let off =
            |p: f64| (alive.len() as f64 - p * f64::from(PATHS)) / (f64::from(PATHS) * p * (1.0 - p)).sqrt();
        assert!(
            off(chance).abs() < 4.0,
            "{side:?}: {throughput}: {} go on, {} sigma",
            alive.len(),
            off(chance)
        );
        // Weight × probability is 1, to the steps of the number that decides.
        for row in &alive {
            let kept = floats(*row).0.as_dvec3() * chance / next.as_dvec3();
            assert!((kept - 1.0).abs().max_element() < 4.0 * ROUNDING, "{side:?}: {throughput}: {kept}");
        }
        // Negative control: a chance 10 % greater.
        assert!(off(1.1 * chance).abs() > 4.0 || chance < 0.01, "{side:?}: {throughput}");
        // None is played on the first surfaces and at glass.
        assert!(
            ask(ROULETTE_FROM_BOUNCE - 1, 0, 1000).iter().all(|row| row[3] == 1 && floats(*row).0 == next)
        );
        assert!(ask(ROULETTE_FROM_BOUNCE, 1, 1000).iter().all(|row| row[3] == 1));
    }
}

/// The chance is met by the 2²⁴ numbers that decide to one of them: 1 in 2¹⁴ of the least chance.
#[test]
fn chances_of_roulette_are_met_by_the_numbers_that_decide() {
    for chance in [LEAST_SURVIVAL_BY_THROUGHPUT, 0.001_234_5, 0.05, 0.333_333_34, 0.9] {
        let below = (0..1u32 << 24).filter(|k| (*k as f32 / 16_777_216.0) < chance).count();
        let bias = below as f64 / 16_777_216.0 / f64::from(chance) - 1.0;
        assert!((0.0..6.2e-5).contains(&bias), "{chance}: {bias}");
    }
    // Negative control: what would become of a chance of 1e-9.
    let below = (0..1u32 << 24).filter(|k| (*k as f32 / 16_777_216.0) < 1e-9).count();
    assert!(below as f64 / 16_777_216.0 / 1e-9 > 50.0);
}
