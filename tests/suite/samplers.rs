//! Samplers against their densities: χ² of what is drawn, densities that integrate to one, weights that are f·cosθ/pdf.
//!
//! Each χ² test has α = 1e-4: a right sampler fails it once in 10,000 seeds. Its negative control, a density a little
//! wrong, must have a chance below 1e-9.

use glam::{DVec3, Vec2, Vec3, Vec4Swizzles};
use proptest::prelude::*;
use qtracer::Sampler;
use qtracer::bsdf::{BsdfSample, bsdf_evaluate, bsdf_sample, fresnel};
use qtracer::math::{frame_around, mis_weight, one_minus_cos, to_world};
use qtracer::random::{SampleKey, sample4};
use qtracer::sampling::{
    AliasTable, pdf_cone, pdf_cosine, pdf_phong, sample_cone, sample_cosine, sample_phong,
};
use qtracer::scene::compiled::{
    CompiledScene, KIND_DIELECTRIC, KIND_DIFFUSE, KIND_GLOSSY, KIND_MIRROR, Material, ShapeIndex,
};
use qtracer::scene::shapes::{Ray, T_MISS, intersect, intersect_quad, intersect_sphere};
use qtracer::scene::triangle::double_area;
use qtracer::scene::{Material as SceneMaterial, MeshData, Scene};
use qtracer::stats::{chi2_test, normal_two_sided_threshold, sidak};
use qtracer::transport::light::{choose_light, pdf_light, sample_light};
use std::f64::consts::{PI, TAU};

pub const ALPHA: f64 = 1e-4;
pub const WRONG: f64 = 1e-9;

/// The numbers that path `i` draws: the program's own, so that they are tested too.
fn draw(i: u32) -> glam::Vec4 {
    sample4(Sampler::Independent, SampleKey { pixel: 3, sample: i, seed: 41 }, 7)
}

/// Cells in which directions are counted: equal steps of z between `bottom` and `top`, and of φ, about `axis`.
pub struct Cells {
    pub axis: Vec3,
    pub bottom: f64,
    pub top: f64,
    pub rows: usize,
    pub columns: usize,
}

impl Cells {
    pub fn sphere(axis: Vec3) -> Cells {
        Cells { axis, bottom: -1.0, top: 1.0, rows: 20, columns: 12 }
    }

    fn hemisphere(axis: Vec3) -> Cells {
        Cells { bottom: 0.0, rows: 16, ..Cells::sphere(axis) }
    }

    /// Index of the cell, None outside.
    fn find(&self, direction: Vec3) -> Option<usize> {
        let (tangent, bitangent) = frame_around(self.axis);
        let z = f64::from(direction.dot(self.axis));
        let phi = f64::from(direction.dot(bitangent)).atan2(direction.dot(tangent).into()).rem_euclid(TAU);
        // Directions on the very edge belong to the outermost cells: f32 puts them on either side.
        let row = (z - self.bottom) / (self.top - self.bottom) * self.rows as f64;
        if row < -1e-3 || row > self.rows as f64 + 1e-3 {
            return None;
        }
        let row = (row.max(0.0) as usize).min(self.rows - 1);
        Some(row * self.columns + ((phi / TAU * self.columns as f64) as usize).min(self.columns - 1))
    }

    /// ∫ pdf dω over each cell: midpoints of a fine grid, which discontinuities within a cell survive.
    pub fn integrate(&self, pdf: impl Fn(Vec3) -> f64) -> Vec<f64> {
        const FINE: usize = 48;
        let (rows, columns) = (self.rows * FINE, self.columns * FINE);
        let area = (self.top - self.bottom) / rows as f64 * TAU / columns as f64;
        let mut cells = vec![0.0; self.rows * self.columns];
        for row in 0..rows {
            let z = self.bottom + (self.top - self.bottom) * (row as f64 + 0.5) / rows as f64;
            for column in 0..columns {
                let phi = TAU * (column as f64 + 0.5) / columns as f64;
                let r = (1.0 - z * z).sqrt();
                let local = DVec3::new(r * phi.cos(), r * phi.sin(), z).as_vec3();
                cells[row / FINE * self.columns + column / FINE] += area * pdf(to_world(local, self.axis));
            }
        }
        cells
    }

    /// p-value of 100,000 draws against the density, of which `missing` is the share that gives no direction.
    pub fn chi2(&self, sample: impl Fn(u32) -> Option<Vec3>, pdf: impl Fn(Vec3) -> f64) -> f64 {
        self.chi2_of(sample, &self.integrate(pdf))
    }

    /// The same, for a density of which the integrals over the cells are known.
    pub fn chi2_of(&self, sample: impl Fn(u32) -> Option<Vec3>, integrals: &[f64]) -> f64 {
        const DRAWS: u32 = 100_000;
        let mut expected: Vec<f64> = integrals.iter().map(|p| p * f64::from(DRAWS)).collect();
        let mut observed = vec![0u64; expected.len() + 1];
        for i in 0..DRAWS {
            match sample(i) {
                Some(direction) => {
                    let cell = self.find(direction);
                    observed[cell.unwrap_or_else(|| panic!("{direction} is outside all cells"))] += 1;
                }
                None => *observed.last_mut().unwrap() += 1,
            }
        }
        expected.push((f64::from(DRAWS) - expected.iter().sum::<f64>()).max(0.0));
        // A cell of which the quadrature saw next to nothing joins the others.
        expected.iter_mut().for_each(|e| *e = e.max(1e-6));
        chi2_test(&observed, &expected).unwrap().p_value
    }
}

/// The density integrates to `total` over the cells.
fn integrates_to(total: f64, cells: &Cells, pdf: impl Fn(Vec3) -> f64) {
    let integral: f64 = cells.integrate(pdf).iter().sum();
    assert!((integral / total - 1.0).abs() < 2e-3, "the density integrates to {integral}, not {total}");
}

#[test]
fn cosine_directions_follow_their_density() {
    let cells = Cells::hemisphere(Vec3::Z);
    let sample = |i| Some(sample_cosine(draw(i).xy()));
    let pdf = |d: Vec3| f64::from(pdf_cosine(d.z));
    integrates_to(1.0, &cells, pdf);
    assert!(cells.chi2(sample, pdf) > ALPHA);
    // Negative controls: uniform instead of cosine, and 7 % more at the pole.
    assert!(cells.chi2(sample, |_| 1.0 / TAU) < WRONG);
    assert!(cells.chi2(sample, |d| pdf(d) * (1.0 + 0.2 * (f64::from(d.z) - 2.0 / 3.0))) < WRONG);
}

#[test]
fn cone_directions_follow_their_density() {
    for height in [2.0f32, 1.0, 0.3, 1e-3, 1e-6] {
        let cells = Cells { bottom: 0.0, top: 1.0, rows: 16, columns: 12, axis: Vec3::Z };
        // 1 − z scaled by the cone's height: all cones alike, which is how small ones can be seen in f32 at all.
        let unscaled = |d: Vec3| {
            let one_minus_z = f64::from(d.x * d.x + d.y * d.y) / (1.0 + f64::from(d.z));
            let z = if height > 1e-2 { 1.0 - f64::from(d.z) } else { one_minus_z } / f64::from(height);
            let (r, phi) = ((1.0 - (1.0 - z).powi(2)).max(0.0).sqrt(), f64::from(d.y).atan2(d.x.into()));
            DVec3::new(r * phi.cos(), r * phi.sin(), (1.0 - z).clamp(0.0, 1.0)).as_vec3()
        };
        let sample = |i| Some(unscaled(sample_cone(draw(i).xy(), height)));
        let pdf = |_| f64::from(pdf_cone(height)) * f64::from(height);
        let p = cells.chi2(sample, pdf);
        assert!(p > ALPHA, "cone of 1 − cos = {height}: p = {p}");
        assert!(cells.chi2(sample, |d| pdf(d) * (0.85 + 0.3 * f64::from(d.z))) < WRONG);
    }
}

#[test]
fn phong_directions_follow_their_density() {
    for exponent in [0.0f32, 1.0, 5.0, 20.0, 100.0] {
        // Rows of equal z hold a peaked lobe in few cells, so they start where a ten-thousandth is left outside.
        let bottom = if exponent < 5.0 { 0.0 } else { 1e-4f64.powf(1.0 / (f64::from(exponent) + 1.0)) };
        let cells = Cells { bottom, top: 1.0, rows: 16, columns: 12, axis: Vec3::Z };
        let sample = |i| Some(sample_phong(draw(i).xy(), exponent)).filter(|d| f64::from(d.z) >= bottom);
        let pdf = |n: f32| move |d: Vec3| f64::from(pdf_phong(1.0 - d.z, n));
        let p = cells.chi2(sample, pdf(exponent));
        assert!(p > ALPHA, "exponent {exponent}: p = {p}");
        assert!(cells.chi2(sample, pdf(exponent * 1.05 + 0.05)) < WRONG);
        integrates_to(1.0, &Cells::hemisphere(Vec3::Z), pdf(exponent));
    }
}

fn material(kind: u32, parameter: f32) -> Material {
    Material { color: Vec3::new(0.9, 0.6, 0.3), kind, parameter, ..Default::default() }
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
fn geometries() -> Vec<(Vec3, Vec3)> {
    let normal = Vec3::new(0.3, -0.5, 0.8).normalize();
    let at = |cos: f32, phi: f32| {
        let sin = (1.0 - cos * cos).sqrt();
        to_world(Vec3::new(sin * phi.cos(), sin * phi.sin(), cos), normal)
    };
    vec![(normal, normal), (normal, at(0.7, 1.0)), (normal, at(0.25, 4.0)), (normal, at(0.02, 2.5))]
}

fn scattered(material: &Material, normal: Vec3, wo: Vec3, i: u32) -> BsdfSample {
    bsdf_sample(material, normal, wo, true, draw(i).xyz())
}

/// What bsdf_sample draws is what bsdf_evaluate says; the share of delta lobes gives no direction. The lobe folded at the
/// horizon is weighed at grazing angles too.
#[test]
fn bsdf_directions_follow_their_density() {
    for (name, material) in materials() {
        for (normal, wo) in geometries() {
            let cells = Cells { rows: 24, columns: 16, ..Cells::hemisphere(normal) };
            let sample = |i| Some(scattered(&material, normal, wo, i)).filter(|s| s.pdf > 0.0).map(|s| s.wi);
            let pdf = |d: Vec3| f64::from(bsdf_evaluate(&material, normal, wo, d).pdf);
            let p = cells.chi2(sample, pdf);
            assert!(p > ALPHA, "{name}, cosθ {}: p = {p}", normal.dot(wo));
            let smooth = if material.kind == KIND_MIRROR { 1.0 - f64::from(material.parameter) } else { 1.0 };
            integrates_to(smooth, &cells, pdf);
        }
    }
    // Negative control: the unfolded lobe loses what is below the horizon.
    let (normal, wo) = geometries()[2];
    let glossy = material(KIND_GLOSSY, 20.0);
    let cells = Cells { rows: 24, columns: 16, ..Cells::hemisphere(normal) };
    let axis = -wo + normal * (2.0 * wo.dot(normal));
    let sample = |i| Some(scattered(&glossy, normal, wo, i).wi);
    assert!(cells.chi2(sample, |d| f64::from(pdf_phong(1.0 - axis.dot(d), 20.0))) < WRONG);
}

/// weight · pdf = f·cosθ, and both densities are one, wherever a direction is drawn; and no sample is below the horizon.
#[test]
fn bsdf_weights_are_value_over_density() {
    for (name, material) in materials() {
        for (normal, wo) in geometries() {
            let mut smooth = 0;
            for i in 0..2000 {
                let s = scattered(&material, normal, wo, i);
                assert!((s.wi.length() - 1.0).abs() < 1e-5, "{name}: |wi| = {}", s.wi.length());
                assert!(s.wi.dot(normal) > -1e-6, "{name}: {} is below the horizon", s.wi);
                if s.pdf == 0.0 {
                    continue;
                }
                smooth += 1;
                let value = bsdf_evaluate(&material, normal, wo, s.wi);
                // cosθ near 0 loses digits when the direction is turned into the world's frame.
                let tolerance = 1e-4 * s.pdf + 2e-6;
                assert!(
                    (value.pdf - s.pdf).abs() <= tolerance,
                    "{name}: {} drawn, {} evaluated",
                    s.pdf,
                    value.pdf
                );
                let difference = (s.weight * s.pdf - value.value).abs().max_element();
                assert!(
                    difference <= tolerance,
                    "{name}: f·cosθ {} is not {}",
                    value.value,
                    s.weight * s.pdf
                );
            }
            assert!(smooth > 1000, "{name}");
        }
    }
}

/// The chance of a delta lobe is the mirror's level. α = 6.3e-5.
#[test]
fn a_mirror_reflects_as_often_as_its_level_says() {
    let (normal, wo) = geometries()[1];
    let n = 100_000;
    for level in [0.0f32, 0.13, 0.8, 1.0] {
        let mirror = material(KIND_MIRROR, level);
        let delta = (0..n).filter(|&i| scattered(&mirror, normal, wo, i).pdf == 0.0).count() as f64;
        let (p, n) = (f64::from(level), f64::from(n));
        assert!((delta - n * p).abs() <= 4.0 * (n * p * (1.0 - p)).sqrt(), "level {level}: {delta} of {n}");
    }
}

/// Narrow lobes: the density that f32 evaluates is that of f64, relative to the direction's own error.
#[test]
fn phong_densities_of_narrow_lobes_are_right_to_1e_4() {
    for exponent in [1e4, 1e5, 1e6f64] {
        for step in 1..60 {
            let x = f64::from(step) * 0.1 / exponent;
            let exact = (exponent + 1.0) / (2.0 * PI) * (exponent * (-x).ln_1p()).exp();
            let density = f64::from(pdf_phong(x as f32, exponent as f32));
            assert!(
                (density / exact - 1.0).abs() < 1e-4,
                "n {exponent:e}, 1 − cos {x:e}: {density} for {exact}"
            );
        }
        // A sampled direction knows its own distance from the axis.
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

/// Unpolarised Fresnel reflectance from the sine and tangent laws, which the program does not use.
fn fresnel_oracle(theta_i: f64, eta: f64) -> f64 {
    let sin_t = theta_i.sin() / eta;
    if sin_t >= 1.0 {
        return 1.0;
    }
    if theta_i < 1e-9 {
        return ((eta - 1.0) / (eta + 1.0)).powi(2);
    }
    let theta_t = sin_t.asin();
    let s = ((theta_i - theta_t).sin() / (theta_i + theta_t).sin()).powi(2);
    let p = ((theta_i - theta_t).tan() / (theta_i + theta_t).tan()).powi(2);
    0.5 * (s + p)
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
        }
        // Grazing incidence reflects everything.
        assert!(fresnel_f32(PI / 2.0 - 1e-5, eta) > 0.999);
    }
    // Negative control: Schlick's approximation is not Fresnel's.
    let schlick = |cos: f64| 0.36 + 0.64 * (1.0 - cos).powi(5);
    assert!((schlick(0.3) - fresnel_oracle(0.3f64.acos(), 4.0)).abs() > 5e-2);
}

/// η → 1 is no surface: nothing is reflected and directions go on, continuously.
#[test]
fn glass_vanishes_as_its_index_goes_to_that_outside() {
    let (normal, wo) = geometries()[1];
    for excess in [0.0f32, 1e-6, 1e-4, 1e-2] {
        let glass = material(KIND_DIELECTRIC, 1.0 + excess);
        for outside in [false, true] {
            let s = bsdf_sample(&glass, normal, wo, outside, Vec3::splat(0.9999));
            // At 45° the direction turns by the excess.
            assert!((s.wi + wo).length() <= 1.2 * excess + 3e-7, "η = 1 + {excess}: {} for {}", s.wi, -wo);
            let theta = f64::from(normal.dot(wo).acos());
            let reflected = f64::from(fresnel_f32(theta, 1.0 + f64::from(excess)));
            assert!(reflected <= f64::from(excess * excess) + 1e-12, "η = 1 + {excess}: {reflected}");
        }
    }
}

/// Beyond the critical angle everything is reflected, just before it something is not; either way angles are equal or
/// obey Snell, and radiance is squeezed by 1/η² on the way in and released on the way out.
#[test]
fn glass_obeys_snell_and_reflects_totally_beyond_the_critical_angle() {
    let glass = material(KIND_DIELECTRIC, 1.5);
    let normal = geometries()[0].0;
    let critical = (1.0f64 / 1.5).asin();
    for (theta, total) in [(critical + 1e-3, true), (critical - 1e-3, false), (1.4, true), (0.2, false)] {
        let wo = to_world(DVec3::new(theta.sin(), 0.0, theta.cos()).as_vec3(), normal);
        // u below 1 chooses refraction wherever there is any.
        let s = bsdf_sample(&glass, normal, wo, false, Vec3::splat(0.999_999_9));
        assert_eq!(s.wi.dot(normal) > 0.0, total, "inside at {theta}");
        let tangential = |d: Vec3| f64::from((d - normal * d.dot(normal)).length());
        let (expected, squeeze) = if total { (theta.sin(), 1.0) } else { (theta.sin() * 1.5, 1.5f32 * 1.5) };
        assert!((tangential(s.wi) - expected).abs() < 1e-5, "{} for {expected}", tangential(s.wi));
        assert!((s.weight / (glass.color * squeeze) - 1.0).abs().max_element() < 1e-5);
        assert_eq!(s.pdf, 0.0);
    }
    // Into the glass.
    let wo = to_world(Vec3::new(0.8, 0.0, 0.6), normal);
    let s = bsdf_sample(&glass, normal, wo, true, Vec3::splat(0.999_999));
    assert!(s.wi.dot(normal) < 0.0 && (s.wi - normal * s.wi.dot(normal)).length() - 0.8 / 1.5 < 1e-6);
    assert!((s.weight * 2.25 / glass.color - 1.0).abs().max_element() < 1e-5);
}

/// Reflection is chosen as often as Fresnel says. α = 6.3e-5 each.
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

#[test]
fn alias_tables_draw_by_weight() {
    let weights = [1.0, 0.01, 3.0, 3.0, 1e-6, 10.0, 0.5];
    let table = AliasTable::new(&weights);
    let total: f64 = weights.iter().sum();
    let sum: f64 = table.rows.iter().map(|row| f64::from(row.probability)).sum();
    assert!((sum - 1.0).abs() < 1e-6);
    for (row, weight) in table.rows.iter().zip(weights) {
        assert!((f64::from(row.probability) - weight / total).abs() < 1e-6, "{row:?} for {}", weight / total);
    }
    assert!(AliasTable::new(&[]).rows.is_empty());
}

/// Lamps of unequal power, spheres and quads.
fn lamps() -> CompiledScene {
    let mut builder = Scene::builder("lamps").camera([0.0, 0.0, 9.0], [0.0; 3], 40.0);
    for (i, power) in [1.0, 5.0, 0.2, 2.0, 20.0].into_iter().enumerate() {
        let lamp = SceneMaterial::diffuse([0.0; 3]).emitting([power, power / 2.0, 0.1]);
        let (name, x) = (format!("lamp {i}"), 3.0 * i as f64);
        builder = builder.material(name.as_str(), lamp);
        builder = match i % 2 {
            0 => builder.sphere([x, 2.0, 0.0], 0.5, name),
            _ => builder.quad([x, 2.0, 0.0], [0.0, 0.0, 1.0], [-1.5, 0.0, 0.0], name),
        };
    }
    CompiledScene::new(&builder.build().unwrap())
}

/// α = 1e-4.
#[test]
fn lights_are_chosen_as_often_as_their_probability_says() {
    let scene = lamps();
    assert_eq!(scene.lights.len(), 5);
    let n = 200_000;
    let mut observed = vec![0u64; 5];
    (0..n).for_each(|i| observed[choose_light(&scene, draw(i).x) as usize] += 1);
    let expected: Vec<f64> =
        scene.lights.iter().map(|light| f64::from(light.pick_probability) * f64::from(n)).collect();
    assert!(chi2_test(&observed, &expected).unwrap().p_value > ALPHA, "{observed:?} for {expected:?}");
    // Negative control: equal shares.
    assert!(chi2_test(&observed, &[f64::from(n) / 5.0; 5]).unwrap().p_value < WRONG);
    // And the probabilities go by power: area × radiance, of both sides of a sphere and one of a quad.
    let power = |light: &qtracer::scene::compiled::Light| {
        let emission = scene.materials[light.material as usize].emission.element_sum();
        let area = match scene.shape_index(light.shape) {
            ShapeIndex::Sphere(i) => 4.0 * std::f32::consts::PI * scene.spheres[i].radius.powi(2),
            ShapeIndex::Quad(i) => scene.quads[i].area,
            ShapeIndex::Triangle(_) => unreachable!("no mesh shines here"),
        };
        emission * area
    };
    let total: f32 = scene.lights.iter().map(power).sum();
    for light in &scene.lights {
        assert!((light.pick_probability - power(light) / total).abs() < 1e-6, "{light:?}");
    }
}

/// A scene of one lamp.
fn lamp(shape: impl FnOnce(qtracer::scene::SceneBuilder) -> qtracer::scene::SceneBuilder) -> CompiledScene {
    let builder = Scene::builder("lamp")
        .camera([0.0, 0.0, 9.0], [0.0; 3], 40.0)
        .material("lamp", SceneMaterial::diffuse([0.0; 3]).emitting([1.0; 3]));
    CompiledScene::new(&shape(builder).build().unwrap())
}

/// Distance at which a ray meets the scene's only shape; T_MISS if it does not.
fn distance(scene: &CompiledScene, origin: Vec3, direction: Vec3) -> f32 {
    let ray = Ray { origin, direction };
    match scene.shape_index(0) {
        ShapeIndex::Sphere(_) => intersect_sphere(&ray, &scene.spheres[0]),
        ShapeIndex::Quad(_) => intersect_quad(&ray, &scene.quads[0]),
        ShapeIndex::Triangle(_) => intersect(scene, ray).map_or(T_MISS, |hit| hit.t),
    }
}

/// The density of a light as pdf_light says it, 0 where its bright side is not met.
fn light_density(scene: &CompiledScene, origin: Vec3) -> impl Fn(Vec3) -> f64 {
    move |wi| match distance(scene, origin, wi) {
        T_MISS => 0.0,
        _ if scene.quads.first().is_some_and(|quad| quad.normal.dot(wi) >= 0.0) => 0.0,
        _ if scene.triangles.first().is_some_and(|t| double_area(t.a, t.b, t.c).dot(wi) >= 0.0) => 0.0,
        t => pdf_light(scene, origin, 0, wi, t).into(),
    }
}

/// A lamp that looks down.
const TRIANGLE: [[f64; 3]; 3] = [[-1.0, 2.0, -1.0], [1.0, 2.0, -0.5], [-0.5, 2.3, 1.5]];

fn triangle() -> CompiledScene {
    let positions = TRIANGLE.map(glam::DVec3::from_array).to_vec();
    lamp(|b| b.mesh(MeshData { positions, triangles: vec![[0, 1, 2]], ..Default::default() }, "lamp"))
}

/// Scenes of one lamp, a point that it lights, and cells that hold it.
fn lit_points() -> Vec<(&'static str, CompiledScene, Vec3, Cells)> {
    let sphere = |radius: f64| lamp(|b| b.sphere([1.0, 2.0, 3.0], radius, "lamp"));
    let centre = Vec3::new(1.0, 2.0, 3.0);
    let quad = || lamp(|b| b.quad([-1.0, 2.0, -1.0], [2.0, 0.0, 0.5], [0.0, 0.3, 2.0], "lamp"));
    // e1 × e2 points down.
    let below = Vec3::new(0.2, 0.5, 0.3);
    let grazing = Vec3::new(-4.0, 1.6, 0.0);
    let aslant = Vec3::new(-3.0, 1.2, 0.3);
    // Directions to a quad are nearest to that of its middle in a cap that its corners bound.
    let around = |scene: &CompiledScene, origin: Vec3| {
        let quad = &scene.quads[0];
        let at = |a: f32, b: f32| (quad.corner + quad.e1 * a + quad.e2 * b - origin).normalize();
        let axis = at(0.5, 0.5);
        let corners = [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0), at(1.0, 1.0)];
        let bottom = corners.iter().map(|c| f64::from(axis.dot(*c))).fold(1.0, f64::min) - 1e-4;
        Cells { axis, bottom, top: 1.0, rows: 24, columns: 24 }
    };
    let around_triangle = |origin: Vec3| {
        let corners =
            TRIANGLE.map(|corner| (Vec3::from_array(corner.map(|v| v as f32)) - origin).normalize());
        let axis = corners.iter().sum::<Vec3>().normalize();
        let bottom = corners.iter().map(|c| f64::from(axis.dot(*c))).fold(1.0, f64::min) - 1e-4;
        Cells { axis, bottom, top: 1.0, rows: 24, columns: 24 }
    };
    let cone = |radius: f64, origin: Vec3| {
        let sin2 = radius * radius / f64::from((centre - origin).length_squared());
        Cells { bottom: (1.0 - sin2).sqrt(), rows: 12, ..Cells::hemisphere((centre - origin).normalize()) }
    };
    let (near, far) = (Vec3::new(1.0, 2.0, 1.9), Vec3::new(-4.0, 0.0, 1.0));
    vec![
        ("sphere, far", sphere(1.0), far, cone(1.0, far)),
        ("sphere, almost touched", sphere(1.0), near, cone(1.0, near)),
        (
            "sphere that shines inwards",
            lamp(|b| b.inward_sphere([1.0, 2.0, 3.0], 2.0, "lamp")),
            Vec3::new(1.5, 2.5, 2.0),
            Cells::sphere(Vec3::Z),
        ),
        ("quad, near", quad(), below, around(&quad(), below)),
        ("quad, grazing", quad(), grazing, around(&quad(), grazing)),
        ("triangle, near", triangle(), below, around_triangle(below)),
        ("triangle, aslant", triangle(), aslant, around_triangle(aslant)),
    ]
}

#[test]
fn light_directions_follow_their_density() {
    for (name, scene, origin, cells) in lit_points() {
        let sample =
            |i| Some(sample_light(&scene, origin, 0, draw(i).xy())).filter(|s| s.pdf > 0.0).map(|s| s.wi);
        let density = light_density(&scene, origin);
        integrates_to(1.0, &cells, &density);
        let p = cells.chi2(sample, &density);
        assert!(p > ALPHA, "{name}: p = {p}");
    }
    // Negative control: a quad's solid angle taken as uniform.
    let (_, scene, origin, cells) = lit_points().remove(3);
    let density = light_density(&scene, origin);
    let solid_angle: f64 = cells.integrate(|wi| f64::from(u8::from(density(wi) > 0.0))).iter().sum();
    let sample = |i| Some(sample_light(&scene, origin, 0, draw(i).xy()).wi);
    assert!(cells.chi2(sample, |wi| if density(wi) > 0.0 { 1.0 / solid_angle } else { 0.0 }) < WRONG);
}

/// Both directions: what sample_light draws, a ray meets where it says, and pdf_light gives the same density.
#[test]
fn light_samples_are_met_at_their_distance_with_their_density() {
    for (name, scene, origin, _) in lit_points() {
        let mut met = 0;
        for i in 0..5000 {
            let s = sample_light(&scene, origin, 0, draw(i).xy());
            if s.pdf == 0.0 {
                continue;
            }
            let t = distance(&scene, origin, s.wi);
            if t == T_MISS {
                // Rounding may push what is drawn at the very edge past it.
                continue;
            }
            met += 1;
            assert!((t - s.t).abs() < 2e-3 * s.t, "{name}: {} drawn, {t} met", s.t);
            let pdf = pdf_light(&scene, origin, 0, s.wi, t);
            assert!((pdf - s.pdf).abs() < 2e-3 * s.pdf, "{name}: {} drawn, {pdf} evaluated", s.pdf);
        }
        assert!(met > 4980, "{name}: {met} of 5000 met");
    }
}

/// No light where none arrives: behind a quad, outside a sphere that shines inwards, inside one that shines outwards.
#[test]
fn a_light_seen_from_its_dark_side_is_not_sampled() {
    let quad = lamp(|b| b.quad([-1.0, 2.0, -1.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0], "lamp"));
    let outward = lamp(|b| b.sphere([0.0; 3], 1.0, "lamp"));
    let inward = lamp(|b| b.inward_sphere([0.0; 3], 1.0, "lamp"));
    let above = Vec3::new(0.0, 3.0, 0.0);
    for (scene, dark) in
        [(quad, above), (triangle(), above), (outward, Vec3::splat(0.1)), (inward, Vec3::splat(2.0))]
    {
        assert_eq!(sample_light(&scene, dark, 0, Vec2::splat(0.4)).pdf, 0.0);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..Default::default() })]

    /// Bases about any normal, and within 1e-4 of both poles, where the naive formula divides by zero.
    #[test]
    fn frames_are_orthonormal_and_right_handed(
        x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0, near_pole in 0..4
    ) {
        let n = match near_pole {
            0 => Vec3::new(x * 1e-4, y * 1e-4, -1.0),
            1 => Vec3::new(x * 1e-4, y * 1e-4, 1.0),
            2 => Vec3::new(x, y, 0.0),
            _ => Vec3::new(x, y, z),
        };
        prop_assume!(n.length() > 1e-3);
        let n = n.normalize();
        let (t, b) = frame_around(n);
        let off = [t.length() - 1.0, b.length() - 1.0, t.dot(b), t.dot(n), b.dot(n), (t.cross(b) - n).length()];
        prop_assert!(off.iter().all(|e| e.abs() < 1e-6), "{n}: {off:?}");
    }

    /// The two weights of multiple importance sampling share everything between them, whatever the densities.
    #[test]
    fn mis_weights_add_up_to_one(a in -30.0f32..30.0, b in -30.0f32..30.0) {
        let (p, q) = (10f32.powf(a), 10f32.powf(b));
        let sum = mis_weight(p, q) + mis_weight(q, p);
        prop_assert!((sum - 1.0).abs() < 1e-6, "{p} {q}: {sum}");
        prop_assert!(mis_weight(p, 0.0) == 1.0);
    }
}

#[test]
fn frames_are_orthonormal_at_the_poles_themselves() {
    for n in [Vec3::Z, -Vec3::Z, Vec3::X, Vec3::Y, Vec3::new(0.0, 1.0, -0.0)] {
        let (t, b) = frame_around(n);
        assert!((t.cross(b) - n).length() < 1e-7 && t.dot(b).abs() < 1e-7, "{n}: {t} {b}");
    }
}

/// Correlation of two sequences of numbers.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len() as f64;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / n;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(usize) -> f64| (0..a.len()).map(f).sum::<f64>();
    let covariance = sum(&|i| (a[i] - ma) * (b[i] - mb));
    covariance / (sum(&|i| (a[i] - ma).powi(2)) * sum(&|i| (b[i] - mb).powi(2))).sqrt()
}

/// Sequences of which each pair must be independent: over samples, of neighbouring dimensions, pixels and seeds.
fn neighbours(sampler: Sampler, count: u32) -> Vec<Vec<f64>> {
    let mut keys = Vec::new();
    for dimension in [0, 1, 2, 3, 64] {
        keys.push((5, dimension, 1));
    }
    for (pixel, seed) in [(6, 1), (7, 1), (261, 1), (5, 2), (5, 3), (5, u32::MAX)] {
        keys.extend([(pixel, 0, seed), (pixel, 1, seed)]);
    }
    let mut sequences = Vec::new();
    for (pixel, dimension, seed) in keys {
        let numbers: Vec<_> =
            (0..count).map(|sample| sample4(sampler, SampleKey { pixel, sample, seed }, dimension)).collect();
        for c in 0..4 {
            sequences.push(numbers.iter().map(|v| f64::from(v[c])).collect());
        }
    }
    sequences
}

/// Over 4096 samples, α = 1e-3 for all 2278 pairs together (Šidák). Low-discrepancy sequences correlate less than chance
/// within a pair of coordinates and as much between pairs, so the same bound holds for them.
#[test]
fn numbers_of_different_dimensions_pixels_and_seeds_are_independent() {
    let count = 4096;
    for sampler in [Sampler::Independent, Sampler::Stratified] {
        let sequences = neighbours(sampler, count);
        let pairs = sequences.len() * (sequences.len() - 1) / 2;
        let bound = normal_two_sided_threshold(sidak(1e-3, pairs)) / f64::from(count).sqrt();
        let mut worst = (0.0, 0, 0);
        for i in 0..sequences.len() {
            for j in 0..i {
                let r = correlation(&sequences[i], &sequences[j]).abs();
                if r > worst.0 {
                    worst = (r, i, j);
                }
            }
        }
        assert!(worst.0 < bound, "{sampler:?}: sequences correlate by {worst:?}, bound {bound}");
    }
    // Negative control: a sequence and itself.
    let sequence = &neighbours(Sampler::Stratified, count)[0];
    assert!(correlation(sequence, sequence) > 0.99);
}

/// Means over samples are unbiased over pixels: 20,000 pixels, α = 6.3e-5 per coordinate.
#[test]
fn stratified_numbers_are_uniform_over_pixels() {
    for sample in [0, 1, 100] {
        for c in 0..4 {
            let mut counts = [0u64; 64];
            for pixel in 0..20_000 {
                let u = sample4(Sampler::Stratified, SampleKey { pixel, sample, seed: 9 }, 2)[c];
                counts[(u * 64.0) as usize] += 1;
            }
            let p = chi2_test(&counts, &[20_000.0 / 64.0; 64]).unwrap().p_value;
            assert!(p > ALPHA, "sample {sample}, coordinate {c}: p = {p}");
        }
    }
}
