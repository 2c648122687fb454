//! What rough materials send back of light from everywhere, against quadrature in f64; and what becomes of them where
//! roughness goes to 0 and an index of refraction to 1.

use super::microfacets::{COLOR, Seen, coated, draws, glass, metal, twins};
use super::twins::{SIDES, World};
use crate::oracles::bsdf::fresnel_by_cosines;
use crate::oracles::ggx::{above, schlick};
use crate::oracles::sampling::ROUNDING;
use glam::{DVec3, Vec3};
use qtracer::math::mirrored;

const DRAWS: u32 = 1 << 15;

/// Mean and standard error.
fn mean(values: impl ExactSizeIterator<Item = f64> + Clone) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.clone().sum::<f64>() / n;
    let variance = values.map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// Mean weights are albedos: to 4.5 standard errors, α = 7e-6 each, and the 2e-4 of the quadrature. What scatters once is no
/// more than came, of any colour up to white.
#[test]
fn rough_materials_send_back_what_quadrature_says() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    let mut most = 0.0f64;
    for roughness in [0.0f32, 0.1, 0.25, 0.5, 0.75, 1.0] {
        let all = [
            metal(roughness),
            coated(0.0, roughness),
            coated(0.5, roughness),
            coated(1.0, roughness),
            glass(1.5, roughness, true),
            glass(1.5, roughness, false),
            glass(10.0, roughness, true),
        ];
        for (k, seen) in all.iter().enumerate() {
            for (g, cos) in [1.0, 0.6, 0.2, 0.03].into_iter().enumerate() {
                let o = above(cos, 0.0);
                let white = seen.rough().albedo(1.0, seen.alpha(), o);
                most = most.max(white);
                assert!(white <= 1.0, "{seen:?}, cosθ {cos}: {white} of white comes back");
                let exact = seen.rough().albedo(COLOR.x.into(), seen.alpha(), o);
                let side = SIDES[(k + g) % 2];
                let drawn = draws(&twins, side, seen, (Vec3::Z, o.as_vec3()), DRAWS);
                let share = |s: &super::microfacets::Scattered| {
                    let squeezed = if s.wi.z < 0.0 { seen.eta() * seen.eta() } else { 1.0 };
                    f64::from(s.weight.x) * squeezed
                };
                let (found, error) = mean(drawn.iter().map(share));
                let off = (found - exact).abs();
                assert!(
                    off < 4.5 * error + 2e-4,
                    "{side:?}: {seen:?}, cosθ {cos}: {found} ± {error} for {exact}"
                );
                // Negative control: 5 % more.
                assert!((found - 1.05 * exact).abs() > 4.5 * error + 2e-4, "{seen:?}, cosθ {cos}: ± {error}");
            }
        }
    }
    println!("at most {most} of white comes back");
}

/// No coat together with its base returns more than arrives, in steps finer than its excess is wide.
#[test]
fn coats_gain_nothing_at_any_roughness_and_angle() {
    let mut most = 0.0f64;
    for r in 0..=25 {
        for c in 1..=25 {
            let seen = coated(0.0, r as f32 / 25.0);
            most = most.max(seen.rough().albedo(1.0, seen.alpha(), above(f64::from(c) / 25.0, 0.0)));
        }
    }
    println!("at most {most} of white comes back from coats");
    assert!(most <= 1.0 && most > 0.99, "{most}");
}

/// The least roughness is all but a mirror: every direction within some 50 α of it, the weight a smooth one's.
#[test]
fn smooth_metal_is_a_mirror() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    for (side, cos) in SIDES.into_iter().flat_map(|side| [1.0, 0.5, 0.1].map(|cos| (side, cos))) {
        let wo = above(cos, 1.0).as_vec3();
        let spread = |seen: Seen| {
            let drawn = draws(&twins, side, &seen, (Vec3::Z, wo), 2000);
            let axis = mirrored(-wo, Vec3::Z);
            let mut away: Vec<f32> = drawn.iter().map(|s| (s.wi - axis).length()).collect();
            away.sort_by(f32::total_cmp);
            let (weight, _) = mean(drawn.iter().map(|s| f64::from(s.weight.x)));
            (f64::from(away[1000]), f64::from(away[1980]), weight)
        };
        let (median, far, weight) = spread(metal(0.0));
        let smooth = schlick(COLOR.x.into(), cos);
        assert!(median < 3e-3 && far < 3e-2, "{side:?}, cosθ {cos}: {median}, {far}");
        assert!((weight / smooth - 1.0).abs() < 2e-3, "{side:?}, cosθ {cos}: {weight} for {smooth}");
        // Roughness counts squared, from 0.032 on.
        assert_eq!(spread(metal(0.03)), (median, far, weight));
        let ratio = spread(metal(0.2)).0 / spread(metal(0.1)).0;
        assert!((ratio - 4.0).abs() < 0.6, "{side:?}, cosθ {cos}: spread by {ratio}");
    }
}

/// … and all but smooth glass: what is reflected is reflected by Fresnel, and the rest goes where Snell says.
#[test]
fn smooth_rough_glass_is_smooth_glass() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    for (side, cos) in SIDES.into_iter().flat_map(|side| [0.99, 0.5, 0.2].map(|cos| (side, cos))) {
        for seen in [glass(1.5, 0.0, true), glass(1.5, 0.0, false)] {
            let (o, eta) = (above(cos, 1.0), seen.eta());
            let drawn = draws(&twins, side, &seen, (Vec3::Z, o.as_vec3()), 1 << 14);
            let reflected = drawn.iter().filter(|s| s.wi.z > 0.0).count() as f64 / f64::from(1 << 14);
            let exact = fresnel_by_cosines(cos, eta);
            let error = (exact * (1.0 - exact) / f64::from(1 << 14)).sqrt();
            assert!(
                (reflected - exact).abs() < 4.5 * error + 2e-3,
                "{side:?}: {seen:?}: {reflected} for {exact}"
            );
            let through = -DVec3::new(o.x, o.y, 0.0) / eta;
            let aside = |s: &&super::microfacets::Scattered| {
                let target = if s.wi.z > 0.0 { through * eta } else { through };
                (s.wi.as_dvec3() - target).truncate().length() < 0.03
            };
            let near = drawn.iter().filter(aside).count();
            assert!(near * 50 > drawn.len() * 49, "{side:?}: {seen:?}: {near} of {}", drawn.len());
        }
    }
}

/// Rough glass of the index around it is not there, whatever its roughness: straight on, with its tint, to rounding. Where
/// the index goes to that, so does what comes through.
#[test]
fn rough_glass_of_index_one_is_invisible() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    for (side, roughness) in SIDES.into_iter().flat_map(|side| [0.0f32, 0.5, 1.0].map(|r| (side, r))) {
        for cos in [1.0, 0.5, 1e-3, 1e-6] {
            let wo = above(cos, 1.0).as_vec3();
            for outside in [false, true] {
                for s in draws(&twins, side, &glass(1.0, roughness, outside), (Vec3::Z, wo), 1000) {
                    let right =
                        (s.wi + wo).length() < 2.5 * ROUNDING as f32 && s.weight == COLOR && s.pdf == 0.0;
                    assert!(right, "{side:?}, cosθ {cos}: {} with weight {}", s.wi, s.weight);
                }
            }
        }
        // A millionth more: bent by as much at most, but where light grazes.
        let wo = above(0.5, 1.0).as_vec3();
        for s in draws(&twins, side, &glass(1.000_001, roughness, true), (Vec3::Z, wo), 1000) {
            assert!((s.wi + wo).length() < 1e-5, "{side:?}, roughness {roughness}: {}", s.wi);
        }
        // Negative control: an index of 1.1 is seen where it is rough.
        let bent = draws(&twins, side, &glass(1.1, 1.0, true), (Vec3::Z, wo), 1000);
        assert!(bent.iter().any(|s| (s.wi + wo).length() > 0.05));
    }
}
