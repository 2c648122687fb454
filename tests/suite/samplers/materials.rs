//! Directions that materials choose.

use super::twins::{SIDES, Side, Twins, World, Worst};
use super::{Cells, DRAW, DRAW_IMPORTS, WRONG, draw};
use crate::oracles::bsdf::glossy;
use crate::oracles::sampling::ROUNDING;
use crate::probe::{Numbers, floats, row};
use glam::{Vec3, Vec4Swizzles};
use qtracer::bsdf::{bsdf_evaluate, bsdf_sample};
use qtracer::math::to_world;
use qtracer::sampling::pdf_phong;
use qtracer::scene::compiled::{KIND_DIELECTRIC, KIND_DIFFUSE, KIND_GLOSSY, KIND_MIRROR, Material};
use qtracer::scene::rows::Row;

const COLOR: Vec3 = Vec3::new(0.9, 0.6, 0.3);

pub fn material(kind: u32, parameter: f32) -> Material {
    Material { color: COLOR, kind, parameter, ..Default::default() }
}

/// A direction drawn by the material (a: normal and number of the draw; b: towards the viewer; c: kind, parameter, whether
/// outside), and what the material says of it.
pub const SCATTER: (&str, &str) = (
    "import package::items::Material;
    import package::bsdf::interface::{bsdf_sample, bsdf_evaluate};",
    "var material: Material;
    material.color = vec3<f32>(0.9, 0.6, 0.3);
    material.kind = c.x;
    material.parameter = bitcast<f32>(c.y);
    let normal = bitcast<vec3<f32>>(a.xyz);
    let wo = bitcast<vec3<f32>>(b.xyz);
    let s = bsdf_sample(material, normal, wo, c.z != 0u, u.xyz);
    let value = bsdf_evaluate(material, normal, wo, c.z != 0u, s.wi);
    out0 = vec4<u32>(bitcast<vec3<u32>>(s.wi), bitcast<u32>(s.pdf));
    out1 = vec4<u32>(bitcast<vec3<u32>>(s.weight), 0u);
    out2 = vec4<u32>(bitcast<vec3<u32>>(value.value), bitcast<u32>(value.pdf));",
);

fn scatter(_: &World, [a, b, c]: &[Row; 3]) -> [Row; 3] {
    let material = material(c[0], f32::from_bits(c[1]));
    let (normal, wo) = (floats(*a).0, floats(*b).0);
    let s = bsdf_sample(&material, normal, wo, c[2] != 0, draw(a[3]).xyz());
    let value = bsdf_evaluate(&material, normal, wo, c[2] != 0, s.wi);
    [row(s.wi, s.pdf.to_bits()), row(s.weight, 0), row(value.value, value.pdf.to_bits())]
}

type ScatterTwins<'a> = Twins<'a, 3, 3>;

fn twins(world: &World) -> ScatterTwins<'_> {
    let (imports, body) = (format!("{DRAW_IMPORTS}{}", SCATTER.0), format!("{DRAW}{}", SCATTER.1));
    Twins::new(world, (&imports, &body), scatter)
}

fn question(material: &Material, normal: Vec3, wo: Vec3, i: u32) -> [Row; 3] {
    [row(normal, i), row(wo, 0), [material.kind, material.parameter.to_bits(), 1, 0]]
}

/// What a material chose.
struct Scattered {
    wi: Vec3,
    pdf: f32,
    weight: Vec3,
    /// f·cosθ and the density, evaluated.
    value: Vec3,
    evaluated: f32,
}

fn scattered([a, b, c]: [Row; 3]) -> Scattered {
    let ((wi, pdf), weight, (value, evaluated)) = (floats(a), floats(b).0, floats(c));
    Scattered { wi, pdf, weight, value, evaluated }
}

/// The first `count` draws.
fn draws(
    twins: &ScatterTwins,
    side: Side,
    material: &Material,
    (normal, wo): (Vec3, Vec3),
    count: u32,
) -> Vec<Scattered> {
    let questions: Vec<_> = (0..count).map(|i| question(material, normal, wo, i)).collect();
    twins.answer(side, &questions).into_iter().map(scattered).collect()
}

/// Materials with a lobe that is no delta, and what they are called.
fn materials() -> [(&'static str, Material); 6] {
    [
        ("diffuse", material(KIND_DIFFUSE, 0.0)),
        ("mirror 0.3", material(KIND_MIRROR, 0.3)),
        ("mirror 0", material(KIND_MIRROR, 0.0)),
        ("glossy 0", material(KIND_GLOSSY, 0.0)),
        ("glossy 3", material(KIND_GLOSSY, 3.0)),
        ("glossy 20", material(KIND_GLOSSY, 20.0)),
    ]
}

/// A normal and directions to the viewer from overhead to grazing.
pub fn geometries() -> Vec<(Vec3, Vec3)> {
    let normal = Vec3::new(0.3, -0.5, 0.8).normalize();
    let at = |cos: f32, phi: f32| {
        let sin = (1.0 - cos * cos).sqrt();
        to_world(Vec3::new(sin * phi.cos(), sin * phi.sin(), cos), normal)
    };
    vec![(normal, normal), (normal, at(0.7, 1.0)), (normal, at(0.25, 4.0)), (normal, at(0.02, 2.5))]
}

/// What bsdf_sample draws is what bsdf_evaluate says; the share of delta lobes gives no direction. The lobe folded at the
/// horizon is weighed at grazing angles too.
#[test]
fn bsdf_directions_follow_their_density() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    for (m, (name, material)) in materials().into_iter().enumerate() {
        for (g, (normal, wo)) in geometries().into_iter().enumerate() {
            let cells = Cells { rows: 12, columns: 8, ..Cells::hemisphere(normal) };
            let integrals = cells.integrate(|d| f64::from(bsdf_evaluate(&material, normal, wo, true, d).pdf));
            let smooth = if material.kind == KIND_MIRROR { 1.0 - f64::from(material.parameter) } else { 1.0 };
            let integral: f64 = integrals.iter().sum();
            assert!((integral / smooth - 1.0).abs() < 2e-3, "{name}: the density integrates to {integral}");
            // Every second of them on both sides.
            for side in &SIDES[..1 + (m + g) % 2] {
                let drawn = draws(&twins, *side, &material, (normal, wo), 1 << 18);
                let drawn: Vec<_> = drawn.iter().map(|s| (s.pdf > 0.0).then_some(s.wi)).collect();
                cells.are_followed(&format!("{side:?}: {name}, cosθ {}", normal.dot(wo)), &drawn, &integrals);
            }
        }
    }
    // Negative control: the unfolded lobe loses what is below the horizon.
    let (normal, wo) = geometries()[2];
    let cells = Cells { rows: 12, columns: 8, ..Cells::hemisphere(normal) };
    let axis = -wo + normal * (2.0 * wo.dot(normal));
    let drawn = draws(&twins, Side::Gpu, &material(KIND_GLOSSY, 20.0), (normal, wo), 100_000);
    let unfolded = |d: Vec3| f64::from(pdf_phong(1.0 - axis.dot(d), 20.0));
    assert!(cells.chi2(|i| Some(drawn[i as usize].wi), unfolded) < WRONG);
}

/// weight · pdf = f·cosθ, and both densities are one, wherever a direction is drawn; and no sample is below the horizon.
#[test]
fn bsdf_weights_are_value_over_density() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    for ((name, material), side) in materials().into_iter().flat_map(|m| SIDES.map(|side| (m, side))) {
        for at in geometries() {
            let drawn = draws(&twins, side, &material, at, 4000);
            let smooth: Vec<_> = drawn.iter().filter(|s| s.pdf > 0.0).collect();
            assert!(smooth.len() > 2000, "{name}");
            for s in &drawn {
                assert!((s.wi.length() - 1.0).abs() < 1e-6, "{name}: |wi| = {}", s.wi.length());
                assert!(s.wi.dot(at.0) > -1e-6, "{name}: {} is below the horizon", s.wi);
            }
            for s in smooth {
                // cosθ near 0 loses digits when the direction is turned into the world's frame.
                let tolerance = 1e-4 * s.pdf + 2e-6;
                let (evaluated, weighed) = (s.evaluated - s.pdf, s.weight * s.pdf - s.value);
                assert!(evaluated.abs() <= tolerance, "{name}: {} drawn, {} evaluated", s.pdf, s.evaluated);
                let off = weighed.abs().max_element();
                assert!(off <= tolerance, "{name}: f·cosθ {} is not {}", s.value, s.weight * s.pdf);
            }
        }
    }
}

/// The chance of a delta lobe is the mirror's level. α = 6.3e-5.
#[test]
fn a_mirror_reflects_as_often_as_its_level_says() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    let n = 1 << 18;
    for (level, side) in [0.0f32, 0.13, 0.8, 1.0].into_iter().flat_map(|l| SIDES.map(|side| (l, side))) {
        let drawn = draws(&twins, side, &material(KIND_MIRROR, level), geometries()[1], n);
        let delta = drawn.iter().filter(|s| s.pdf == 0.0).count() as f64;
        let off = |p: f64| (delta - f64::from(n) * p).abs() / (f64::from(n) * p * (1.0 - p)).sqrt().max(1e-9);
        assert!(off(level.into()) <= 4.0, "{side:?}: level {level}: {delta} of {n}");
        assert!(off(f64::from(level) * 0.97 + 0.01) > 6.0, "{side:?}: level {level}: {delta} of {n}");
    }
}

/// The density that comes with a direction, of lobes as narrow as may be, is what f64 evaluates there, but for what
/// the rounding of directions does to it.
#[test]
fn densities_of_glossy_directions_are_right_at_every_exponent() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    let mut numbers = Numbers(11);
    for exponent in [0.0f32, 1.0, 100.0, 1e4, 1e5, 1e6] {
        let lobe = material(KIND_GLOSSY, exponent);
        let questions: Vec<_> = (0..20_000)
            .map(|i| {
                let n = numbers.direction().as_vec3();
                let cos = numbers.of_any_size(1e-3, 1.0) as f32;
                let local = Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
                question(&lobe, n, to_world(local, n).normalize(), i)
            })
            .collect();
        for side in SIDES {
            let (worst, told, mut compared) = (Worst::default(), Worst::default(), 0);
            for ([a, b, _], answer) in questions.iter().zip(twins.answer(side, &questions)) {
                let s = scattered(answer);
                let (exact, conditioning) = glossy(exponent.into(), [floats(*a).0, floats(*b).0, s.wi]);
                // A direction at the horizon may count as below it.
                if s.wi.dot(floats(*a).0) < 1e-6 || exact < 1e-6 {
                    continue;
                }
                compared += 1;
                let error = told.see((f64::from(s.pdf) / exact - 1.0).abs());
                let roundings = worst.see(error / (ROUNDING * conditioning));
                assert!(roundings < 12.0, "{side:?}, n {exponent:e}: {} for {exact}: {roundings}", s.pdf);
            }
            assert!(compared > 19_000);
            println!(
                "{side:?}: densities of glossy {exponent:e} are off by {:e}, {} roundings",
                told.get(),
                worst.get()
            );
        }
    }
    // Negative control: an exponent 1 % off.
    let (normal, wo) = geometries()[1];
    let s = &draws(&twins, Side::Gpu, &material(KIND_GLOSSY, 1e4), (normal, wo), 1)[0];
    assert!((f64::from(s.pdf) / glossy(1.01e4, [normal, wo, s.wi]).0 - 1.0).abs() > 1e-3);
}

/// Glass is chosen by one number, and every material by the same function.
#[test]
fn glass_has_no_density() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    for side in SIDES {
        let drawn = draws(&twins, side, &material(KIND_DIELECTRIC, 1.5), geometries()[1], 1000);
        assert!(drawn.iter().all(|s| s.pdf == 0.0 && s.evaluated == 0.0 && s.value == Vec3::ZERO));
    }
}
