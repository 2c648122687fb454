//! A bounding volume hierarchy over the shapes of a scene too large to ask them all, as the GPU walks it. Built by `obvhs`
//! (PLOC, Meister & Bittner 2018, with reinsertion), which is met in this file only. GPU twin: kernels/scene/bvh.wesl

use super::compiled::{CompiledScene, Quad, Sphere};
use super::rows::Row;
use glam::Vec3;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::ploc::{PlocSearchDistance, SortPrecision};
use obvhs::{Boundable, BvhBuildParams};

/// Marks the number of a shape where a node could stand.
pub const LEAF: u32 = 1 << 31;
/// How much larger than its shape a box is, relative to its largest coordinate: more than intersection rounds by.
const PADDING: f32 = 2e-6;
/// Rows of a node.
pub const NODE_ROWS: usize = 4;

/// Two boxes, and what is in each: the number of another node, or of a shape with [`LEAF`]. In rows:
/// minimum, child · maximum, 0 of the first; the same of the second.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bvh {
    pub rows: Vec<Row>,
    /// Nodes that a walk may have to come back to at once, at most.
    pub depth: u32,
}

struct Bounds(Aabb);

impl Boundable for Bounds {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

fn bounds(min: Vec3, max: Vec3) -> Bounds {
    let margin = PADDING * min.abs().max(max.abs()).max_element();
    Bounds(Aabb { min: (min - margin).into(), max: (max + margin).into() })
}

fn sphere_bounds(sphere: &Sphere) -> Bounds {
    bounds(sphere.center - sphere.radius, sphere.center + sphere.radius)
}

fn quad_bounds(quad: &Quad) -> Bounds {
    let Quad { corner, e1, e2, .. } = *quad;
    let corners = [corner, corner + e1, corner + e2, corner + e1 + e2];
    let (first, rest) = (corners[0], &corners[1..]);
    bounds(rest.iter().fold(first, |a, &b| a.min(b)), rest.iter().fold(first, |a, &b| a.max(b)))
}

impl Bvh {
    /// The hierarchy of a scene of two shapes or more.
    pub fn new(scene: &CompiledScene) -> Bvh {
        let shapes: Vec<Bounds> =
            scene.spheres.iter().map(sphere_bounds).chain(scene.quads.iter().map(quad_bounds)).collect();
        let parameters = BvhBuildParams {
            pre_split: false,
            ploc_search_distance: PlocSearchDistance::Medium,
            search_depth_threshold: 3,
            reinsertion_batch_ratio: 1.0,
            post_collapse_reinsertion_batch_ratio_multiplier: 0.0,
            sort_precision: SortPrecision::U64,
            // A shape is tested in about the time of a node.
            max_prims_per_leaf: 1,
            collapse_traversal_cost: 1.0,
        };
        let tree = build_bvh2(&shapes, parameters, &mut Default::default());
        let mut bvh = Bvh::default();
        bvh.add_node(&tree, 0, 1);
        bvh
    }

    /// Adds an inner node and, behind it, all below it.
    fn add_node(&mut self, tree: &Bvh2, node: usize, depth: u32) -> u32 {
        let number = (self.rows.len() / NODE_ROWS) as u32;
        self.depth = self.depth.max(depth);
        self.rows.extend([Row::default(); NODE_ROWS]);
        for side in 0..2 {
            let index = tree.nodes[node].first_index as usize + side;
            let child = &tree.nodes[index];
            let reference = match child.prim_count {
                0 => self.add_node(tree, index, depth + 1),
                _ => LEAF | tree.primitive_indices[child.first_index as usize],
            };
            let row = |v: glam::Vec3A, word| [v.x.to_bits(), v.y.to_bits(), v.z.to_bits(), word];
            let first = number as usize * NODE_ROWS + 2 * side;
            self.rows[first] = row(child.aabb.min, reference);
            self.rows[first + 1] = row(child.aabb.max, 0);
        }
        number
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    fn bvh(name: &str) -> (CompiledScene, Bvh) {
        let scene = CompiledScene::new(&Scene::load(format!("scenes/{name}.toml")).unwrap());
        let bvh = Bvh::new(&scene);
        (scene, bvh)
    }

    fn corner(row: Row) -> Vec3 {
        Vec3::from_array([row[0], row[1], row[2]].map(f32::from_bits))
    }

    /// Every shape in exactly one leaf, every box around what is in it.
    #[test]
    fn the_hierarchy_holds_every_shape_once_within_its_boxes() {
        for name in ["door-ajar", "many-lights", "cornell-box", "bansal-room-1"] {
            let (scene, bvh) = bvh(name);
            let count = scene.spheres.len() + scene.quads.len();
            assert_eq!(bvh.rows.len(), NODE_ROWS * (count - 1), "{name}");
            let shapes: Vec<Bounds> =
                scene.spheres.iter().map(sphere_bounds).chain(scene.quads.iter().map(quad_bounds)).collect();
            let mut seen = vec![0; count];
            // (what, box around it, depth)
            let everything = (Vec3::NEG_INFINITY, Vec3::INFINITY);
            let mut open = vec![(0u32, everything, 1u32)];
            let mut deepest = 0;
            while let Some((reference, (min, max), depth)) = open.pop() {
                if reference & LEAF != 0 {
                    let shape = (reference & !LEAF) as usize;
                    seen[shape] += 1;
                    let Aabb { min: a, max: b } = shapes[shape].0;
                    assert!(
                        Vec3::from(a).cmpge(min).all() && Vec3::from(b).cmple(max).all(),
                        "{name}: {shape}"
                    );
                    continue;
                }
                deepest = deepest.max(depth);
                let rows = &bvh.rows[NODE_ROWS * reference as usize..][..NODE_ROWS];
                for side in rows.chunks(2) {
                    let (low, high) = (corner(side[0]), corner(side[1]));
                    assert!(low.cmpge(min).all() && high.cmple(max).all(), "{name}: a box sticks out");
                    open.push((side[0][3], (low, high), depth + 1));
                }
            }
            assert!(seen.iter().all(|&n| n == 1), "{name}: {seen:?}");
            assert_eq!(deepest, bvh.depth, "{name}");
        }
    }

    #[test]
    fn boxes_hold_points_of_their_shapes() {
        let sphere = Sphere { center: Vec3::new(1.0, -2.0, 3.0), radius: 0.5, ..Default::default() };
        let Aabb { min, max } = sphere_bounds(&sphere).0;
        assert!(min.y < -2.5 && max.z > 3.5 && min.x > 0.49 && max.x < 1.51);
        let quad =
            Quad { corner: Vec3::ONE, e1: Vec3::NEG_X, e2: Vec3::new(0.0, 2.0, 1.0), ..Default::default() };
        let Aabb { min, max } = quad_bounds(&quad).0;
        assert!(min.x < 0.0 && max.x > 1.0 && max.y > 3.0 && max.z > 2.0 && min.y < 1.0 && max.y < 3.01);
    }
}
