//! Meshes that are stored once and seen in many places: where an instance stands, and what its triangles are in the world.
//! GPU twin: kernels/scene/instance.wesl

use super::compiled::{CompiledScene, NONE, Triangle};
use super::shading::unpacked_normal;
use super::shapes::ShapeInfo;
use super::surfaces::{TriangleNormals, TriangleUvs};
use super::triangle::SMALLEST_SQUARE;
use crate::gpu_struct;
use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};

gpu_struct! {
    /// A shared mesh at one of its places.
    pub struct Instance {
        /// Columns of the matrix that brings its corners into the world …
        x_axis: Vec3,
        /// Number of its first triangle among all shapes; the others follow in the order of the mesh.
        first_shape: u32,
        y_axis: Vec3,
        /// Where the triangles of the mesh begin among all that are stored.
        first_triangle: u32,
        z_axis: Vec3,
        /// The top of the mesh's hierarchy among all nodes.
        first_node: u32,
        /// … and what is added then.
        translation: Vec3,
        material: u32,
        /// Columns of the inverse of that matrix.
        inverse_x: Vec3,
        kind: u32,
        inverse_y: Vec3,
        /// 1 if the matrix mirrors: then triangles are turned around, so that their outer sides stay outside.
        mirrors: u32,
        inverse_z: Vec3,
        /// Bounds whatever adds up to a coordinate of a corner in the world.
        reach: f32,
        /// By how much a ray may be off in the mesh's coordinates, for each unit of its origin's largest coordinate and `reach`.
        slack: Vec3,
        _pad0: u32,
    }
}

/// Factors of size that f32 has room for on both ways, with squares of areas.
const SIZES: std::ops::RangeInclusive<f64> = 1e-6..=1e6;
/// Largest over least factor up to which rounding a matrix to f32, by 2⁻²⁴ of its largest number, can't turn it inside out.
const MOST_STRETCHED: f64 = 1e6;
/// Coordinates within which corners stay, whatever is added up to them.
const FARTHEST: f64 = 4e9;
/// What rounding makes of a ray on its way into a mesh's coordinates, for each unit of the world's coordinates and of the
/// inverse's rows: by half units in the last place (2⁻²⁴), 1 for origin − translation and 4 for the products with the rounded
/// inverse; 4 for those of the direction, along the ray; 4 for the corners themselves, which are rounded in the world; 6 for
/// the triangle's own test; 1 for adding the slack. 20 in all, of which 32 are allowed.
const SLACK: f64 = 32.0 / 16_777_216.0;

impl Instance {
    /// Where a mesh stands whose coordinates are `farthest` from 0 at most; nothing if f32 can't bring rays there and back.
    pub(super) fn new(map: &DAffine3, farthest: DVec3) -> Option<Instance> {
        let (matrix, translation) = (map.matrix3.as_mat3(), map.translation.as_vec3());
        let exact = matrix.as_dmat3();
        let (least, most) = sizes(&exact);
        let fits = SIZES.contains(&least) && SIZES.contains(&most) && most <= MOST_STRETCHED * least;
        let reach = (absolute(&exact) * farthest + translation.abs().as_dvec3()).max_element();
        if !(fits && reach <= FARTHEST) {
            return None;
        }
        let inverse = exact.inverse();
        let rows = absolute(&inverse) * DVec3::ONE;
        Some(Instance {
            x_axis: matrix.x_axis,
            y_axis: matrix.y_axis,
            z_axis: matrix.z_axis,
            translation,
            inverse_x: inverse.x_axis.as_vec3(),
            inverse_y: inverse.y_axis.as_vec3(),
            inverse_z: inverse.z_axis.as_vec3(),
            mirrors: u32::from(exact.determinant() < 0.0),
            reach: reach as f32,
            slack: (rows * SLACK).as_vec3(),
            ..Default::default()
        })
    }

    /// Bounds of the factors by which lengths grow: not above the least, not below the largest.
    pub(super) fn sizes(&self) -> (f64, f64) {
        sizes(&DMat3::from_cols(self.x_axis.into(), self.y_axis.into(), self.z_axis.into()))
    }
}

fn absolute(matrix: &DMat3) -> DMat3 {
    DMat3::from_cols(matrix.x_axis.abs(), matrix.y_axis.abs(), matrix.z_axis.abs())
}

/// Bounds of the singular values. Two of them have a product of half the sum of all squares at most.
fn sizes(matrix: &DMat3) -> (f64, f64) {
    let squares: f64 = matrix.to_cols_array().iter().map(|x| x * x).sum();
    (2.0 * matrix.determinant().abs() / squares, squares.sqrt())
}

/// A corner of the mesh in the world. Every triangle that has it gets the same.
#[inline(always)]
pub fn place_corner(instance: &Instance, p: Vec3) -> Vec3 {
    instance.x_axis * p.x + instance.y_axis * p.y + instance.z_axis * p.z + instance.translation
}

/// A vector of the world in the mesh's coordinates.
#[inline(always)]
pub fn to_mesh(instance: &Instance, v: Vec3) -> Vec3 {
    instance.inverse_x * v.x + instance.inverse_y * v.y + instance.inverse_z * v.z
}

/// A triangle of the mesh in the world.
#[inline(always)]
pub fn place_triangle(instance: &Instance, triangle: &Triangle) -> Triangle {
    let [a, b, c] = [triangle.a, triangle.b, triangle.c].map(|corner| place_corner(instance, corner));
    let (b, c) = if instance.mirrors != 0 { (c, b) } else { (b, c) };
    Triangle { a, material: instance.material, b, kind: instance.kind, c, light: NONE }
}

/// A normal of the mesh in the world, by the cofactors; `flat` where it would be on the inner side.
#[inline]
pub fn place_normal(instance: &Instance, normal: Vec3, flat: Vec3) -> Vec3 {
    let Instance { x_axis: x, y_axis: y, z_axis: z, .. } = *instance;
    let turned = y.cross(z) * normal.x + z.cross(x) * normal.y + x.cross(y) * normal.z;
    let placed = if instance.mirrors != 0 { -turned } else { turned };
    let square = placed.dot(placed);
    if square <= SMALLEST_SQUARE || placed.dot(flat) <= 0.0 { flat } else { placed / square.sqrt() }
}

/// The instance that the shape is of, which is behind all that are laid out.
#[inline]
pub fn instance_of(scene: &CompiledScene, shape: u32) -> Instance {
    let (mut low, mut high) = (0, scene.shared.instances.len());
    while high - low > 1 {
        let middle = (low + high) / 2;
        if scene.shared.instances[middle].first_shape <= shape {
            low = middle;
        } else {
            high = middle;
        }
    }
    scene.shared.instances[low]
}

/// Where the shape's triangle lies among all that are stored.
#[inline]
pub fn stored_number(instance: &Instance, shape: u32) -> usize {
    (instance.first_triangle + (shape - instance.first_shape)) as usize
}

/// The shape's triangle in the world.
#[inline]
pub fn instanced_triangle(scene: &CompiledScene, shape: u32) -> Triangle {
    let instance = instance_of(scene, shape);
    place_triangle(&instance, scene.shared_triangle(stored_number(&instance, shape)))
}

#[inline]
pub fn instanced_info(scene: &CompiledScene, shape: u32) -> ShapeInfo {
    let instance = instance_of(scene, shape);
    ShapeInfo { material: instance.material, kind: instance.kind, light: NONE }
}

/// The normal between those of the corners, `flat` where the triangle has none.
#[inline]
pub fn instanced_normal(scene: &CompiledScene, shape: u32, shares: Vec2, flat: Vec3) -> Vec3 {
    let instance = instance_of(scene, shape);
    let TriangleNormals { a, b, c, given } = scene.surfaces.normals[stored_number(&instance, shape)];
    if given == 0 {
        return flat;
    }
    let [a, b, c] = [a, b, c].map(|word| place_normal(&instance, unpacked_normal(word), flat));
    let (b, c) = if instance.mirrors != 0 { (c, b) } else { (b, c) };
    let blended = a * (1.0 - shares.x - shares.y) + b * shares.x + c * shares.y;
    blended / blended.dot(blended).max(SMALLEST_SQUARE).sqrt()
}

#[inline]
pub fn instanced_uvs(scene: &CompiledScene, shape: u32) -> TriangleUvs {
    let instance = instance_of(scene, shape);
    place_uvs(&instance, scene.surfaces.uvs[stored_number(&instance, shape)])
}

/// In the order of the placed triangle's corners.
#[inline]
pub fn place_uvs(instance: &Instance, uvs: TriangleUvs) -> TriangleUvs {
    let TriangleUvs { u_b, v_b, u_c, v_c, .. } = uvs;
    match instance.mirrors {
        0 => uvs,
        _ => TriangleUvs { u_b: u_c, v_b: v_c, u_c: u_b, v_c: v_b, ..uvs },
    }
}
