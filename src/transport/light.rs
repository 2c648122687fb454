//! Direct light: a light chosen by power or by the light tree, a direction towards it, and the density of both.
//! GPU twin: kernels/transport/light.wesl

use super::light_tree::{choose_in_tree, probability_in_tree};
use crate::math::to_world;
use crate::sampling::{alias_row, pdf_cone, sample_cone};
use crate::scene::compiled::{CompiledScene, Light, ShapeIndex, Triangle};
use crate::scene::triangle::{double_area, sample_triangle};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// A direction towards a light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightSample {
    pub wi: Vec3,
    /// Distance to the light along `wi`.
    pub t: f32,
    /// Density of `wi` in sr⁻¹ given that this light was chosen; 0 if its bright side is not seen from here.
    pub pdf: f32,
}

/// A light that direct light is to sample.
#[derive(Clone, Copy, Debug)]
pub struct LightChoice<'a> {
    pub light: &'a Light,
    /// How likely it was.
    pub probability: f32,
    /// What stands for that in weights of multiple importance sampling: [`light_probability`].
    pub weighing: f32,
}

/// A light for a surface at `origin`. `normal` points to the side from which light may come, 0 if it may come from both; `u` in
/// [0, 1)², the second number to within rounding of 1. By power where there is no tree.
#[inline(always)]
pub fn choose_light(scene: &CompiledScene, origin: Vec3, normal: Vec3, u: Vec2) -> LightChoice<'_> {
    if scene.light_tree.is_none() {
        let light = &scene.lights[choose_by_power(scene, u.x) as usize];
        return LightChoice { light, probability: light.pick_probability, weighing: light.pick_probability };
    }
    let choice = choose_in_tree(scene, origin, normal, u);
    let light = &scene.lights[choice.light as usize];
    LightChoice { light, probability: choice.probability, weighing: choice.weighing }
}

/// What weights of multiple importance sampling take for the probability with which [`choose_light`] chooses the light from
/// `origin`. With a tree, that is its probability where the normal is not known.
#[inline(always)]
pub fn light_probability(scene: &CompiledScene, origin: Vec3, light: u32) -> f32 {
    match scene.light_tree {
        None => scene.lights[light as usize].pick_probability,
        Some(_) => probability_in_tree(scene, origin, light),
    }
}

/// Walker's alias method: O(1). `pick_probability` counts the values of `u`, multiples of 2⁻²⁴, that choose a light.
#[inline(always)]
pub fn choose_by_power(scene: &CompiledScene, u: f32) -> u32 {
    let (i, share) = alias_row(scene.lights.len() as u32, u);
    let light = &scene.lights[i as usize];
    if share >= light.threshold { light.alias_index } else { i }
}

/// The cone that a sphere subtends, as 1 − cosθmax = sin²θmax / (1 + cosθmax), which small cones keep exact.
#[inline]
fn sphere_cone(distance2: f32, radius: f32) -> f32 {
    let sin2 = radius * radius / distance2;
    sin2 / (1.0 + (1.0 - sin2).max(0.0).sqrt())
}

/// Uniform over the cone from outside; uniform over all directions from inside a sphere that shines inwards.
#[inline(always)]
fn sample_sphere_light(scene: &CompiledScene, origin: Vec3, i: usize, u: Vec2) -> LightSample {
    let sphere = &scene.spheres[i];
    let to_center = sphere.center - origin;
    let distance2 = to_center.dot(to_center);
    let inside = distance2 <= sphere.radius * sphere.radius;
    if inside != (sphere.inward != 0) {
        return LightSample::default();
    }
    if inside {
        let wi = sample_cone(u, 2.0);
        let along = to_center.dot(wi);
        let half_chord2 = sphere.radius * sphere.radius - (distance2 - along * along);
        return LightSample { wi, t: along + half_chord2.max(0.0).sqrt(), pdf: 1.0 / (4.0 * PI) };
    }
    let one_minus_cos_max = sphere_cone(distance2, sphere.radius);
    let local = sample_cone(u, one_minus_cos_max);
    let distance = distance2.sqrt();
    // From 1 − cosθ, as sample_cone has it: 1 − cos²θ of a small cone is rounding, and t would be off by the radius.
    let one_minus_cos = u.x * one_minus_cos_max;
    let sin2 = one_minus_cos * (2.0 - one_minus_cos);
    let half_chord2 = sphere.radius * sphere.radius - distance2 * sin2;
    LightSample {
        wi: to_world(local, to_center / distance),
        t: distance * local.z - half_chord2.max(0.0).sqrt(),
        pdf: pdf_cone(one_minus_cos_max),
    }
}

/// Uniform over the area.
#[inline(always)]
fn sample_quad_light(scene: &CompiledScene, origin: Vec3, i: usize, u: Vec2) -> LightSample {
    let quad = &scene.quads[i];
    let to_light = quad.corner + quad.e1 * u.x + quad.e2 * u.y - origin;
    let distance2 = to_light.dot(to_light);
    let distance = distance2.sqrt();
    let wi = to_light / distance;
    let cos_light = -wi.dot(quad.normal);
    if cos_light <= 0.0 || distance2 == 0.0 {
        return LightSample::default();
    }
    LightSample { wi, t: distance, pdf: distance2 / (cos_light * quad.area) }
}

/// Uniform over the area.
#[inline(always)]
fn sample_triangle_light(scene: &CompiledScene, origin: Vec3, i: usize, u: Vec2) -> LightSample {
    let Triangle { a, b, c, .. } = scene.triangles[i];
    let to_light = sample_triangle(u, a, b, c) - origin;
    let distance2 = to_light.dot(to_light);
    let distance = distance2.sqrt();
    let wi = to_light / distance;
    // Twice the area that the light shows.
    let seen = -wi.dot(double_area(a, b, c));
    if seen <= 0.0 || distance2 == 0.0 {
        return LightSample::default();
    }
    LightSample { wi, t: distance, pdf: 2.0 * distance2 / seen }
}

/// A direction from `origin` to the light `shape`. `u` in [0, 1)².
#[inline(always)]
pub fn sample_light(scene: &CompiledScene, origin: Vec3, shape: u32, u: Vec2) -> LightSample {
    match scene.shape_index(shape) {
        ShapeIndex::Sphere(i) => sample_sphere_light(scene, origin, i, u),
        ShapeIndex::Quad(i) => sample_quad_light(scene, origin, i, u),
        ShapeIndex::Triangle(i) => sample_triangle_light(scene, origin, i, u),
    }
}

#[inline(always)]
fn pdf_quad_light(scene: &CompiledScene, i: usize, wi: Vec3, t: f32) -> f32 {
    let quad = &scene.quads[i];
    t * t / (wi.dot(quad.normal).abs().max(1e-20) * quad.area)
}

/// Density with which [`sample_light`] from `origin` would have chosen the direction `wi` that met `shape` at distance t.
#[inline(always)]
pub fn pdf_light(scene: &CompiledScene, origin: Vec3, shape: u32, wi: Vec3, t: f32) -> f32 {
    match scene.shape_index(shape) {
        ShapeIndex::Sphere(i) => {
            let sphere = &scene.spheres[i];
            let to_center = sphere.center - origin;
            let distance2 = to_center.dot(to_center);
            if distance2 <= sphere.radius * sphere.radius {
                return 1.0 / (4.0 * PI);
            }
            pdf_cone(sphere_cone(distance2, sphere.radius))
        }
        ShapeIndex::Quad(i) => pdf_quad_light(scene, i, wi, t),
        ShapeIndex::Triangle(i) => {
            let Triangle { a, b, c, .. } = scene.triangles[i];
            2.0 * t * t / wi.dot(double_area(a, b, c)).abs().max(1e-30)
        }
    }
}
