//! Cosine, cone and Phong lobes.

use super::twins::{SIDES, Side, Twins, World, Worst, all_obey, of_any_size};
use super::{Cells, DRAW, DRAW_IMPORTS, draw};
use crate::oracles::bsdf::phong;
use crate::oracles::sampling::ROUNDING;
use crate::probe::{floats, row};
use glam::{DVec3, Vec3, Vec4Swizzles};
use proptest::prelude::*;
use qtracer::math::{one_minus_cos, to_world};
use qtracer::sampling::{pdf_cone, pdf_cosine, pdf_phong, sample_cone, sample_cosine, sample_phong};
use qtracer::scene::rows::Row;
use std::f64::consts::TAU;

const DRAWS: u32 = 1 << 18;
const COSINE: u32 = 0;
const CONE: u32 = 1;

/// A direction of the lobe of that number, 2 being Phong's, and its density.
const SAMPLE: (&str, &str) = (
    "import package::base::sampling::{sample_cosine, pdf_cosine, sample_cone, pdf_cone, sample_phong, pdf_phong};",
    "let parameter = bitcast<f32>(a.y);
    var d = sample_phong(u.xy, parameter);
    var pdf = pdf_phong(dot(d.xy, d.xy) / (1.0 + d.z), parameter);
    if a.x == 0u { d = sample_cosine(u.xy); pdf = pdf_cosine(d.z); }
    if a.x == 1u { d = sample_cone(u.xy, parameter); pdf = pdf_cone(parameter); }
    out0 = vec4<u32>(bitcast<vec3<u32>>(d), bitcast<u32>(pdf));",
);

fn sample(_: &World, &[[lobe, parameter, _, i]]: &[Row; 1]) -> [Row; 1] {
    let (u, parameter) = (draw(i).xy(), f32::from_bits(parameter));
    let (d, pdf) = match lobe {
        COSINE => (sample_cosine(u), pdf_cosine(sample_cosine(u).z)),
        CONE => (sample_cone(u, parameter), pdf_cone(parameter)),
        _ => {
            let d = sample_phong(u, parameter);
            (d, pdf_phong((d.x * d.x + d.y * d.y) / (1.0 + d.z), parameter))
        }
    };
    [row(d, pdf.to_bits())]
}

fn twins(world: &World) -> Twins<'_, 1, 1> {
    Twins::new(world, (&format!("{DRAW_IMPORTS}{}", SAMPLE.0), &format!("{DRAW}{}", SAMPLE.1)), sample)
}

/// 1 − cosθ with the digits that cosθ has lost.
fn depth(d: Vec3) -> f64 {
    let d = d.as_dvec3();
    if d.z < 0.5 { 1.0 - d.z } else { (d.x * d.x + d.y * d.y) / (1.0 + d.z) }
}

/// The direction at the same φ whose cosine is that.
fn moved(d: Vec3, cos: f64) -> Vec3 {
    let (sin, phi) = ((1.0 - cos * cos).max(0.0).sqrt(), f64::from(d.y).atan2(d.x.into()));
    DVec3::new(sin * phi.cos(), sin * phi.sin(), cos.clamp(0.0, 1.0)).as_vec3()
}

/// Draws of a lobe, moved so that its density becomes uniform over the hemisphere: narrow lobes could not be seen in f32
/// else. A cosine lobe stays what it is.
fn levelled(twins: &Twins<1, 1>, side: Side, lobe: u32, parameter: f32) -> Vec<Option<Vec3>> {
    let questions: Vec<_> = (0..DRAWS).map(|i| [[lobe, parameter.to_bits(), 0, i]]).collect();
    let off = if twins.compute_to_the_letter() { 3e-7 } else { 1e-6 };
    let level = |[answer]: [Row; 1]| {
        let d = floats(answer).0;
        assert!((d.length() - 1.0).abs() < off, "{side:?}, lobe {lobe}, {parameter}: |d| = {}", d.length());
        Some(match lobe {
            COSINE => d,
            CONE => moved(d, 1.0 - depth(d) / f64::from(parameter)),
            _ => moved(d, ((-depth(d)).ln_1p() * (f64::from(parameter) + 1.0)).exp()),
        })
    };
    twins.answer(side, &questions).into_iter().map(level).collect()
}

#[test]
fn cosine_cone_and_phong_directions_follow_their_densities() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    let cells = Cells::hemisphere(Vec3::Z);
    let uniform = cells.integrate(|_| 1.0 / TAU);
    let narrower = cells.integrate(|d| 1.03 * f64::from(d.z).powf(0.03) / TAU);
    for side in SIDES {
        let cosine = cells.integrate(|d| f64::from(pdf_cosine(d.z)));
        cells.are_followed(&format!("{side:?}: cosine"), &levelled(&twins, side, COSINE, 0.0), &cosine);
        for height in [2.0f32, 0.3, 1e-7, 1e-14] {
            let cells = if height > 1.0 { Cells::sphere(Vec3::Z) } else { Cells::hemisphere(Vec3::Z) };
            let draws = levelled_cone(&twins, side, height);
            let expected = cells.integrate(|_| 1.0 / (TAU * (cells.top - cells.bottom)));
            cells.are_followed(&format!("{side:?}: cone of 1 − cos = {height:e}"), &draws, &expected);
        }
        for exponent in [0.0f32, 20.0, 1e4, 1e5, 1e6] {
            let draws = levelled(&twins, side, 2, exponent);
            cells.are_followed(&format!("{side:?}: exponent {exponent:e}"), &draws, &uniform);
            // Negative control: n + 1 is 3 % greater.
            let p = cells.p_value(draws.iter().copied(), &narrower);
            assert!(p < super::WRONG, "{side:?}: an exponent 3 % above {exponent:e} passes with p = {p}");
        }
    }
}

/// All of the sphere is a cone too, of which nothing is moved.
fn levelled_cone(twins: &Twins<1, 1>, side: Side, height: f32) -> Vec<Option<Vec3>> {
    if height <= 1.0 {
        return levelled(twins, side, CONE, height);
    }
    let questions: Vec<_> = (0..DRAWS).map(|i| [[CONE, height.to_bits(), 0, i]]).collect();
    twins.answer(side, &questions).into_iter().map(|[answer]| Some(floats(answer).0)).collect()
}

/// How far the two sides' directions may be apart, in roundings: sines, cosines and exponentials are the adapter's.
const ALIKE: f64 = 40.0;

/// The same numbers give the same directions on both sides, but for the rounding of sines and cosines.
#[test]
fn directions_are_alike_on_both_sides() {
    let world = World::of_all_materials();
    let twins = twins(&world);
    let lobes = [(COSINE, 0.0f32), (CONE, 2.0), (CONE, 0.01), (2, 0.0), (2, 30.0), (2, 1e6)];
    let questions: Vec<_> = lobes
        .iter()
        .flat_map(|(lobe, p)| (0..20_000u32).map(move |i| [[*lobe, p.to_bits(), 0, i]]))
        .collect();
    let (cpu, gpu) = (twins.answer(Side::Cpu, &questions), twins.answer(Side::Gpu, &questions));
    let worst = Worst::default();
    for ([a], [b]) in cpu.iter().zip(&gpu) {
        worst.see(f64::from((floats(*a).0 - floats(*b).0).length()) / ROUNDING);
    }
    println!("directions differ between CPU and GPU by {} roundings", worst.get());
    assert!(worst.get() < ALIKE);
    assert!(f64::from((floats(cpu[0][0]).0 - floats(gpu[1][0]).0).length()) / ROUNDING > ALIKE);
}

const PHONG: (&str, &str) = (
    "import package::base::sampling::pdf_phong;",
    "out0.x = bitcast<u32>(pdf_phong(bitcast<f32>(a.x), bitcast<f32>(a.y)));",
);

/// Relative error of a density, in roundings for each that its conditioning costs: the exponential's argument y loses its
/// own rounding, and beyond 1 − cos = 0.02, where the logarithm is of 1 − x, that of 1 over x more.
fn phong_error(x: f32, exponent: f32, density: f32) -> f64 {
    let (x, n) = (f64::from(x), f64::from(exponent));
    let exact = phong(x, n);
    let y = -n * (-x).ln_1p();
    let conditioning = 2.0 + y + if x < 0.02 { 0.0 } else { n / (1.0 - x) };
    (f64::from(density) / exact - 1.0).abs() / (ROUNDING * conditioning)
}

/// For exponents from 0 to 1e6 and as far out as a lobe is above e⁻⁶⁰ of its height.
#[test]
fn phong_densities_are_those_of_f64() {
    let world = World::of_all_materials();
    let twins = Twins::new(&world, PHONG, |_, [[x, n, ..]]| {
        [[pdf_phong(f32::from_bits(*x), f32::from_bits(*n)).to_bits(), 0, 0, 0]]
    });
    let exponent = prop_oneof![Just(0.0), Just(1.0), Just(1e5), Just(1e6), of_any_size(-3.0, 6.0)];
    let lobe = (exponent, of_any_size(-4.0, 1.75)).prop_map(|(n, y)| {
        let n = n as f32;
        let x = if n > 0.0 { -(-y / f64::from(n)).exp_m1() } else { y / 60.0 };
        (n, x.min(0.999) as f32)
    });
    for side in SIDES {
        let (worst, worst_narrow) = (Worst::default(), Worst::default());
        let ask = |lobes: &[(f32, f32)]| {
            let questions: Vec<_> = lobes.iter().map(|(n, x)| [[x.to_bits(), n.to_bits(), 0, 0]]).collect();
            twins.answer(side, &questions).into_iter().map(|[[pdf, ..]]| f32::from_bits(pdf)).collect()
        };
        let faults = |lobes: &[(f32, f32)]| {
            let answers: Vec<f32> = ask(lobes);
            let fault = |(&(n, x), pdf): (&(f32, f32), f32)| {
                let error = worst.see(phong_error(x, n, pdf));
                if n >= 1e4 {
                    worst_narrow.see((f64::from(pdf) / phong(x.into(), n.into()) - 1.0).abs());
                }
                (error >= 6.0 || error.is_nan())
                    .then(|| format!("n {n:e}, 1 − cos {x:e}: {pdf} is {error} roundings off"))
            };
            lobes.iter().zip(answers).map(fault).collect()
        };
        all_obey("densities", &lobe, 50_000, faults);
        println!(
            "{side:?}: Phong densities: {} roundings; {:e} from n = 1e4 on",
            worst.get(),
            worst_narrow.get()
        );
        // All of the lobe, by midpoints over y = −n·ln(1 − x), is 1.
        for n in [0.5f32, 30.0, 1e4, 1e6] {
            let width = 40.0 / 4000.0;
            let middle = |i: u32| (f64::from(i) + 0.5) * width / f64::from(n);
            let lobes: Vec<(f32, f32)> =
                (0..4000).map(|i| (n, -(-middle(i)).exp_m1() as f32)).filter(|(_, x)| *x < 1.0).collect();
            let measure = |x: f32| TAU * (1.0 - f64::from(x)) * width / f64::from(n);
            let sum: f64 = lobes.iter().zip(ask(&lobes)).map(|((_, x), p)| f64::from(p) * measure(*x)).sum();
            assert!((sum - 1.0).abs() < 2e-4, "{side:?}: the lobe of exponent {n} integrates to {sum}");
        }
    }
    // Negative control: by cosα, which f32 rounds.
    let naive = |x: f32, n: f32| (n + 1.0) / std::f32::consts::TAU * (1.0 - x).powf(n);
    assert!(phong_error(1.234e-6, 1e6, naive(1.234e-6, 1e6)) > 1000.0);
}

/// A sampled direction knows its own distance from the axis.
#[test]
fn narrow_lobes_keep_their_shape_in_the_world() {
    for exponent in [1e4, 1e5, 1e6f64] {
        let axis = Vec3::new(0.3, -0.5, 0.81).normalize();
        for i in 0..1000 {
            let u = draw(i);
            let wi = to_world(sample_phong(u.xy(), exponent as f32), axis);
            let exact = -(1.0 - f64::from(u.x)).ln() / (exponent + 1.0);
            let x = f64::from(one_minus_cos(axis, wi));
            assert!((x - exact).abs() < 3e-3 * exact + 1e-9, "n {exponent:e}: {x:e} for {exact:e}");
        }
    }
}
