//! Builds the bounding volume hierarchy over the shapes of a scene too large to ask them all: clusters their boxes (`ploc`),
//! inserts nodes of the tree anew where that makes boxes smaller (Meister & Bittner 2018, by `obvhs`), and lays it out.

use super::bvh::{Bvh, LEAF, MOST_DEPTH, NODE_ROWS};
use super::compiled::{CompiledScene, Quad, Sphere, Triangle};
use super::ploc::ploc;
use super::rows::Row;
use super::two_levels::INSTANCE;
use glam::Vec3;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use std::time::Instant;

/// How much larger than its shape a box is, relative to its largest coordinate: more than intersection rounds by.
const PADDING: f32 = 2e-6;
/// From so many shapes on, only the twentieth of the nodes that gains most is inserted anew. All of them gain nothing more: for
/// 82 thousand to a million triangles walks on a CPU took within 5 % of the same time, and building up to 13 times as long.
const MANY: usize = 10_000;

/// Passes of clustering after which the tree would become deeper than a walk remembers.
const PATIENCE: usize = 64;

fn bounds(min: Vec3, max: Vec3) -> Aabb {
    let margin = PADDING * min.abs().max(max.abs()).max_element();
    Aabb { min: (min - margin).into(), max: (max + margin).into() }
}

fn sphere_bounds(sphere: &Sphere) -> Aabb {
    bounds(sphere.center - sphere.radius, sphere.center + sphere.radius)
}

fn quad_bounds(quad: &Quad) -> Aabb {
    let Quad { corner, e1, e2, .. } = *quad;
    let corners = [corner, corner + e1, corner + e2, corner + e1 + e2];
    let (first, rest) = (corners[0], &corners[1..]);
    bounds(rest.iter().fold(first, |a, &b| a.min(b)), rest.iter().fold(first, |a, &b| a.max(b)))
}

fn triangle_bounds(triangle: &Triangle) -> Aabb {
    let Triangle { a, b, c, .. } = *triangle;
    bounds(a.min(b).min(c), a.max(b).max(c))
}

/// Boxes around all shapes that are laid out, in the order of their numbers, and then around all instances.
fn all_bounds(scene: &CompiledScene) -> Vec<Aabb> {
    let spheres = scene.spheres.iter().map(sphere_bounds);
    let quads = scene.quads.iter().map(quad_bounds);
    let instances = scene.shared.bounds.iter().map(|&[low, high]| bounds(low, high));
    spheres.chain(quads).chain(scene.triangles.iter().map(triangle_bounds)).chain(instances).collect()
}

impl Bvh {
    /// The hierarchy of a scene of one shape or more; of instances, over them as wholes.
    pub fn new(scene: &CompiledScene) -> Bvh {
        let start = Instant::now();
        let boxes = all_bounds(scene);
        let mut bvh = Bvh::best(&boxes);
        bvh.mark_instances((boxes.len() - scene.shared.instances.len()) as u32);
        bvh.seconds = start.elapsed().as_secs_f64();
        bvh
    }

    /// The hierarchy over triangles, numbered from 0.
    pub(super) fn over(triangles: &[Triangle]) -> Bvh {
        let start = Instant::now();
        let bvh = Bvh::best(&triangles.iter().map(triangle_bounds).collect::<Vec<_>>());
        Bvh { seconds: start.elapsed().as_secs_f64(), ..bvh }
    }

    /// Puts the hierarchies of meshes behind the nodes of this one; returns where each begins. A walk is in one mesh at a time.
    pub(super) fn join(&mut self, meshes: &[Bvh]) -> Vec<u32> {
        let deepest = meshes.iter().map(|mesh| mesh.depth).max().unwrap_or(0);
        self.depth += deepest;
        let place = |mesh: &Bvh| {
            let first = (self.rows.len() / NODE_ROWS) as u32;
            self.rows.extend(&mesh.rows);
            self.references().skip(2 * first as usize).for_each(|reference| {
                if *reference & LEAF == 0 {
                    *reference += first;
                }
            });
            self.seconds += mesh.seconds;
            first
        };
        meshes.iter().map(place).collect()
    }

    /// Leaves from that number on are of instances.
    fn mark_instances(&mut self, first: u32) {
        for reference in self.references() {
            if *reference & LEAF != 0 && *reference & !LEAF >= first {
                *reference = LEAF | INSTANCE | ((*reference & !LEAF) - first);
            }
        }
    }

    /// What is in each box, two for each node.
    fn references(&mut self) -> impl Iterator<Item = &mut u32> {
        self.rows.iter_mut().step_by(2).map(|row| &mut row[3])
    }

    /// The best hierarchy of those that a walk can go through: inserting nodes anew may make it too deep, as may clustering.
    fn best(boxes: &[Aabb]) -> Bvh {
        let share = if boxes.len() < MANY { 1.0 } else { 0.05 };
        for share in [share, 0.0] {
            let mut tree = ploc(boxes, PATIENCE);
            ReinsertionOptimizer::default().run(&mut tree, share, None);
            let bvh = Bvh::flattened(&tree);
            if bvh.depth <= MOST_DEPTH {
                return bvh;
            }
        }
        Bvh::balanced(boxes)
    }

    /// The nodes of a tree, each in front of all below it.
    fn flattened(tree: &Bvh2) -> Bvh {
        let root = &tree.nodes[0];
        if root.prim_count > 0 {
            let leaf = (LEAF | tree.primitive_indices[root.first_index as usize], root.aabb);
            return Bvh::of_one(leaf);
        }
        let mut bvh = Bvh::default();
        // (node of the tree, row that is to hold its number, depth)
        let mut open = vec![(0, None, 1)];
        while let Some((node, parent, depth)) = open.pop() {
            let first = bvh.add_node(parent, depth);
            let children = tree.nodes[node].first_index as usize;
            for side in [1, 0] {
                let child = &tree.nodes[children + side];
                let row = first + 2 * side;
                let leaf = match child.prim_count {
                    0 => 0,
                    _ => LEAF | tree.primitive_indices[child.first_index as usize],
                };
                bvh.set_child(row, (leaf, child.aabb));
                if child.prim_count == 0 {
                    open.push((children + side, Some(row), depth + 1));
                }
            }
        }
        bvh
    }

    /// A hierarchy of least depth: boxes are joined with the next one in the order of a curve.
    fn balanced(boxes: &[Aabb]) -> Bvh {
        Bvh::flattened(&ploc(boxes, 0))
    }

    /// A single leaf, which is asked twice: the second box is the first, and equal distances change nothing.
    fn of_one(leaf: (u32, Aabb)) -> Bvh {
        let mut bvh = Bvh::default();
        let first = bvh.add_node(None, 1);
        bvh.set_child(first, leaf);
        bvh.set_child(first + 2, leaf);
        bvh
    }

    /// Adds a node, tells the row of its parent, and returns its own first row.
    fn add_node(&mut self, parent: Option<usize>, depth: u32) -> usize {
        let first = self.rows.len();
        if let Some(parent) = parent {
            self.rows[parent][3] = (first / NODE_ROWS) as u32;
        }
        self.depth = self.depth.max(depth);
        self.rows.extend([Row::default(); NODE_ROWS]);
        first
    }

    /// What is in the box that begins at `row`, and the box.
    fn set_child(&mut self, row: usize, (reference, around): (u32, Aabb)) {
        let words = |v: glam::Vec3A, word| [v.x.to_bits(), v.y.to_bits(), v.z.to_bits(), word];
        self.rows[row] = words(around.min, reference);
        self.rows[row + 1] = words(around.max, 0);
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

    /// Every shape in exactly one leaf, every box around what is in it; in a balanced one too.
    #[test]
    fn the_hierarchy_holds_every_shape_once_within_its_boxes() {
        for name in ["door-ajar", "many-lights", "cornell-box", "bansal-room-1", "mesh"] {
            let (scene, bvh) = bvh(name);
            holds_every_shape_once(name, &scene, &bvh);
            let balanced = Bvh::balanced(&all_bounds(&scene));
            holds_every_shape_once(name, &scene, &balanced);
            assert_eq!(balanced.depth, scene.shape_count().next_power_of_two().ilog2(), "{name}");
        }
    }

    fn holds_every_shape_once(name: &str, scene: &CompiledScene, bvh: &Bvh) {
        let count = scene.shape_count();
        assert_eq!(bvh.rows.len(), NODE_ROWS * (count - 1), "{name}");
        let shapes = all_bounds(scene);
        let mut seen = vec![0; count];
        // (what, box around it, depth)
        let everything = (Vec3::NEG_INFINITY, Vec3::INFINITY);
        let mut open = vec![(0u32, everything, 1u32)];
        let mut deepest = 0;
        while let Some((reference, (min, max), depth)) = open.pop() {
            if reference & LEAF != 0 {
                let shape = (reference & !LEAF) as usize;
                seen[shape] += 1;
                let Aabb { min: a, max: b } = shapes[shape];
                assert!(Vec3::from(a).cmpge(min).all() && Vec3::from(b).cmple(max).all(), "{name}: {shape}");
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

    /// Shells within shells are joined one by one where neighbours have to agree, which would be a walk's depth.
    #[test]
    fn no_hierarchy_is_deeper_than_a_walk_remembers() {
        for (count, growth) in [(300, 1.05f32), (20_000, 1.0005)] {
            let shell = |i| Sphere { radius: growth.powi(i), ..Default::default() };
            let scene = CompiledScene { spheres: (0..count).map(shell).collect(), ..Default::default() };
            let bvh = Bvh::new(&scene);
            assert!(bvh.depth <= MOST_DEPTH, "{count}: {}", bvh.depth);
            holds_every_shape_once("shells", &scene, &bvh);
        }
    }

    /// Threads share the work of building; what they build is the same.
    #[test]
    fn a_hierarchy_does_not_depend_on_the_number_of_threads() {
        let (scene, _) = bvh("mesh");
        let by = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Bvh::new(&scene).rows)
        };
        let alone = by(1);
        assert!((2..6).all(|threads| by(threads) == alone));
    }

    #[test]
    fn boxes_hold_points_of_their_shapes() {
        let sphere = Sphere { center: Vec3::new(1.0, -2.0, 3.0), radius: 0.5, ..Default::default() };
        let Aabb { min, max } = sphere_bounds(&sphere);
        assert!(min.y < -2.5 && max.z > 3.5 && min.x > 0.49 && max.x < 1.51);
        let quad =
            Quad { corner: Vec3::ONE, e1: Vec3::NEG_X, e2: Vec3::new(0.0, 2.0, 1.0), ..Default::default() };
        let Aabb { min, max } = quad_bounds(&quad);
        assert!(min.x < 0.0 && max.x > 1.0 && max.y > 3.0 && max.z > 2.0 && min.y < 1.0 && max.y < 3.01);
    }
}
