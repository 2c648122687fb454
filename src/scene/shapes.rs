//! Spheres and parallelograms: intersection; of all shapes, the surface at a hit. Shapes are numbered spheres first, then
//! quads, then triangles. GPU twin: kernels/scene/shapes.wesl

use super::compiled::{CompiledScene, Quad, ShapeIndex, Sphere, Triangle};
use super::instance::{instanced_info, instanced_normal, instanced_uvs};
use super::shading::{Tangents, smooth_normal, triangle_shares, triangle_tangents, triangle_uv};
use super::surfaces::TriangleUvs;
use super::triangle::{double_area, intersect_triangle, onto_triangle, ray_shear};
use glam::{Vec2, Vec3};

#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: Vec3,
    /// Unit length.
    pub direction: Vec3,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub t: f32,
    pub shape: u32,
}

/// What of a shape shading needs before it knows where the hit lies.
#[derive(Clone, Copy, Debug)]
pub struct ShapeInfo {
    pub material: u32,
    pub kind: u32,
    pub light: u32,
}

#[derive(Clone, Copy, Debug)]
pub struct Surface {
    pub position: Vec3,
    /// Unit normal on the outer side, the one that emits.
    pub normal: Vec3,
    /// How far a new ray must start from `position` along the normal to be safely on its side.
    pub offset: f32,
    /// On the outer side as well: of a smooth mesh the one between those at its corners, else `normal`.
    pub shading_normal: Vec3,
    /// Where it lies in textures, if the scene has any.
    pub uv: Vec2,
    /// Which way these coordinates grow, if the scene has normal maps.
    pub tangents: Tangents,
}

impl Surface {
    /// One without normals of its own and without texture coordinates.
    #[inline(always)]
    pub fn plain(position: Vec3, normal: Vec3, offset: f32) -> Surface {
        let (uv, tangents) = (Vec2::ZERO, Tangents::default());
        Surface { position, normal, offset, shading_normal: normal, uv, tangents }
    }
}

/// Farther than anything; a miss has this distance.
pub const T_MISS: f32 = 3.0e38;
/// Spawn offset relative to the largest coordinate involved: 8 to 16 ulp. A sphere of radius r at that offset leaves
/// |o − c|² − r² = 2·r·offset, six times the rounding error of that difference. docs/ACCURACY.md has the counts.
pub const RELATIVE_OFFSET: f32 = 1.0 / 1_048_576.0;

/// Distance along the ray to the sphere, T_MISS if none lies ahead. The discriminant is taken from the closest
/// approach, which keeps its digits for large and for far spheres (Haines, Günther, Akenine-Möller 2019).
#[inline(always)]
pub fn intersect_sphere(ray: &Ray, sphere: &Sphere) -> f32 {
    let f = ray.origin - sphere.center;
    let b = -f.dot(ray.direction);
    let approach = f + ray.direction * b;
    let discriminant = sphere.radius * sphere.radius - approach.dot(approach);
    if discriminant < 0.0 {
        return T_MISS;
    }
    let root = discriminant.sqrt();
    let near = b - root;
    let t = if near > 0.0 { near } else { b + root };
    if t > 0.0 { refine_sphere_distance(f, sphere.radius, (b, root), t) } else { T_MISS }
}

/// The distance `t` = b ± root with an error smaller where it cancels: taken from the product of both solutions. Only there,
/// since of a ray that starts in the surface along it both solutions and their product are rounding errors.
#[inline(always)]
fn refine_sphere_distance(f: Vec3, radius: f32, (b, root): (f32, f32), t: f32) -> f32 {
    let sum = b.abs() + root;
    if t >= sum * 0.5 {
        return t;
    }
    let refined = (f.dot(f) - radius * radius) / if b >= 0.0 { sum } else { -sum };
    if refined > 0.0 { refined } else { t }
}

/// Distance along the ray to the parallelogram, T_MISS if none.
#[inline(always)]
pub fn intersect_quad(ray: &Ray, quad: &Quad) -> f32 {
    let from_corner = ray.origin - quad.corner;
    let t = -quad.normal.dot(from_corner) / quad.normal.dot(ray.direction);
    let p = from_corner + ray.direction * t;
    let (a, b) = (p.dot(quad.dual1), p.dot(quad.dual2));
    let inside = (0.0..=1.0).contains(&a) && (0.0..=1.0).contains(&b);
    if inside && t > 0.0 { t } else { T_MISS }
}

/// Distances to all shapes, in the order of their numbers.
fn distances(scene: &CompiledScene, ray: Ray) -> impl Iterator<Item = f32> + '_ {
    let view = ray_shear(ray.direction);
    let triangle = move |t: Triangle| match intersect_triangle(ray.origin, &view, t.a, t.b, t.c) {
        t if t > 0.0 => t,
        _ => T_MISS,
    };
    let spheres = scene.spheres.iter().map(move |sphere| intersect_sphere(&ray, sphere));
    let quads = scene.quads.iter().map(move |quad| intersect_quad(&ray, quad));
    let triangles = (0..scene.triangle_count()).map(|i| scene.triangle(i));
    spheres.chain(quads).chain(triangles.map(triangle))
}

/// The nearest shape that the ray meets, by asking one after the other. The CPU engine asks [`crate::accel`] instead.
pub fn intersect(scene: &CompiledScene, ray: Ray) -> Option<Hit> {
    let mut hit = Hit { t: T_MISS, shape: u32::MAX };
    for (shape, t) in distances(scene, ray).enumerate() {
        if t < hit.t {
            hit = Hit { t, shape: shape as u32 };
        }
    }
    (hit.shape != u32::MAX).then_some(hit)
}

/// Whether anything but `excluded` (the light aimed at) lies nearer than `t_max`.
pub fn occluded(scene: &CompiledScene, ray: Ray, t_max: f32, excluded: u32) -> bool {
    distances(scene, ray).enumerate().any(|(shape, t)| t < t_max && shape as u32 != excluded)
}

#[inline(always)]
pub fn shape_info(scene: &CompiledScene, shape: u32) -> ShapeInfo {
    match scene.shape_index(shape) {
        ShapeIndex::Sphere(i) => {
            let s = &scene.spheres[i];
            ShapeInfo { material: s.material, kind: s.kind, light: s.light }
        }
        ShapeIndex::Quad(i) => {
            let q = &scene.quads[i];
            ShapeInfo { material: q.material, kind: q.kind, light: q.light }
        }
        ShapeIndex::Triangle(i) => match scene.triangles.get(i) {
            Some(t) => ShapeInfo { material: t.material, kind: t.kind, light: t.light },
            None => instanced_info(scene, shape),
        },
    }
}

#[inline(always)]
fn largest(v: Vec3) -> f32 {
    v.abs().max_element()
}

/// Where a quad has texture coordinates: (0, 1) at its corner, so that an image stands upright along e2.
#[inline]
fn textured_quad(scene: &CompiledScene, surface: Surface, i: usize) -> Surface {
    let Quad { e1, e2, .. } = scene.quads[i];
    Surface { uv: quad_uv(scene, i, surface.position), tangents: Tangents { u: e1, up: e2 }, ..surface }
}

#[inline]
fn quad_uv(scene: &CompiledScene, i: usize, p: Vec3) -> Vec2 {
    let Quad { corner, dual1, dual2, .. } = scene.quads[i];
    let from_corner = p - corner;
    Vec2::new(dual1.dot(from_corner), 1.0 - dual2.dot(from_corner))
}

/// What a triangle's corners say of the point between them.
#[inline]
fn shaded_triangle(scene: &CompiledScene, surface: Surface, i: usize) -> Surface {
    let Triangle { a, b, c, .. } = scene.triangle(i);
    let shares = triangle_shares(surface.position, a, b, c);
    let mut shaded = surface;
    if !scene.surfaces.normals.is_empty() {
        shaded.shading_normal = triangle_normal(scene, i, shares, surface.normal);
    }
    if !scene.surfaces.uvs.is_empty() {
        let uvs = triangle_uvs(scene, i);
        shaded.uv = triangle_uv(&uvs, shares);
        shaded.tangents = triangle_tangents(&uvs, a, b, c);
    }
    shaded
}

#[inline]
fn triangle_normal(scene: &CompiledScene, i: usize, shares: Vec2, flat: Vec3) -> Vec3 {
    match i < scene.triangles.len() {
        true => smooth_normal(&scene.surfaces.normals[i], shares, flat),
        false => instanced_normal(scene, scene.triangle_shape(i), shares, flat),
    }
}

#[inline]
fn triangle_uvs(scene: &CompiledScene, i: usize) -> TriangleUvs {
    match i < scene.triangles.len() {
        true => scene.surfaces.uvs[i],
        false => instanced_uvs(scene, scene.triangle_shape(i)),
    }
}

/// Where a point of the shape lies in textures.
#[inline]
pub fn uv_at(scene: &CompiledScene, shape: u32, p: Vec3) -> Vec2 {
    match scene.shape_index(shape) {
        ShapeIndex::Sphere(_) => Vec2::ZERO,
        ShapeIndex::Quad(i) => quad_uv(scene, i, p),
        ShapeIndex::Triangle(i) => {
            let Triangle { a, b, c, .. } = scene.triangle(i);
            triangle_uv(&triangle_uvs(scene, i), triangle_shares(p, a, b, c))
        }
    }
}

/// The surface where the ray hits: the point is put back onto the shape, so that its error does not grow with t.
#[inline(always)]
pub fn surface_at(scene: &CompiledScene, ray: Ray, hit: Hit) -> Surface {
    let p = ray.origin + ray.direction * hit.t;
    match scene.shape_index(hit.shape) {
        ShapeIndex::Sphere(i) => {
            let Sphere { center, radius, inward, .. } = scene.spheres[i];
            let outward = (p - center).normalize();
            let normal = if inward != 0 { -outward } else { outward };
            let offset = RELATIVE_OFFSET * largest(center).max(radius);
            Surface::plain(center + outward * radius, normal, offset)
        }
        ShapeIndex::Quad(i) => {
            let Quad { corner, normal, .. } = scene.quads[i];
            let position = p - normal * normal.dot(p - corner);
            let size = largest(corner).max(largest(position));
            let plain = Surface::plain(position, normal, RELATIVE_OFFSET * size);
            if scene.surfaces.is_textured() { textured_quad(scene, plain, i) } else { plain }
        }
        ShapeIndex::Triangle(i) => {
            let Triangle { a, b, c, .. } = scene.triangle(i);
            let size = largest(a).max(largest(b).max(largest(c)));
            let (position, normal) = (onto_triangle(p, a, b, c), double_area(a, b, c).normalize());
            let plain = Surface::plain(position, normal, RELATIVE_OFFSET * size);
            if scene.surfaces.changes_triangles() { shaded_triangle(scene, plain, i) } else { plain }
        }
    }
}

/// A ray that leaves the surface into `direction`, started on that side of it.
#[inline(always)]
pub fn spawn_ray(surface: &Surface, direction: Vec3) -> Ray {
    let outer = direction.dot(surface.normal) >= 0.0;
    let side = if outer { surface.offset } else { -surface.offset };
    Ray { origin: surface.position + surface.normal * side, direction }
}
