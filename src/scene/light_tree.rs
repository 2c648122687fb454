//! A tree over the lamps of a scene that has many: what a lamp, or several together, may send to a point, told by a ball around
//! them, a cone around their normals and their strength (Conty Estévez & Kulla 2018, "Importance Sampling of Many Lights with
//! Adaptive Tree Splitting"). Walked by transport/light_tree.rs; the walk needs neither stack nor bound on the depth.
//!
//! Deviation: while the tree is built, how far normals spread is estimated by the length of their mean, so that a million lamps
//! need no cones merged but those of the finished nodes. And nodes are wide: halves of halves of a node are told apart at once, by
//! bounds far tighter than those of the halves, which leaves much less noise than the two-way choices of a binary tree.

use super::compiled::{CompiledScene, NONE, ShapeIndex};
use super::triangle::double_area;
use crate::gpu_struct;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f32::consts::PI;
use std::time::Instant;

/// Marks the number of a light where a node could stand.
pub const LIGHT: u32 = 1 << 31;
/// A node is the number of its first cluster, and above these bits how many follow it.
pub const COUNT_SHIFT: u32 = 27;
/// Clusters of a node, at most.
pub const MOST_CLUSTERS: usize = 16;
/// Scenes with fewer lamps choose among them by power alone.
pub const FEWEST_LIGHTS: usize = 16;
/// The weakest lamp's share of the strength of all that the tree knows of: far above the end of f32's range at any distance.
const LEAST_STRENGTH: f64 = 1e-12;
/// Intervals into which the centres along an axis are sorted to find where to split.
const BINS: usize = 12;
/// From so many lamps on, a node is split along its longest axis only, …
const MANY: usize = 4096;
/// … and its halves are built by threads of their own.
const WORTH_A_THREAD: usize = 4096;
/// Half the distance of 1 from the next number.
const ROUNDING: f32 = f32::EPSILON / 2.0;

gpu_struct! {
    /// One lamp or more. Those of a node lie together; the first of all holds every lamp.
    pub struct LightCluster {
        /// Of a ball around them.
        center: Vec3,
        radius: f32,
        /// Of a cone that holds all normals of their bright sides.
        axis: Vec3,
        /// Radiance × area that faces a point at most, as a share of that of all.
        strength: f32,
        /// Of the angle between the axis and the side of the cone, up to π.
        cos_cone: f32,
        sin_cone: f32,
        /// The node below, as [`COUNT_SHIFT`] says, or the number of the one light with [`LIGHT`].
        inside: u32,
        /// The cluster whose node this one belongs to, NONE for the first of all.
        above: u32,
    }
}

/// A cluster of 48 bytes per lamp, and one per node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightTree {
    pub clusters: Vec<LightCluster>,
    /// How long it took to build.
    pub seconds: f64,
}

/// Of a lamp or a cluster.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    min: Vec3,
    max: Vec3,
    center: Vec3,
    radius: f32,
    axis: Vec3,
    /// Angle of the cone, 0 to π.
    spread: f32,
    strength: f32,
}

#[derive(Clone, Copy, Debug)]
struct Lamp {
    light: u32,
    bounds: Bounds,
}

impl LightTree {
    /// Of two lights or more. Writes into each which cluster it is.
    pub fn new(scene: &mut CompiledScene) -> LightTree {
        let start = Instant::now();
        let mut lamps = lamps(scene);
        let mut halves = vec![LightCluster::default(); 2 * (lamps.len() - 1)];
        let all = build(&mut lamps, &mut halves, 0);
        let clusters = widened(&halves, all.cluster(0));
        for (i, cluster) in clusters.iter().enumerate() {
            if cluster.inside & LIGHT != 0 {
                scene.lights[(cluster.inside & !LIGHT) as usize].cluster = i as u32;
            }
        }
        LightTree { clusters, seconds: start.elapsed().as_secs_f64() }
    }
}

/// All lights with their bounds.
fn lamps(scene: &CompiledScene) -> Vec<Lamp> {
    let bounds: Vec<(Bounds, f64)> = scene
        .lights
        .par_iter()
        .map(|light| {
            let (bounds, area) = match scene.shape_index(light.shape) {
                ShapeIndex::Sphere(i) => sphere_bounds(scene.spheres[i].center, scene.spheres[i].radius),
                ShapeIndex::Quad(i) => {
                    let quad = &scene.quads[i];
                    let (a, b) = (quad.corner, quad.corner + quad.e1);
                    flat_bounds(&[a, b, a + quad.e2, b + quad.e2], quad.e1, quad.e2)
                }
                ShapeIndex::Triangle(i) => {
                    let t = &scene.triangles[i];
                    let (bounds, area) = flat_bounds(&[t.a, t.b, t.c], t.b - t.a, t.c - t.a);
                    (bounds, 0.5 * area)
                }
            };
            (bounds, scene.mean_emission(light.material) * area)
        })
        .collect();
    let total: f64 = bounds.iter().map(|(_, strength)| strength).sum();
    let lamp = |(light, (bounds, strength)): (u32, (Bounds, f64))| {
        let strength = (strength / total).max(LEAST_STRENGTH) as f32;
        Lamp { light, bounds: Bounds { strength, ..bounds } }
    };
    (0..).zip(bounds).map(lamp).collect()
}

/// What rounding may move points with such coordinates by, a few times over.
fn margin(min: Vec3, max: Vec3) -> f32 {
    8.0 * ROUNDING * min.abs().max(max.abs()).max_element()
}

/// Bounds of a sphere, and its area as it is seen. One that shines inwards is seen from every direction as well.
fn sphere_bounds(center: Vec3, radius: f32) -> (Bounds, f64) {
    let (min, max) = (center - radius, center + radius);
    let bounds = Bounds {
        min,
        max,
        center,
        radius: radius * (1.0 + 4.0 * ROUNDING),
        axis: Vec3::Z,
        spread: PI,
        strength: 0.0,
    };
    (bounds, std::f64::consts::PI * f64::from(radius).powi(2))
}

/// Bounds of what lies flat between these corners, and the area of the parallelogram. The kernels round the product of its
/// sides, which turns the normal of a sliver: its cone is as wide as that may be.
fn flat_bounds(corners: &[Vec3], e1: Vec3, e2: Vec3) -> (Bounds, f64) {
    let min = corners.iter().fold(corners[0], |a, &b| a.min(b));
    let max = corners.iter().fold(corners[0], |a, &b| a.max(b));
    let center = min + 0.5 * (max - min);
    let radius = corners.iter().map(|c| c.distance(center)).fold(0.0, f32::max) + margin(min, max);
    let rounded = double_area(Vec3::ZERO, e1, e2).as_dvec3();
    let turn = 8.0 * f64::from(ROUNDING) * e1.as_dvec3().length() * e2.as_dvec3().length() / rounded.length();
    let (axis, spread) = match turn < 0.5 {
        true => (rounded.normalize().as_vec3(), 2.0 * turn as f32),
        false => (Vec3::Z, PI),
    };
    (Bounds { min, max, center, radius, axis, spread, strength: 0.0 }, rounded.length())
}

impl Bounds {
    fn merged(&self, other: &Bounds) -> Bounds {
        let (min, max) = (self.min.min(other.min), self.max.max(other.max));
        let center = min + 0.5 * (max - min);
        let reach = |b: &Bounds| b.center.distance(center) + b.radius;
        let radius = (0.5 * (max - min).length()).min(reach(self).max(reach(other)));
        let radius = radius * (1.0 + 4.0 * ROUNDING) + margin(min, max);
        let (axis, spread) = merged_cones((self.axis, self.spread), (other.axis, other.spread));
        Bounds { min, max, center, radius, axis, spread, strength: self.strength + other.strength }
    }

    fn cluster(&self, inside: u32) -> LightCluster {
        let Bounds { center, radius, axis, spread, strength, .. } = *self;
        let (sin_cone, cos_cone) = if spread >= PI { (0.0, -1.0) } else { spread.sin_cos() };
        LightCluster { center, radius, axis, strength, cos_cone, sin_cone, inside, above: NONE }
    }
}

/// A cone around two, each told by its axis and its angle.
fn merged_cones(a: (Vec3, f32), b: (Vec3, f32)) -> (Vec3, f32) {
    let ((a, wide), (b, narrow)) = if a.1 >= b.1 { (a, b) } else { (b, a) };
    let (from, to) = (a.as_dvec3(), b.as_dvec3());
    let across = from.cross(to);
    let between = across.length().atan2(from.dot(to)) as f32;
    if between + narrow <= wide {
        return (a, wide);
    }
    let spread = 0.5 * (wide + between + narrow);
    if spread >= PI || across == DVec3::ZERO {
        return (a, PI);
    }
    let turn = f64::from(spread - wide);
    let beside = across.cross(from).normalize();
    let axis = (from * turn.cos() + beside * turn.sin()).normalize();
    (axis.as_vec3(), spread + 8.0 * ROUNDING)
}

/// Halves `lamps`, two or more, again and again, from node `first` on, each node in front of all below it. Node k is
/// clusters 2k and 2k + 1.
fn build(lamps: &mut [Lamp], clusters: &mut [LightCluster], first: u32) -> Bounds {
    let count = lamps.len();
    let middle = split(lamps);
    let (left, right) = lamps.split_at_mut(middle);
    let (own, below) = clusters.split_at_mut(2);
    let (below_left, below_right) = below.split_at_mut(2 * (middle - 1));
    let mut a = || child(left, below_left, first + 1);
    let mut b = || child(right, below_right, first + middle as u32);
    let ((a, inside_a), (b, inside_b)) = if count < WORTH_A_THREAD { (a(), b()) } else { rayon::join(a, b) };
    own[0] = a.cluster(inside_a);
    own[1] = b.cluster(inside_b);
    a.merged(&b)
}

/// What is inside the cluster that holds these lamps, and their bounds.
fn child(lamps: &mut [Lamp], clusters: &mut [LightCluster], node: u32) -> (Bounds, u32) {
    match lamps {
        [lamp] => (lamp.bounds, LIGHT | lamp.light),
        _ => (build(lamps, clusters, node), node),
    }
}

/// The tree of nodes that are as wide as they may be, from one of halves: of what a node holds, that is halved again which is
/// largest and strongest.
fn widened(halves: &[LightCluster], all: LightCluster) -> Vec<LightCluster> {
    let mut clusters = vec![all];
    let mut level = 0..1;
    while !level.is_empty() {
        let held = |cluster: &LightCluster| match cluster.inside & LIGHT {
            0 => opened(halves, cluster.inside),
            _ => Vec::new(),
        };
        let nodes: Vec<Vec<LightCluster>> = clusters[level.clone()].par_iter().map(held).collect();
        let next = clusters.len();
        for (i, node) in level.zip(nodes).filter(|(_, node)| !node.is_empty()) {
            clusters[i].inside = clusters.len() as u32 | (node.len() as u32 - 1) << COUNT_SHIFT;
            clusters.extend(node.into_iter().map(|cluster| LightCluster { above: i as u32, ..cluster }));
        }
        level = next..clusters.len();
    }
    clusters
}

/// What node `node` of the tree of halves holds, when it is opened as far as it may be.
fn opened(halves: &[LightCluster], node: u32) -> Vec<LightCluster> {
    let pair = |node: u32| &halves[2 * node as usize..][..2];
    let mut open = pair(node).to_vec();
    let size = |cluster: &LightCluster| match cluster.inside & LIGHT {
        0 => cluster.strength * cluster.radius * cluster.radius,
        _ => -1.0,
    };
    while open.len() < MOST_CLUSTERS {
        let largest = (0..open.len()).max_by(|&a, &b| size(&open[a]).total_cmp(&size(&open[b])));
        let Some(largest) = largest.filter(|&i| open[i].inside & LIGHT == 0) else { break };
        let inside = open.swap_remove(largest).inside;
        open.extend_from_slice(pair(inside));
    }
    open
}

/// Centres in one interval of an axis.
#[derive(Clone, Copy)]
struct Bin {
    min: Vec3,
    max: Vec3,
    /// Sum of axes × strength, without those of lamps that shine all around.
    normals: Vec3,
    strength: f32,
    count: usize,
}

const EMPTY: Bin =
    Bin { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY, normals: Vec3::ZERO, strength: 0.0, count: 0 };

impl Bin {
    fn add(&mut self, other: &Bin) {
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
        self.normals += other.normals;
        self.strength += other.strength;
        self.count += other.count;
    }

    /// Surface area orientation heuristic: strength × size × solid angle lit, from π for one direction to 4π for all.
    fn cost(&self) -> f32 {
        let lit = 4.0 - 3.0 * (self.normals.length() / self.strength).min(1.0);
        self.strength * lit * (self.max - self.min).length_squared()
    }
}

impl Lamp {
    fn bin(&self) -> Bin {
        let Bounds { min, max, axis, spread, strength, .. } = self.bounds;
        let normals = if spread < PI { axis * strength } else { Vec3::ZERO };
        Bin { min, max, normals, strength, count: 1 }
    }
}

/// Which interval of `low .. low + BINS / scale` a coordinate is in.
fn bin_of(x: f32, low: f32, scale: f32) -> usize {
    (((x - low) * scale) as usize).min(BINS - 1)
}

/// Puts those lamps first that go to one side, and returns how many: one at least, and not all.
fn split(lamps: &mut [Lamp]) -> usize {
    let empty = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) =
        lamps.iter().fold(empty, |(low, high), l| (low.min(l.bounds.center), high.max(l.bounds.center)));
    let size = high - low;
    let axes = 0..3;
    let longest = if size.x >= size.y.max(size.z) { 0 } else { 2 - usize::from(size.y >= size.z) };
    let wanted = axes.filter(|&axis| size[axis] > 0.0 && (lamps.len() < MANY || axis == longest));
    let best = wanted.filter_map(|axis| {
        let scale = BINS as f32 / size[axis];
        let (cost, bin) = best_boundary(lamps, axis, low[axis], scale).filter(|_| scale.is_finite())?;
        Some((cost, axis, bin, scale))
    });
    match best.min_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((_, axis, bin, scale)) => {
            partition(lamps, |l| bin_of(l.bounds.center[axis], low[axis], scale) < bin)
        }
        // All in one place.
        None => lamps.len() / 2,
    }
}

/// The cheapest boundary between intervals along an axis: its cost, and the number of the first interval behind it.
fn best_boundary(lamps: &[Lamp], axis: usize, low: f32, scale: f32) -> Option<(f32, usize)> {
    let mut bins = [EMPTY; BINS];
    for lamp in lamps {
        bins[bin_of(lamp.bounds.center[axis], low, scale)].add(&lamp.bin());
    }
    let mut behind = [EMPTY; BINS + 1];
    for i in (0..BINS).rev() {
        behind[i] = behind[i + 1];
        behind[i].add(&bins[i]);
    }
    let mut before = EMPTY;
    let boundary = |i: usize| {
        before.add(&bins[i - 1]);
        let both = before.count > 0 && behind[i].count > 0;
        both.then(|| (before.cost() + behind[i].cost(), i))
    };
    (1..BINS).filter_map(boundary).min_by(|a, b| a.0.total_cmp(&b.0))
}

/// Puts those first that `belongs` names; how many they are.
fn partition(lamps: &mut [Lamp], belongs: impl Fn(&Lamp) -> bool) -> usize {
    let mut first = 0;
    for i in 0..lamps.len() {
        if belongs(&lamps[i]) {
            lamps.swap(first, i);
            first += 1;
        }
    }
    first
}
