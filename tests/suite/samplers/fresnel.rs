//! Glass: what is reflected, and where the rest goes.

use super::draw;
use super::materials::{geometries, material};
use super::twins::{SIDES, Side, Twins, World, Worst, all_obey, of_any_size};
use crate::oracles::bsdf::{cos2_refracted, fresnel as fresnel_oracle, fresnel_by_cosines};
use crate::oracles::sampling::ROUNDING;
use crate::probe::{floats, row};
use glam::{DVec3, Vec3, Vec4Swizzles};
use proptest::prelude::*;
use qtracer::bsdf::{bsdf_sample, fresnel};
use qtracer::math::to_world;
use qtracer::scene::compiled::KIND_DIELECTRIC;
use qtracer::scene::rows::Row;
use std::f64::consts::{PI, TAU};

/// How many of the 2²⁴ numbers that may be drawn choose reflection: counted by bisection, with the sampler itself. Besides,
/// where the last of them leads, and its weight. a: normal and index of refraction; b: towards the viewer, and whether outside.
const GLASS: (&str, &str) = (
    "import package::items::Material;
    import package::bsdf::interface::bsdf_sample;
    import package::scene::data::KIND_DIELECTRIC;",
    "var glass: Material;
    glass.color = vec3<f32>(0.9, 0.6, 0.3);
    glass.kind = KIND_DIELECTRIC;
    glass.parameter = bitcast<f32>(a.w);
    let normal = bitcast<vec3<f32>>(a.xyz);
    let wo = bitcast<vec3<f32>>(b.xyz);
    var low = 0u;
    var high = 16777216u;
    while low < high {
        let middle = (low + high) / 2u;
        let s = bsdf_sample(glass, normal, wo, b.w != 0u, vec3<f32>(f32(middle) / 16777216.0));
        if dot(s.wi, normal) > 0.0 { low = middle + 1u; } else { high = middle; }
    }
    let last = bsdf_sample(glass, normal, wo, b.w != 0u, vec3<f32>(16777215.0 / 16777216.0));
    out0 = vec4<u32>(bitcast<vec3<u32>>(last.wi), low);
    out1 = vec4<u32>(bitcast<vec3<u32>>(last.weight), bitcast<u32>(last.pdf));",
);

fn glass(_: &World, [a, b]: &[Row; 2]) -> [Row; 2] {
    let ((normal, ior), wo) = (floats(*a), floats(*b).0);
    let at = |k: u32| {
        let u = Vec3::splat(k as f32 / 16_777_216.0);
        bsdf_sample(&material(KIND_DIELECTRIC, ior), normal, wo, b[3] != 0, u)
    };
    let (mut low, mut high) = (0, 1 << 24);
    while low < high {
        let middle = (low + high) / 2;
        if at(middle).wi.dot(normal) > 0.0 { low = middle + 1 } else { high = middle }
    }
    let last = at((1 << 24) - 1);
    [row(last.wi, low), row(last.weight, last.pdf.to_bits())]
}

/// Light at a surface of glass: index of refraction, whether it comes from outside, normal, direction to the viewer.
type Incidence = (f32, bool, Vec3, Vec3);

/// 1 exactly, next to 1, up to 4; from both sides; from overhead to cosθ = 1e-7; within 1e-9 to 1e-2 of the critical angle.
fn incidences(normal: impl Strategy<Value = Vec3>) -> impl Strategy<Value = Incidence> {
    let ior = prop_oneof![
        1 => Just(1.0),
        2 => of_any_size(-7.0, 0.0).prop_map(|excess| 1.0 + excess),
        3 => 1.0..4.0f64,
        1 => Just(1.5),
        1 => Just(4.0),
    ];
    let cos = prop_oneof![(0.0..1.0f64).boxed(), of_any_size(-7.0, 0.0).boxed(), Just(1.0).boxed()];
    let critical = (any::<bool>(), of_any_size(-9.0, -2.0)).prop_map(|(s, d)| if s { d } else { -d });
    let angle = (cos, critical, 0..3u32, 0.0..TAU);
    (ior, any::<bool>(), angle, normal).prop_map(|(ior, outside, (cos, off, choice, phi), normal)| {
        let theta = if choice == 0 && ior > 1.0 { (1.0 / ior).asin() + off } else { cos.acos() };
        let (sin, cos) = (theta.sin(), theta.cos().abs().max(1e-7));
        let local = DVec3::new(sin * phi.cos(), sin * phi.sin(), cos).as_vec3();
        (ior as f32, outside, normal, if normal == Vec3::Z { local } else { to_world(local, normal) })
    })
}

fn ask(twins: &Twins<2, 2>, side: Side, incidences: &[Incidence]) -> Vec<[Row; 2]> {
    let question =
        |&(ior, outside, normal, wo): &Incidence| [row(normal, ior.to_bits()), row(wo, outside.into())];
    twins.answer(side, &incidences.iter().map(question).collect::<Vec<_>>())
}

fn eta(ior: f32, outside: bool) -> f64 {
    if outside { ior.into() } else { 1.0 / f64::from(ior) }
}

/// What reflectance may be if the cosine has an error of so many roundings, as that of two directions has.
fn reflectances(cos_i: f64, eta: f64, roundings: f64) -> (f64, f64) {
    let at = |off: f64| fresnel_by_cosines((cos_i + off * ROUNDING).clamp(0.0, 1.0), eta);
    let all = [at(-roundings), at(-0.5 * roundings), at(0.0), at(0.5 * roundings), at(roundings)];
    all.into_iter().fold((1.0, 0.0), |(low, high): (f64, f64), f| (low.min(f), high.max(f)))
}

/// The share of numbers that choose reflection is Fresnel's, as if the cosine were off by two roundings, and to four steps of
/// those numbers. Its complement is refracted: by energy 1 − F, in radiance 1/η² of that.
#[test]
fn glass_reflects_what_fresnel_says_and_refracts_the_rest() {
    let world = World::of_all_materials();
    let twins = Twins::new(&world, GLASS, glass);
    for side in SIDES {
        let (worst, worst_weight) = (Worst::default(), Worst::default());
        let faults = |asked: &[Incidence]| {
            let fault = |(&(ior, outside, _, wo), [a, b]): (&Incidence, [Row; 2])| {
                let (wo, eta) = (wo.as_dvec3(), eta(ior, outside));
                let cos_i = wo.z / wo.length();
                let (low, high) = reflectances(cos_i, eta, 2.0);
                let f = f64::from(a[3]) / 16_777_216.0;
                worst.see((f - fresnel_by_cosines(cos_i, eta)).abs());
                let off = (low - f).max(f - high) / ROUNDING;
                let through = floats(a).0.z < 0.0;
                let expected = if through {
                    material(0, 0.0).color.as_dvec3() / (eta * eta)
                } else {
                    material(0, 0.0).color.as_dvec3()
                };
                let weight = (floats(b).0.as_dvec3() / expected - 1.0).abs().max_element() / ROUNDING;
                worst_weight.see(weight);
                (!(off < 4.0 && weight < 6.0) || b[3] != 0)
                    .then(|| format!("{f} reflected for {low} to {high}, weight {weight} roundings off"))
            };
            asked.iter().zip(ask(&twins, side, asked)).map(fault).collect()
        };
        all_obey("reflectance", incidences(Just(Vec3::Z)), 40_000, faults);
        println!("{side:?}: reflectance {:e} off, weights {} roundings", worst.get(), worst_weight.get());
    }
    // Negative control: Schlick's approximation is not Fresnel's, nor is that of glass from the other side.
    let schlick = |cos: f64| 0.36 + 0.64 * (1.0 - cos).powi(5);
    assert!((schlick(0.3) - fresnel_oracle(0.3f64.acos(), 4.0)).abs() > 5e-2);
    assert!((fresnel_by_cosines(0.8, 1.5) - fresnel_by_cosines(0.8, 1.0 / 1.5)).abs() > 1e-2);
}

/// Reflected and refracted directions are those of mirror and Snell, about any normal: each component across the surface
/// to a few roundings for each that the cosine loses by ior², the length too, and on the right side.
#[test]
fn glass_sends_light_where_snell_says() {
    let world = World::of_all_materials();
    let twins = Twins::new(&world, GLASS, glass);
    for side in SIDES {
        let (worst, refracted) = (Worst::default(), std::cell::Cell::new(0u32));
        let faults = |asked: &[Incidence]| {
            let fault = |(&(ior, outside, normal, wo), [a, _]): (&Incidence, [Row; 2])| {
                let (n, wo, wi) = (normal.as_dvec3(), wo.as_dvec3(), floats(a).0.as_dvec3());
                let eta = eta(ior, outside);
                let across = |d: DVec3| d - n * d.dot(n);
                let cos_i = wo.dot(n);
                let through = wi.dot(n) < 0.0;
                refracted.set(refracted.get() + u32::from(through));
                let expected = if through { -across(wo) / eta } else { -across(wo) };
                let off = (across(wi) - expected).length().max((wi.length() - 1.0).abs()) / ROUNDING;
                // Beyond the critical angle, but for the cosine's rounding, all is reflected; before it not all.
                let nearer =
                    |roundings: f64| cos2_refracted((cos_i + roundings * ROUNDING).max(0.0), eta) > 0.0;
                if cos_i <= 2.0 * ROUNDING {
                    // Turned into the world, it looks from the other side.
                    return None;
                }
                let wrong = (through && !nearer(6.0)) || (!through && a[3] < 1 << 24);
                // What the cosine's rounding does to that of the refracted angle.
                let off = worst.see(off / (2.0 + 1.0 / (eta * eta)));
                (off >= 6.0 || off.is_nan() || wrong)
                    .then(|| format!("leads to {wi}, {off} roundings off, through: {through}"))
            };
            asked.iter().zip(ask(&twins, side, asked)).map(fault).collect()
        };
        let normals = prop_oneof![Just(Vec3::Z), crate::guiding_maths::normal()];
        all_obey("Snell", incidences(normals), 40_000, faults);
        println!("{side:?}: directions of glass are {} roundings off", worst.get());
        assert!(refracted.get() > 15_000);
    }
}

/// Glass of the index outside it is not there: from overhead to cosθ = 1e-7 every number sends light straight on, with weight
/// exactly the tint. Then reflectance and directions go to that continuously.
#[test]
fn glass_of_index_one_is_invisible() {
    let world = World::of_all_materials();
    let twins = Twins::new(&world, GLASS, glass);
    for side in SIDES {
        let faults = |asked: &[Incidence]| {
            let fault = |(&(_, _, _, wo), [a, b]): (&Incidence, [Row; 2])| {
                let wrong = a[3] > u32::from(side == Side::Gpu)
                    || (floats(a).0 + wo).length() > 2.5 * ROUNDING as f32
                    || floats(b).0 != material(0, 0.0).color;
                wrong.then(|| {
                    format!("{} of 2^24 reflected, direction {}, weight {}", a[3], floats(a).0, floats(b).0)
                })
            };
            asked.iter().zip(ask(&twins, side, asked)).map(fault).collect()
        };
        let invisible =
            incidences(Just(Vec3::Z)).prop_map(|(_, outside, normal, wo)| (1.0, outside, normal, wo));
        all_obey("invisible glass", invisible, 20_000, faults);
    }
    // Negative control: an index a millionth above is seen at grazing angles.
    let wo = Vec3::new(1.0, 0.0, 1e-4);
    assert!(ask(&twins, Side::Gpu, &[(1.000_001, true, Vec3::Z, wo)])[0][0][3] > 1 << 23);
}

fn fresnel_f32(theta_i: f64, eta: f64) -> f32 {
    let cos_t = (1.0 - (theta_i.sin() / eta).powi(2)).max(0.0).sqrt();
    fresnel(theta_i.cos() as f32, cos_t as f32, eta as f32)
}

#[test]
fn fresnel_reflectance_is_that_of_the_sine_and_tangent_laws() {
    for eta in [1.0 / 4.0, 1.0 / 1.5, 0.9, 1.01, 1.2, 1.5, 2.4, 4.0] {
        for step in 0..90 {
            let theta = f64::from(step).to_radians();
            let (oracle, f) = (fresnel_oracle(theta, eta), f64::from(fresnel_f32(theta, eta)));
            assert!((f - oracle).abs() < 2e-6, "η {eta}, {step}°: {f} for {oracle}");
            assert!((fresnel_by_cosines(theta.cos(), eta) - oracle).abs() < 1e-9, "η {eta}, {step}°");
        }
        // Grazing incidence reflects everything.
        assert!(fresnel_f32(PI / 2.0 - 1e-5, eta) > 0.999);
    }
}

/// Reflection is chosen as often as Fresnel says, by the program's own numbers. α = 6.3e-5 each.
#[test]
fn glass_reflects_as_often_as_fresnel_says() {
    let glass = material(KIND_DIELECTRIC, 1.5);
    let n = 100_000;
    for (normal, wo) in geometries() {
        let reflected = (0..n)
            .filter(|&i| bsdf_sample(&glass, normal, wo, true, draw(i).xyz()).wi.dot(normal) > 0.0)
            .count() as f64;
        let p = fresnel_oracle(f64::from(normal.dot(wo).min(1.0)).acos(), 1.5);
        let sigma = (f64::from(n) * p * (1.0 - p)).sqrt();
        assert!((reflected - f64::from(n) * p).abs() < 4.0 * sigma, "{reflected} of {n}, expected {p}");
    }
}
