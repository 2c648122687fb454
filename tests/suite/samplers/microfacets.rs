//! Rough metal, glTF's material and rough glass: what they draw against their densities, both against f64.

use super::twins::{SIDES, Side, Twins, World, Worst, all_obey, of_any_size};
use super::{Cells, DRAW, DRAW_IMPORTS, WRONG, draw};
use crate::oracles::ggx::{Answer, Rough, above, stretched_density, stretched_facet};
use crate::oracles::sampling::ROUNDING;
use crate::probe::{Numbers, floats, row};
use glam::{DVec3, Vec3, Vec4Swizzles};
use proptest::prelude::*;
use qtracer::bsdf::{bsdf_evaluate, bsdf_sample};
use qtracer::math::{luminance, to_world};
use qtracer::scene::compiled::{
    KIND_METAL, KIND_METALLIC_ROUGHNESS, KIND_ROUGH_DIELECTRIC, LEAST_ALPHA, Material,
};
use qtracer::scene::rows::Row;

pub const COLOR: Vec3 = Vec3::new(0.9, 0.6, 0.3);

/// A direction drawn by the material, and what it says of that and of another. a: normal and number of the draw; b: towards the
/// viewer, and whether outside; c: kind, index of refraction, roughness, metallic; d: the other direction.
const SCATTER: (&str, &str) = (
    "import package::items::Material;
    import package::bsdf::interface::{bsdf_sample, bsdf_evaluate};",
    "var material: Material;
    material.color = vec3<f32>(0.9, 0.6, 0.3);
    material.kind = c.x;
    material.parameter = bitcast<f32>(c.y);
    material.roughness = bitcast<f32>(c.z);
    material.metallic = bitcast<f32>(c.w);
    let normal = bitcast<vec3<f32>>(a.xyz);
    let wo = bitcast<vec3<f32>>(b.xyz);
    let s = bsdf_sample(material, normal, wo, b.w != 0u, u.xyz);
    let value = bsdf_evaluate(material, normal, wo, b.w != 0u, bitcast<vec3<f32>>(d.xyz));
    out0 = vec4<u32>(bitcast<vec3<u32>>(s.wi), bitcast<u32>(s.pdf));
    out1 = vec4<u32>(bitcast<vec3<u32>>(s.weight), 0u);
    out2 = vec4<u32>(bitcast<vec3<u32>>(value.value), bitcast<u32>(value.pdf));",
);

fn scatter(_: &World, [a, b, c, d]: &[Row; 4]) -> [Row; 3] {
    let [parameter, roughness, metallic] = [c[1], c[2], c[3]].map(f32::from_bits);
    let material =
        Material { color: COLOR, kind: c[0], parameter, roughness, metallic, ..Default::default() };
    let ((normal, _), (wo, _), outside) = (floats(*a), floats(*b), b[3] != 0);
    let s = bsdf_sample(&material, normal, wo, outside, draw(a[3]).xyz());
    let value = bsdf_evaluate(&material, normal, wo, outside, floats(*d).0);
    [row(s.wi, s.pdf.to_bits()), row(s.weight, 0), row(value.value, value.pdf.to_bits())]
}

pub type ScatterTwins<'a> = Twins<'a, 4, 3>;

pub fn twins(world: &World) -> ScatterTwins<'_> {
    let (imports, body) = (format!("{DRAW_IMPORTS}{}", SCATTER.0), format!("{DRAW}{}", SCATTER.1));
    Twins::new(world, (&imports, &body), scatter)
}

/// A material and the side from which it is seen.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    pub kind: u32,
    pub ior: f32,
    pub roughness: f32,
    pub metallic: f32,
    pub outside: bool,
}

pub fn metal(roughness: f32) -> Seen {
    Seen { kind: KIND_METAL, ior: 0.0, roughness, metallic: 0.0, outside: true }
}

pub fn coated(metallic: f32, roughness: f32) -> Seen {
    Seen { kind: KIND_METALLIC_ROUGHNESS, metallic, ..metal(roughness) }
}

pub fn glass(ior: f32, roughness: f32, outside: bool) -> Seen {
    Seen { kind: KIND_ROUGH_DIELECTRIC, ior, outside, ..metal(roughness) }
}

impl Seen {
    pub fn material(&self) -> Material {
        let Seen { kind, ior: parameter, roughness, metallic, .. } = *self;
        Material { color: COLOR, kind, parameter, roughness, metallic, ..Default::default() }
    }

    pub fn alpha(&self) -> f64 {
        f64::from(self.roughness * self.roughness).max(LEAST_ALPHA.into())
    }

    pub fn rough(&self) -> Rough {
        match self.kind {
            KIND_METAL => Rough::Metal,
            KIND_METALLIC_ROUGHNESS => Rough::Coated(self.metallic.into()),
            _ => Rough::Glass(self.eta()),
        }
    }

    pub fn eta(&self) -> f64 {
        if self.outside { self.ior.into() } else { 1.0 / f64::from(self.ior) }
    }

    pub fn question(&self, normal: Vec3, wo: Vec3, i: u32, wi: Vec3) -> [Row; 4] {
        let numbers = [self.ior, self.roughness, self.metallic].map(f32::to_bits);
        let material = [self.kind, numbers[0], numbers[1], numbers[2]];
        [row(normal, i), row(wo, self.outside.into()), material, row(wi, 0)]
    }

    /// The red channel, in f64.
    fn oracle(&self, [normal, wo, wi]: [DVec3; 3]) -> Answer {
        let z = normal.normalize();
        let x = z.any_orthonormal_vector();
        let local = |d: DVec3| DVec3::new(d.dot(x), d.dot(z.cross(x)), d.dot(z));
        let color = [COLOR.x, luminance(COLOR)].map(f64::from);
        self.rough().evaluate(color, self.alpha(), local(wo), local(wi))
    }
}

/// What a material chose, and what it said of the other direction.
pub struct Scattered {
    pub wi: Vec3,
    pub pdf: f32,
    pub weight: Vec3,
    pub value: Vec3,
    pub evaluated: f32,
}

pub fn scattered([a, b, c]: [Row; 3]) -> Scattered {
    let ((wi, pdf), weight, (value, evaluated)) = (floats(a), floats(b).0, floats(c));
    Scattered { wi, pdf, weight, value, evaluated }
}

/// The first `count` draws.
pub fn draws(
    twins: &ScatterTwins,
    side: Side,
    seen: &Seen,
    (normal, wo): (Vec3, Vec3),
    count: u32,
) -> Vec<Scattered> {
    let questions: Vec<_> = (0..count).map(|i| seen.question(normal, wo, i, Vec3::Z)).collect();
    twins.answer(side, &questions).into_iter().map(scattered).collect()
}

/// A normal, and directions to the viewer from overhead to grazing.
fn geometries() -> [(Vec3, Vec3); 3] {
    let normal = Vec3::new(0.3, -0.5, 0.8).normalize();
    let at = |cos: f64, phi: f64| (normal, to_world(above(cos, phi).as_vec3(), normal).normalize());
    [at(0.999, 0.3), at(0.5, 1.0), at(0.2, 4.0)]
}

/// What is drawn follows the density, and what is lost below the horizon is what it lacks to one.
#[test]
fn rough_directions_follow_their_density() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    let all = [
        metal(1.0),
        metal(0.5),
        coated(0.0, 0.6),
        coated(0.5, 0.4),
        glass(1.5, 0.8, true),
        glass(1.5, 0.7, false),
        glass(4.0, 1.0, true),
    ];
    for (m, seen) in all.iter().enumerate() {
        for (g, (normal, wo)) in geometries().into_iter().enumerate() {
            // Refraction makes lobes narrower.
            let rows = if seen.kind == KIND_ROUGH_DIELECTRIC { 24 } else { 12 };
            let cells = Cells { rows, columns: 8, ..Cells::sphere(normal) };
            let density =
                |d: Vec3| f64::from(bsdf_evaluate(&seen.material(), normal, wo, seen.outside, d).pdf);
            let integrals = cells.integrate(density);
            let integral: f64 = integrals.iter().sum();
            assert!(integral < 1.002, "{seen:?}: the density integrates to {integral}");
            let side = SIDES[(m + g) % 2];
            let drawn = draws(&twins, side, seen, (normal, wo), 1 << 18);
            let lost = drawn.iter().filter(|s| s.pdf <= 0.0).count() as f64 / f64::from(1 << 18);
            assert!((integral + lost - 1.0).abs() < 6e-3, "{seen:?}: {integral} and {lost} lost");
            let drawn: Vec<_> = drawn.iter().map(|s| (s.pdf > 0.0).then_some(s.wi)).collect();
            cells.are_followed(&format!("{side:?}: {seen:?}, geometry {g}"), &drawn, &integrals);
        }
    }
}

/// Facets are drawn as the viewer sees them, of every roughness: stretched to α = 1, where their density is a cosine.
#[test]
fn facets_are_drawn_as_they_are_seen() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    let cells = Cells { rows: 12, columns: 8, ..Cells::hemisphere(Vec3::Z) };
    let geometry = |cos: f64| (Vec3::Z, above(cos, 0.7).as_vec3());
    for (side, roughness) in SIDES.into_iter().flat_map(|s| [0.0f32, 0.1, 0.3, 1.0].map(|r| (s, r))) {
        for cos in [1.0, 0.6, 0.02] {
            let (seen, at) = (metal(roughness), geometry(cos));
            let o = at.1.as_dvec3();
            // Where light falls below the horizon, wi is drawn all the same.
            let facet = |s: &Scattered| Some(stretched_facet(o, s.wi.as_dvec3(), seen.alpha()).as_vec3());
            let drawn: Vec<_> = draws(&twins, side, &seen, at, 1 << 17).iter().map(facet).collect();
            let density = |alpha: f64| cells.integrate(|m| stretched_density(o, alpha, m.as_dvec3()));
            let what = format!("{side:?}: facets of roughness {roughness}, cosθ {cos}");
            cells.are_followed(&what, &drawn, &density(seen.alpha()));
            // Negative control: facets as they lie, not as they are seen.
            let lying = cells.integrate(|m| f64::from(m.z) * std::f64::consts::FRAC_1_PI);
            let p = cells.p_value(drawn.iter().copied(), &lying);
            assert!(p < WRONG || cos == 1.0 || roughness < 0.3, "{what}: p = {p}");
        }
    }
}

/// How far the found answer is from the oracle's: as a multiple of how far that moves if a direction is off by two roundings,
/// and four of its own.
fn off(seen: &Seen, [normal, wo, wi]: [Vec3; 3], found: Answer) -> f64 {
    let [n, o, i] = [normal, wo, wi].map(|v| v.as_dvec3());
    let exact = seen.oracle([n, o, i]);
    let step = 2.0 * ROUNDING;
    let nudges = [DVec3::X, DVec3::Y, DVec3::Z].map(|d| d * step);
    let nudged = nudges.iter().flat_map(|&d| {
        [[n + d, o, i], [n - d, o, i], [n, o + d, i], [n, o - d, i], [n, o, i + d], [n, o, i - d]]
    });
    let (mut value, mut pdf) = (0.0f64, 0.0f64);
    for question in nudged {
        let answer = seen.oracle(question);
        value = value.max((answer.value - exact.value).abs());
        pdf = pdf.max((answer.pdf - exact.pdf).abs());
    }
    let of = |found: f64, exact: f64, spread: f64| {
        (found - exact).abs() / (spread + 4.0 * ROUNDING * exact.abs() + 1e-30)
    };
    of(found.value, exact.value, value).max(of(found.pdf, exact.pdf, pdf))
}

/// What a material says of directions drawn by itself: f·cosθ and density are those of the papers, at every roughness.
/// At the edges of lobes, where the horizon or the critical angle is within rounding, either answer is right.
#[test]
fn rough_materials_answer_as_f64_does() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    let mut numbers = Numbers(17);
    for seen in every_kind() {
        let questions: Vec<_> = (0..4000)
            .map(|i| {
                let n = numbers.direction().as_vec3();
                let cos = numbers.of_any_size(1e-2, 1.0);
                let wo = to_world(above(cos, numbers.between(0.0, 6.0)).as_vec3(), n).normalize();
                (n, wo, i)
            })
            .collect();
        for side in SIDES {
            let ask = |wi: &dyn Fn(usize) -> Vec3| -> Vec<Scattered> {
                let rows = questions.iter().enumerate().map(|(k, &(n, o, i))| seen.question(n, o, i, wi(k)));
                twins.answer(side, &rows.collect::<Vec<_>>()).into_iter().map(scattered).collect()
            };
            let drawn = ask(&|_| Vec3::Z);
            let (worst, mut compared) = (Worst::default(), 0);
            for (k, s) in ask(&|k| drawn[k].wi).iter().enumerate() {
                let (n, o, _) = questions[k];
                if s.wi.dot(n).abs() < 1e-5 || s.pdf <= 0.0 {
                    continue;
                }
                compared += 1;
                let evaluated = Answer { value: s.value.x.into(), pdf: s.evaluated.into() };
                let drawn = Answer { value: f64::from(s.weight.x) * f64::from(s.pdf), pdf: s.pdf.into() };
                for found in [evaluated, drawn] {
                    let roundings = worst.see(off(&seen, [n, o, s.wi], found));
                    let exact = seen.oracle([n, o, s.wi].map(|v| v.as_dvec3()));
                    assert!(
                        roundings < 4.0,
                        "{side:?}, {seen:?}, cosθ {}: {found:?} for {exact:?}",
                        n.dot(o)
                    );
                }
            }
            println!("{side:?}: {seen:?}: {:.1} of what roundings may do, {compared} compared", worst.get());
            assert!(compared > 2000, "{seen:?}: {compared}");
        }
    }
    // Negative control: a roughness a thousandth greater.
    let [n, o, i] = [Vec3::Z, above(0.6, 0.0).as_vec3(), above(0.6, 3.1).as_vec3()];
    let wrong = metal(0.5005).oracle([n, o, i].map(|v| v.as_dvec3()));
    assert!(off(&metal(0.5), [n, o, i], wrong) > 100.0);
}

/// Each kind at roughnesses from 0 on, glass from both sides.
fn every_kind() -> Vec<Seen> {
    let of = |r: f32| {
        let glasses = [(1.5, true), (1.5, false), (1.05, true), (10.0, true), (10.0, false)];
        let glasses = glasses.map(|(ior, outside)| glass(ior, r, outside));
        [metal(r), coated(0.0, r), coated(0.3, r), coated(1.0, r)].into_iter().chain(glasses)
    };
    [0.0, 0.1, 0.4, 1.0].into_iter().flat_map(of).collect()
}

/// Light that goes the other way is scattered as much, but for the squeezing of radiance by η² where it goes through.
#[test]
fn rough_materials_scatter_both_ways_alike() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    let mut numbers = Numbers(19);
    for seen in every_kind().into_iter().filter(|seen| seen.roughness > 0.3) {
        let pairs: Vec<(Vec3, Vec3)> = (0..4000)
            .map(|_| {
                let mut direction = |sign: f64| {
                    let d = above(numbers.between(0.05, 1.0), numbers.between(0.0, 6.0));
                    DVec3::new(d.x, d.y, d.z * sign).as_vec3()
                };
                let through = seen.kind == KIND_ROUGH_DIELECTRIC;
                (direction(1.0), direction(if through { -1.0 } else { 1.0 }))
            })
            .collect();
        let there = pairs.iter().map(|&(a, b)| seen.question(Vec3::Z, a, 0, b));
        let back = pairs.iter().map(|&(a, b)| {
            let turned = Seen { outside: seen.outside == (b.z > 0.0), ..seen };
            turned.question(Vec3::Z * b.z.signum(), b, 0, a)
        });
        for side in SIDES {
            let answers = |questions: Vec<[Row; 4]>| -> Vec<Scattered> {
                twins.answer(side, &questions).into_iter().map(scattered).collect()
            };
            let (there, back) = (answers(there.clone().collect()), answers(back.clone().collect()));
            let mut alike = 0;
            for ((a, b), (there, back)) in pairs.iter().zip(there.iter().zip(&back)) {
                let squeezed = if b.z < 0.0 { seen.eta() * seen.eta() } else { 1.0 };
                // f·cosθ at the far end over its cosine.
                let (f, g) = (f64::from(there.value.x / b.z.abs()) * squeezed, f64::from(back.value.x / a.z));
                if f.max(g) < 1e-6 {
                    continue;
                }
                alike += 1;
                assert!((f - g).abs() < 2e-3 * g + 1e-6, "{side:?}, {seen:?}, {a} and {b}: {f} and {g}");
            }
            assert!(alike > 50, "{side:?}, {seen:?}: {alike}");
        }
    }
}

/// Anything that may be asked: all that is answered is finite and no more than was there.
#[test]
fn rough_materials_stay_finite_at_every_extreme() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    let share = || prop_oneof![Just(0.0f32), Just(1.0), Just(1e-4), 0.0..1.0f32];
    let ior = prop_oneof![Just(1.0f32), Just(1.000_001), Just(1.001), Just(4.0), Just(10.0), 1.0..10.0f32];
    let kind = KIND_METAL..=KIND_ROUGH_DIELECTRIC;
    let cos = prop_oneof![
        of_any_size(-8.0, 0.0).boxed(),
        Just(0.0).boxed(),
        Just(1.0).boxed(),
        of_any_size(-8.0, -1.0).prop_map(|c| -c).boxed()
    ];
    let seen =
        (kind, ior, share(), share(), any::<bool>()).prop_map(|(kind, ior, roughness, metallic, outside)| {
            Seen { kind, ior, roughness, metallic, outside }
        });
    let questions = (seen, cos.clone(), cos, any::<bool>(), 0..1u32 << 20);
    for side in SIDES {
        let worst = Worst::default();
        let faults = |asked: &[(Seen, f64, f64, bool, u32)]| {
            let rows: Vec<_> = asked
                .iter()
                .map(|(seen, o, i, straight, k)| {
                    // Straight on through the surface, and anywhere.
                    let wo = above(*o, 0.4).as_vec3();
                    let wi = if *straight { -wo } else { above(*i, 2.0).as_vec3() };
                    seen.question(Vec3::Z, wo, *k, wi)
                })
                .collect();
            let fault = |((seen, o, ..), answer): (&(Seen, f64, f64, bool, u32), [Row; 3])| {
                let s = scattered(answer);
                let finite = s.wi.is_finite() && s.weight.is_finite() && s.value.is_finite();
                let pdfs = [s.pdf, s.evaluated].iter().all(|p| p.is_finite() && *p >= 0.0);
                let unit = (s.wi.length() - 1.0).abs() < 1e-5;
                let squeezed = if s.wi.z < 0.0 { 1.0 / (seen.eta() * seen.eta()) } else { 1.0 };
                // The weight of a mixture may be more than one, but not by much: see the albedos.
                let most = if seen.kind == KIND_METALLIC_ROUGHNESS { 3.0 } else { 1.0 + 1e-5 };
                let weight = f64::from(s.weight.max_element()) / squeezed.max(1.0);
                worst.see(if *o > 0.0 { weight } else { 0.0 });
                let fair = s.weight.min_element() >= 0.0 && (*o <= 0.0 || weight <= most);
                (!(finite && pdfs && unit && fair)).then(|| {
                    format!(
                        "wi {}, weight {}, pdf {}, value {}, pdf {}",
                        s.wi, s.weight, s.pdf, s.value, s.evaluated
                    )
                })
            };
            asked.iter().zip(twins.answer(side, &rows)).map(fault).collect()
        };
        all_obey("finite answers", questions.clone(), 100_000, faults);
        println!("{side:?}: the greatest weight is {}", worst.get());
    }
}
