//! Which meshes are stored once for all of their instances, and how a scene takes them in: laid out as triangles of their
//! own, or behind all other shapes as instances of one mesh. Both have the same corners, and the same numbers where all
//! instances are treated alike.

use super::bvh::{Bvh, NODE_ROWS};
use super::compiled::{CompiledScene, NONE, Triangle};
use super::instance::{Instance, place_normal, place_triangle, place_uvs};
use super::mesh::MeshInstance;
use super::surfaces::{TriangleNormals, TriangleUvs};
use super::triangle::double_area;
use super::{Geometry, Mesh, Shape};
use crate::layout::GpuStruct;
use glam::Vec3;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// Whether instances of a mesh share its triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Instancing {
    /// Where laying them out would take much more memory: a walk through two levels takes longer than one through one.
    #[default]
    Auto,
    /// All of them.
    Shared,
    /// None of them: each becomes triangles of its own.
    LaidOut,
}

/// Bytes beyond what sharing everything takes that laying out may cost. 32 MiB are 290 thousand flat triangles; rows of
/// larger scenes fit into no cache of a GPU either way.
pub const MOST_WASTED: u64 = 32 << 20;

/// What is stored once.
#[derive(Clone, Debug, Default)]
pub struct Shared {
    /// Of the meshes, one after the other, in their own coordinates. They are numbered behind those of the scene.
    pub triangles: Vec<Triangle>,
    /// In the order of their numbers as shapes.
    pub instances: Vec<Instance>,
    /// The box around each instance: its least and its greatest corner.
    pub bounds: Vec<[Vec3; 2]>,
    /// How many meshes there are.
    pub meshes: usize,
    /// How many triangles all instances have, each counted.
    pub seen: usize,
}

/// A mesh, by where it lies, with its instances.
struct Group {
    mesh: *const Mesh,
    count: u64,
    triangles: u64,
}

impl Group {
    /// Bytes that sharing saves.
    fn saving(&self, per_triangle: u64) -> u64 {
        let laid_out = self.count * self.triangles * per_triangle;
        laid_out.saturating_sub(self.triangles * per_triangle + self.count * INSTANCE_BYTES)
    }
}

fn groups(instances: &[(&MeshInstance, u32)]) -> Vec<Group> {
    let (mut groups, mut numbers): (Vec<Group>, _) = (Vec::new(), HashMap::new());
    for (instance, _) in instances {
        let mesh = Arc::as_ptr(instance.mesh());
        let number = *numbers.entry(mesh).or_insert(groups.len());
        if number == groups.len() {
            groups.push(Group { mesh, count: 0, triangles: instance.mesh().len() as u64 });
        }
        groups[number].count += 1;
    }
    groups
}

/// The meshes that share: the largest savings first, until laying out the rest costs little.
fn sharing(mut groups: Vec<Group>, how: Instancing, per_triangle: u64) -> HashSet<*const Mesh> {
    groups.sort_by_key(|group| std::cmp::Reverse(group.saving(per_triangle)));
    let mut wasted: u64 = groups.iter().map(|group| group.saving(per_triangle)).sum();
    let shares = |group: &Group| {
        let pays = wasted > MOST_WASTED;
        wasted -= group.saving(per_triangle);
        (how == Instancing::Shared || how == Instancing::Auto && pays).then_some(group.mesh)
    };
    groups.iter().filter_map(shares).collect()
}

/// Bytes that a triangle takes, with its node and what surfaces of this scene have.
fn bytes_per_triangle(scene: &CompiledScene) -> u64 {
    let normals = if scene.surfaces.is_smooth() { TriangleNormals::ROWS } else { 0 };
    let uvs = if scene.surfaces.is_textured() { TriangleUvs::ROWS } else { 0 };
    16 * (Triangle::ROWS + NODE_ROWS + normals + uvs) as u64
}

/// Bytes of an instance, with its node.
const INSTANCE_BYTES: u64 = 16 * (Instance::ROWS + NODE_ROWS) as u64;

/// Bytes of all that is shared, and what it would take laid out.
pub fn shared_bytes(scene: &CompiledScene) -> [u64; 2] {
    let (each, shared) = (bytes_per_triangle(scene), &scene.shared);
    let stored = shared.triangles.len() as u64 * each;
    [stored + shared.instances.len() as u64 * INSTANCE_BYTES, shared.seen as u64 * each]
}

impl CompiledScene {
    /// Takes in the instances among the shapes, behind all that stands once; returns the hierarchies of the meshes that are
    /// shared.
    pub(super) fn add_instances<'a>(&mut self, shapes: &[&'a Shape], how: Instancing) -> Vec<Bvh> {
        let instance = |shape: &&'a Shape| match &shape.geometry {
            Geometry::Instance(instance) => Some((instance, shape.material as u32)),
            _ => None,
        };
        let instances: Vec<(&MeshInstance, u32)> = shapes.iter().filter_map(instance).collect();
        let sharing = sharing(groups(&instances), how, bytes_per_triangle(self));
        let (shared, laid_out): (Vec<_>, Vec<_>) =
            instances.into_iter().partition(|(instance, _)| sharing.contains(&Arc::as_ptr(instance.mesh())));
        laid_out.into_iter().for_each(|(instance, material)| self.lay_out(instance, material));
        self.share(&shared)
    }

    /// The instance without its numbers.
    fn of_material(&self, instance: &MeshInstance, material: u32) -> Instance {
        let kind = self.materials[material as usize].kind;
        Instance { material, kind, ..instance.place() }
    }

    fn lay_out(&mut self, instance: &MeshInstance, material: u32) {
        let place = self.of_material(instance, material);
        let mesh = instance.mesh();
        let first = self.triangles.len();
        self.triangles.extend(mesh.triangles().map(|corners| place_triangle(&place, &triangle(corners))));
        let placed = &self.triangles[first..];
        self.surfaces.add(
            mesh.len(),
            mesh.normals().zip(placed).map(|(normals, &Triangle { a, b, c, .. })| {
                let flat = double_area(a, b, c).normalize();
                let [a, b, c] = normals.map(|normal| place_normal(&place, normal, flat));
                if place.mirrors != 0 { [a, c, b] } else { [a, b, c] }
            }),
            mesh.uvs().map(|uvs| place_uvs(&place, TriangleUvs::new(uvs))),
        );
    }

    /// Stores each mesh once, and all instances.
    fn share(&mut self, instances: &[(&MeshInstance, u32)]) -> Vec<Bvh> {
        // Where its triangles begin, and which of the hierarchies is its own.
        let mut meshes: HashMap<*const Mesh, (u32, u32)> = HashMap::new();
        let mut hierarchies = Vec::new();
        let laid_out = self.triangles.len();
        let mut next_shape = self.shape_count();
        for &(instance, material) in instances {
            let mesh = instance.mesh();
            let number = meshes.len() as u32;
            let (first_triangle, first_node) = *meshes.entry(Arc::as_ptr(mesh)).or_insert_with(|| {
                let first = self.shared.triangles.len();
                self.shared.triangles.extend(mesh.triangles().map(triangle));
                self.surfaces.add_mesh(mesh);
                hierarchies.push(Bvh::over(&self.shared.triangles[first..]));
                ((laid_out + first) as u32, number)
            });
            let place = self.of_material(instance, material);
            // `join` makes the number of the hierarchy that of its top node.
            let first_shape = next_shape as u32;
            self.shared.instances.push(Instance { first_shape, first_triangle, first_node, ..place });
            self.shared.bounds.push(instance.bounds());
            next_shape += mesh.len();
            self.shared.seen += mesh.len();
        }
        self.shared.meshes = meshes.len();
        hierarchies
    }
}

/// A triangle in the coordinates of its mesh.
fn triangle([a, b, c]: [Vec3; 3]) -> Triangle {
    Triangle { a, b, c, light: NONE, ..Default::default() }
}
