//! A scene as one storage buffer, so that a kernel spends one binding on it: rows of 16 bytes, in parts. What every ray
//! reads of the shapes lies together in the first two, apart from what only a hit needs.
//! GPU twin: kernels/scene/data.wesl

use super::compiled::{CompiledScene, Light, Material, Quad, Sphere, Triangle, Uniforms};
use super::environment::{SkyCell, SkyRow};
use super::instance::Instance;
use super::light_tree::LightCluster;
use super::surfaces::{MaterialMaps, Surfaces, TextureImage, TriangleNormals, TriangleUvs};
use crate::layout::GpuStruct;
use std::mem::offset_of;
use std::ops::Range;

/// Four words.
pub type Row = [u32; 4];

/// How many rows of a shape, from its first on, every ray reads; the rest is for hits and for light sampling.
pub const SPHERE_HOT_ROWS: usize = offset_of!(Sphere, material) / size_of::<Row>();
pub const QUAD_HOT_ROWS: usize = offset_of!(Quad, e1) / size_of::<Row>();
/// How many rows of a material every hit reads. They are 32 bytes, which a GPU fetches at once; with the third between them
/// bansal-room-1 took 0.5 % longer (H100).
pub const MATERIAL_HOT_ROWS: usize = offset_of!(Material, roughness) / size_of::<Row>();

/// Which uniform tells the kernels where a part begins.
type Told = fn(&mut Uniforms) -> &mut u32;

/// These rows of every item of an array, item after item.
struct Part<'a> {
    rows: &'a [Row],
    rows_per_item: usize,
    wanted: Range<usize>,
    told: Option<Told>,
}

impl<'a> Part<'a> {
    fn new<T: GpuStruct>(items: &'a [T], wanted: Range<usize>) -> Self {
        Part { rows: bytemuck::cast_slice(items), rows_per_item: T::ROWS, wanted, told: None }
    }

    fn of_rows(rows: &'a [Row]) -> Self {
        Part { rows, rows_per_item: 1, wanted: 0..1, told: None }
    }

    fn told_by(self, told: Told) -> Self {
        Part { told: Some(told), ..self }
    }

    fn len(&self) -> usize {
        self.rows.len() / self.rows_per_item * self.wanted.len()
    }

    fn rows(&self) -> impl Iterator<Item = Row> {
        self.rows.chunks(self.rows_per_item).flat_map(|item| item[self.wanted.clone()].iter().copied())
    }
}

/// The parts in the order in which they lie in the buffer. Kernels know where the first two begin. Clusters of lamps come last, so
/// that a picture's fingerprint does not depend on how lamps are chosen.
fn parts(scene: &CompiledScene) -> Vec<Part<'_>> {
    let Surfaces { normals, uvs, maps, images, texels, srgb, .. } = &scene.surfaces;
    let clusters = scene.light_tree.as_ref().map_or(&[][..], |tree| &tree.clusters);
    let rough = if scene.has_microfacets() { &scene.materials[..] } else { &[] };
    let nodes = scene.bvh.as_ref().map_or(&[][..], |bvh| &bvh.rows);
    let (sky_rows, sky_cells) = scene.sky.as_ref().map_or((&[][..], &[][..]), |sky| (&sky.rows, &sky.cells));
    vec![
        Part::new(&scene.spheres, 0..SPHERE_HOT_ROWS),
        Part::new(&scene.quads, 0..QUAD_HOT_ROWS),
        Part::new(&scene.spheres, SPHERE_HOT_ROWS..Sphere::ROWS).told_by(|u| &mut u.first_sphere_rest_row),
        Part::new(&scene.quads, QUAD_HOT_ROWS..Quad::ROWS).told_by(|u| &mut u.first_quad_rest_row),
        Part::new(&scene.triangles, 0..Triangle::ROWS).told_by(|u| &mut u.first_triangle_row),
        // Numbered on from those of the scene.
        Part::new(&scene.shared.triangles, 0..Triangle::ROWS),
        Part::new(&scene.materials, 0..MATERIAL_HOT_ROWS).told_by(|u| &mut u.first_material_row),
        Part::new(rough, MATERIAL_HOT_ROWS..Material::ROWS).told_by(|u| &mut u.first_material_rest_row),
        Part::new(&scene.lights, 0..Light::ROWS).told_by(|u| &mut u.first_light_row),
        Part::of_rows(nodes).told_by(|u| &mut u.first_node_row),
        // Kernels know their number, and find them in front of the normals.
        Part::new(&scene.shared.instances, 0..Instance::ROWS),
        Part::new(normals, 0..TriangleNormals::ROWS).told_by(|u| &mut u.first_triangle_normals_row),
        Part::new(uvs, 0..TriangleUvs::ROWS).told_by(|u| &mut u.first_triangle_uvs_row),
        Part::new(maps, 0..MaterialMaps::ROWS).told_by(|u| &mut u.first_material_maps_row),
        Part::new(images, 0..TextureImage::ROWS).told_by(|u| &mut u.first_texture_image_row),
        Part::of_rows(texels).told_by(|u| &mut u.first_texel_row),
        Part::of_rows(srgb).told_by(|u| &mut u.first_srgb_row),
        Part::new(sky_rows, 0..SkyRow::ROWS).told_by(|u| &mut u.first_sky_row),
        Part::new(sky_cells, 0..SkyCell::ROWS).told_by(|u| &mut u.first_sky_cell_row),
        Part::new(clusters, 0..LightCluster::ROWS).told_by(|u| &mut u.first_cluster_row),
    ]
}

/// All rows of the scene.
pub fn pack(scene: &CompiledScene) -> Vec<Row> {
    parts(scene).iter().flat_map(Part::rows).collect()
}

/// Bytes of all rows, before there are any.
pub fn bytes(scene: &CompiledScene) -> u64 {
    parts(scene).iter().map(|part| (part.len() * size_of::<Row>()) as u64).sum()
}

/// Rows of an aligned quad in [`hot`].
pub const ALIGNED_ROWS: usize = 2;

/// What every ray reads of a small scene: spheres and aligned quads in brief, the first rows of other quads.
pub fn hot(scene: &CompiledScene) -> Vec<Row> {
    let (aligned, others) = scene.quads.split_at(scene.aligned.iter().sum());
    let aligned = aligned.iter().flat_map(|quad| aligned_rows(quad, quad.axis().unwrap_or(0)));
    let others = Part::new(others, 0..QUAD_HOT_ROWS);
    scene.spheres.iter().map(sphere_row).chain(aligned).chain(others.rows()).collect()
}

/// A sphere in brief: its centre, and the square of its radius, so that no ray multiplies.
fn sphere_row(sphere: &Sphere) -> Row {
    let [x, y, z] = sphere.center.to_array();
    [x, y, z, sphere.radius * sphere.radius].map(f32::to_bits)
}

/// An aligned quad: where it lies on its axis and where it begins on the next two, in that order around; what a length
/// along these times is its share of the side.
fn aligned_rows(quad: &Quad, axis: usize) -> [Row; ALIGNED_ROWS] {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let scale = quad.dual1 + quad.dual2;
    let row = |values: [f32; 4]| values.map(f32::to_bits);
    [row([quad.corner[axis], quad.corner[u], quad.corner[v], scale[u]]), row([scale[v], 0.0, 0.0, 0.0])]
}

/// Tells the uniforms where each part begins.
pub fn tell_first_rows(scene: &CompiledScene, uniforms: &mut Uniforms) {
    let mut next = 0;
    for part in parts(scene) {
        if let Some(told) = part.told {
            *told(uniforms) = next;
        }
        next += part.len() as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Camera, Scene};
    use glam::{DVec3, Vec3};

    /// Items whose words are all different, from `first` on. As bits of floats they are small denormals: no NaN.
    fn numbered<T: GpuStruct>(count: usize, first: u32) -> Vec<T> {
        let words: Vec<u32> = (first..).take(count * size_of::<T>() / 4).collect();
        bytemuck::cast_slice(&words).to_vec()
    }

    fn numbered_scene(spheres: usize, quads: usize, triangles: usize) -> CompiledScene {
        CompiledScene {
            spheres: numbered(spheres, 1_000),
            quads: numbered(quads, 2_000),
            materials: numbered(4, 3_000),
            triangles: numbered(triangles, 5_000),
            lights: numbered(5, 4_000),
            ..Default::default()
        }
    }

    /// Any: the rows do not depend on it.
    fn camera() -> Camera {
        let (origin, target, up) = (DVec3::ZERO, DVec3::NEG_Z, DVec3::Y);
        Camera { origin, target, up, fov_y_deg: 45.0, width: 1, height: 1 }
    }

    /// Item `i` of a part that begins at row `first`: as the kernels find it, rows split into a hot part and a rest.
    fn item<T: GpuStruct>(rows: &[Row], i: usize, hot: usize, first: u32, first_rest: u32) -> T {
        let at = |first: u32, count: usize| &rows[first as usize + i * count..][..count];
        let item = [at(first, hot), at(first_rest, T::ROWS - hot)].concat();
        bytemuck::pod_read_unaligned(bytemuck::cast_slice(&item))
    }

    #[test]
    fn unpacking_gives_back_every_struct() {
        for (spheres, quads, triangles) in [(3, 7, 0), (0, 7, 5), (3, 0, 2)] {
            let scene = numbered_scene(spheres, quads, triangles);
            let rows = pack(&scene);
            let at = scene.uniforms(&camera(), 1, 1, 0);
            let first_quad_row = (SPHERE_HOT_ROWS * spheres) as u32;
            for (i, sphere) in scene.spheres.iter().enumerate() {
                assert_eq!(item::<Sphere>(&rows, i, SPHERE_HOT_ROWS, 0, at.first_sphere_rest_row), *sphere);
            }
            for (i, quad) in scene.quads.iter().enumerate() {
                assert_eq!(
                    item::<Quad>(&rows, i, QUAD_HOT_ROWS, first_quad_row, at.first_quad_rest_row),
                    *quad
                );
            }
            for (i, triangle) in scene.triangles.iter().enumerate() {
                assert_eq!(item::<Triangle>(&rows, i, Triangle::ROWS, at.first_triangle_row, 0), *triangle);
            }
            for (i, material) in scene.materials.iter().enumerate() {
                let [first, rest] = [at.first_material_row, at.first_material_rest_row];
                assert_eq!(item::<Material>(&rows, i, MATERIAL_HOT_ROWS, first, rest), *material);
            }
            for (i, light) in scene.lights.iter().enumerate() {
                assert_eq!(item::<Light>(&rows, i, Light::ROWS, at.first_light_row, 0), *light);
            }
            assert_eq!(bytes(&scene), size_of_val(&rows[..]) as u64);
            let hot = hot(&scene);
            assert_eq!(hot[spheres..], rows[spheres..spheres + 4 * quads], "no quad is aligned");
            for (brief, whole) in hot.iter().zip(&rows[..spheres]) {
                let radius = f32::from_bits(whole[3]);
                assert_eq!((&brief[..3], f32::from_bits(brief[3])), (&whole[..3], radius * radius));
            }
            assert_eq!(
                rows.len(),
                2 * spheres + 6 * quads + 3 * triangles + 3 * 4 + 2 * 5,
                "nothing lies there twice"
            );
        }
    }

    #[test]
    fn aligned_quads_are_found_and_told_in_brief() {
        let scene = CompiledScene::new(&Scene::load("scenes/door-ajar.toml").unwrap());
        assert_eq!(scene.quads.len(), 64);
        assert_eq!(scene.aligned.iter().sum::<usize>(), 63, "all but the door");
        let hot = hot(&scene);
        assert_eq!(hot.len(), 2 * 63 + 4);
        for (quad, rows) in scene.quads.iter().zip(hot.chunks(2)).take(63) {
            let axis = quad.axis().unwrap();
            let value = |i: usize| f32::from_bits(rows[i / 4][i % 4]);
            // The far corner is at share 1 of both sides, a point beyond it is not.
            let far = quad.corner + quad.e1 + quad.e2;
            for (k, (corner, scale)) in [(1, (value(1), value(3))), (2, (value(2), value(4)))] {
                assert!(((far[(axis + k) % 3] - corner) * scale - 1.0).abs() < 1e-6, "{quad:?}");
            }
            assert_eq!(value(0), quad.corner[axis]);
        }
        let tilted =
            Quad { normal: Vec3::X, dual1: Vec3::new(0.0, 1.0, 0.5), dual2: Vec3::Z, ..Default::default() };
        assert_eq!(tilted.axis(), None, "a parallelogram in a plane of two axes");
        assert_eq!(Quad { dual1: Vec3::Y, ..tilted }.axis(), Some(0));
    }

    /// What `sphere_test` and `quad_test` read in kernels/scene/data.wesl.
    #[test]
    fn what_every_ray_reads_is_in_hot_rows() {
        let hot = |fields: &[crate::layout::Field], name: &str, rows: usize| {
            fields.iter().find(|f| f.name == name).unwrap().offset / size_of::<Row>() < rows
        };
        assert!(["center", "radius"].iter().all(|name| hot(Sphere::FIELDS, name, SPHERE_HOT_ROWS)));
        let quad = ["corner", "normal", "dual1", "dual2"];
        assert!(quad.iter().all(|name| hot(Quad::FIELDS, name, QUAD_HOT_ROWS)));
        assert!(!hot(Quad::FIELDS, "e1", QUAD_HOT_ROWS));
    }
}
