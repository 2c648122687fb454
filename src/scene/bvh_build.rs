//! Builds the bounding volume hierarchy over the shapes of a scene too large to ask them all: a binary tree (`ploc`), improved
//! by inserting its nodes anew (`obvhs`, Meister & Bittner 2018b), four of whose nodes at a time become one (`bvh_collapse`).

use super::bvh::{Bvh, MOST_DEPTH};
use super::bvh_collapse::{Wide, collapsed};
use super::bvh_pack::packed;
use super::compiled::{CompiledScene, Quad, Sphere, Triangle};
use super::ploc::ploc;
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

/// Boxes around all shapes, in the order of their numbers.
fn all_bounds(scene: &CompiledScene) -> Vec<Aabb> {
    let spheres = scene.spheres.iter().map(sphere_bounds);
    let quads = scene.quads.iter().map(quad_bounds);
    spheres.chain(quads).chain(scene.triangles.iter().map(triangle_bounds)).collect()
}

/// Passes of clustering after which a tree would be deeper than a walk remembers.
const PATIENCE: usize = 64;

impl Bvh {
    /// The hierarchy of a scene of one shape or more, whose triangles are put into its order.
    pub fn new(scene: &mut CompiledScene) -> Bvh {
        let start = Instant::now();
        let (tree, wide) = shallow_enough(&all_bounds(scene));
        let first_triangle = scene.shape_count() - scene.triangles.len();
        let triangles: Vec<u32> = wide
            .shapes
            .iter()
            .filter_map(|&shape| (shape as usize).checked_sub(first_triangle).map(|i| i as u32))
            .collect();
        let renumbered = scene.reorder_triangles(triangles);
        let number = |&shape: &u32| match (shape as usize).checked_sub(first_triangle) {
            Some(i) => first_triangle as u32 + renumbered[i],
            None => shape,
        };
        let numbers: Vec<u32> = wide.shapes.iter().map(number).collect();
        let rows = packed(&tree, &wide, &numbers);
        Bvh { rows, nodes: wide.nodes.len(), depth: wide.depth, seconds: start.elapsed().as_secs_f64() }
    }
}

/// The best hierarchy that a walk can go through: inserting anew may make it deep, and so may clustering.
fn shallow_enough(boxes: &[Aabb]) -> (Bvh2, Wide) {
    for (patience, ratio) in [(PATIENCE, if boxes.len() < MANY { 1.0 } else { 0.05 }), (PATIENCE, 0.0)] {
        let (mut tree, _) = ploc(boxes, patience);
        ReinsertionOptimizer::default().run(&mut tree, ratio, None);
        match collapsed(&tree) {
            Some(wide) if wide.depth <= MOST_DEPTH => return (tree, wide),
            _ => (),
        }
    }
    let (tree, _) = ploc(boxes, 0);
    let wide = collapsed(&tree).unwrap_or_default();
    (tree, wide)
}

#[cfg(test)]
mod tests {
    use super::super::bvh::{LEAF, NODE_ROWS, children};
    use super::*;
    use crate::scene::Scene;

    fn compiled(name: &str) -> CompiledScene {
        CompiledScene::new(&Scene::load(format!("scenes/{name}.toml")).unwrap())
    }

    /// Every shape in exactly one leaf, every box around what is in it, whatever tree it comes from.
    #[test]
    fn the_hierarchy_holds_every_shape_once_within_its_boxes() {
        for name in ["door-ajar", "many-lights", "cornell-box", "bansal-room-1", "mesh"] {
            let mut scene = compiled(name);
            let bvh = Bvh::new(&mut scene);
            holds_every_shape_once(name, &scene, &bvh);
            let (tree, _) = ploc(&all_bounds(&scene), 0);
            let wide = collapsed(&tree).unwrap();
            let rows = packed(&tree, &wide, &wide.shapes);
            assert!(wide.depth <= 3 * (1 + scene.shape_count().ilog2()), "{name}: {}", wide.depth);
            let halved = Bvh { rows, nodes: wide.nodes.len(), depth: wide.depth, seconds: 0.0 };
            holds_every_shape_once(name, &scene, &halved);
        }
    }

    fn holds_every_shape_once(name: &str, scene: &CompiledScene, bvh: &Bvh) {
        let count = scene.shape_count();
        assert!(3 * bvh.nodes >= count - 1 && bvh.nodes < count.max(2), "{name}: {} nodes", bvh.nodes);
        assert!(bvh.rows.len() >= NODE_ROWS * bvh.nodes);
        let shapes = all_bounds(scene);
        let mut seen = vec![0; count];
        // (what, boxes around it, children waiting)
        let mut open = vec![(0u32, vec![], 0u32)];
        let mut deepest = 0;
        while let Some((reference, around, waiting)) = open.pop() {
            if reference & LEAF != 0 {
                let shape = (reference & !LEAF) as usize;
                seen[shape] += 1;
                let Aabb { min, max } = shapes[shape];
                let holds = |[low, high]: &[Vec3; 2]| Vec3::from(min).cmpge(*low).all() && Vec3::from(max).cmple(*high).all();
                assert!(around.iter().all(holds), "{name}: {shape}");
                continue;
            }
            let children = children(bvh, reference);
            let waiting = waiting + children.len() as u32 - 1;
            deepest = deepest.max(waiting);
            for (child, corners) in children {
                let mut around = around.clone();
                around.push(corners);
                open.push((child, around, waiting));
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
            let mut scene = CompiledScene { spheres: (0..count).map(shell).collect(), ..Default::default() };
            let bvh = Bvh::new(&mut scene);
            assert!(bvh.depth <= MOST_DEPTH, "{}", bvh.depth);
            holds_every_shape_once("shells", &scene, &bvh);
        }
    }

    /// Threads share the work of building; what they build is the same.
    #[test]
    fn a_hierarchy_does_not_depend_on_the_number_of_threads() {
        let scene = compiled("mesh");
        let by = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Bvh::new(&mut scene.clone()).rows)
        };
        let alone = by(1);
        assert!((2..6).all(|threads| by(threads) == alone));
    }

    /// Triangles lie in the order in which a walk meets them, those that shine in front, and every one is still there.
    #[test]
    fn triangles_are_put_in_order_and_none_is_lost() {
        let described = Scene::load("scenes/mesh.toml").unwrap();
        let scene = CompiledScene::new(&described);
        let key = |corners: [Vec3; 3]| corners.map(|v| v.to_array().map(f32::to_bits));
        let mut given: Vec<_> = described
            .shapes
            .iter()
            .filter_map(|shape| match &shape.geometry {
                crate::scene::Geometry::Mesh(mesh) => Some(mesh.triangles().map(key)),
                _ => None,
            })
            .flatten()
            .collect();
        let mut kept: Vec<_> = scene.triangles.iter().map(|t| key([t.a, t.b, t.c])).collect();
        assert_ne!(given, kept, "there is an order to be made");
        given.sort_unstable();
        kept.sort_unstable();
        assert!(given == kept);
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
