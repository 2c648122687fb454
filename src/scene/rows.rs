//! A scene as one storage buffer, so that a kernel spends one binding on it: rows of 16 bytes, in parts. What every ray
//! reads of the shapes lies together in the first two, apart from what only a hit needs.
//! GPU twin: kernels/scene/data.wesl

use super::compiled::{CompiledScene, Light, Material, Quad, Sphere};
use crate::layout::GpuStruct;
use std::mem::offset_of;
use std::ops::Range;

/// Four words.
pub type Row = [u32; 4];

/// How many rows of a shape, from its first on, every ray reads; the rest is for hits and for light sampling.
pub const SPHERE_HOT_ROWS: usize = offset_of!(Sphere, material) / size_of::<Row>();
pub const QUAD_HOT_ROWS: usize = offset_of!(Quad, e1) / size_of::<Row>();

/// These rows of every item of an array, item after item.
struct Part<'a> {
    rows: &'a [Row],
    rows_per_item: usize,
    wanted: Range<usize>,
}

impl<'a> Part<'a> {
    fn new<T: GpuStruct>(items: &'a [T], wanted: Range<usize>) -> Self {
        Part { rows: bytemuck::cast_slice(items), rows_per_item: T::ROWS, wanted }
    }

    fn len(&self) -> usize {
        self.rows.len() / self.rows_per_item * self.wanted.len()
    }

    fn rows(&self) -> impl Iterator<Item = Row> {
        self.rows.chunks(self.rows_per_item).flat_map(|item| item[self.wanted.clone()].iter().copied())
    }
}

/// The parts in the order in which they lie in the buffer.
fn parts(scene: &CompiledScene) -> [Part<'_>; 6] {
    [
        Part::new(&scene.spheres, 0..SPHERE_HOT_ROWS),
        Part::new(&scene.quads, 0..QUAD_HOT_ROWS),
        Part::new(&scene.spheres, SPHERE_HOT_ROWS..Sphere::ROWS),
        Part::new(&scene.quads, QUAD_HOT_ROWS..Quad::ROWS),
        Part::new(&scene.materials, 0..Material::ROWS),
        Part::new(&scene.lights, 0..Light::ROWS),
    ]
}

/// All rows of the scene.
pub fn pack(scene: &CompiledScene) -> Vec<Row> {
    parts(scene).iter().flat_map(Part::rows).collect()
}

/// The rows that every ray reads: the first ones.
pub fn hot(scene: &CompiledScene) -> Vec<Row> {
    parts(scene)[..2].iter().flat_map(Part::rows).collect()
}

/// The number of the first row of each part.
pub fn first_rows(scene: &CompiledScene) -> [u32; 6] {
    let mut next = 0;
    parts(scene).map(|part| {
        let first = next;
        next += part.len() as u32;
        first
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Camera;
    use glam::DVec3;

    /// Items whose words are all different, from `first` on. As bits of floats they are small denormals: no NaN.
    fn numbered<T: GpuStruct>(count: usize, first: u32) -> Vec<T> {
        let words: Vec<u32> = (first..).take(count * size_of::<T>() / 4).collect();
        bytemuck::cast_slice(&words).to_vec()
    }

    fn numbered_scene(spheres: usize, quads: usize) -> CompiledScene {
        CompiledScene {
            spheres: numbered(spheres, 1_000),
            quads: numbered(quads, 2_000),
            materials: numbered(4, 3_000),
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
        for (spheres, quads) in [(3, 7), (0, 7), (3, 0)] {
            let scene = numbered_scene(spheres, quads);
            let rows = pack(&scene);
            let at = scene.uniforms(&camera(), 1, 1, 0);
            let first_quad_row = first_rows(&scene)[1];
            for (i, sphere) in scene.spheres.iter().enumerate() {
                assert_eq!(item::<Sphere>(&rows, i, SPHERE_HOT_ROWS, 0, at.first_sphere_rest_row), *sphere);
            }
            for (i, quad) in scene.quads.iter().enumerate() {
                assert_eq!(
                    item::<Quad>(&rows, i, QUAD_HOT_ROWS, first_quad_row, at.first_quad_rest_row),
                    *quad
                );
            }
            for (i, material) in scene.materials.iter().enumerate() {
                assert_eq!(item::<Material>(&rows, i, Material::ROWS, at.first_material_row, 0), *material);
            }
            for (i, light) in scene.lights.iter().enumerate() {
                assert_eq!(item::<Light>(&rows, i, Light::ROWS, at.first_light_row, 0), *light);
            }
            assert_eq!(hot(&scene), rows[..spheres + 4 * quads]);
            assert_eq!(rows.len(), 2 * spheres + 6 * quads + 2 * 4 + 2 * 5, "nothing lies there twice");
        }
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
