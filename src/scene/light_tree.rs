//! A tree over the lamps of a scene that has many: what a lamp, or several together, may be expected to send to a point, told by
//! where they are, how far apart, which way they face and how strong they are. After Conty Estévez & Kulla 2018, "Importance
//! Sampling of Many Lights with Adaptive Tree Splitting". Walked by transport/light_tree.rs; the walk needs neither stack nor
//! bound on the depth.
//!
//! Deviations: what is kept of several lamps are moments, weighted by strength, and not bounds: where one of them outshines the
//! rest it is the one that matters, and a mean is nearer to what they send than the most that they could. And nodes are wide:
//! halves of halves of a node are told apart at once, which leaves much less noise than the two-way choices of a binary tree.

use super::compiled::{CompiledScene, NONE, ShapeIndex};
use super::triangle::double_area;
use crate::gpu_struct;
use glam::Vec3;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::time::Instant;

/// Marks the number of a light where a node could stand.
pub const LIGHT: u32 = 1 << 31;
/// A node is the number of its first cluster, and above these bits how many follow it.
pub const COUNT_SHIFT: u32 = 27;
/// Clusters of a node, at most.
pub const MOST_CLUSTERS: usize = 16;
/// Scenes with fewer lamps choose among them by power alone.
pub const FEWEST_LIGHTS: usize = 16;
/// Lights up to which clusters, fewer than twice as many, have numbers of [`COUNT_SHIFT`] bits.
pub const MOST_LIGHTS: usize = 1 << (COUNT_SHIFT - 1);
/// The weakest lamp's share of the strength of all that the tree knows of: far above the end of f32's range at any distance.
const LEAST_STRENGTH: f64 = 1e-12;
/// Intervals into which the centres along an axis are sorted to find where to split.
const BINS: usize = 12;
/// From so many lamps on, a node is split along its longest axis only, …
const MANY: usize = 4096;
/// … and its halves are built by threads of their own.
const WORTH_A_THREAD: usize = 4096;
/// Half the distance of 1 from the next number.
const ROUNDING: f64 = f32::EPSILON as f64 / 2.0;

gpu_struct! {
    /// One lamp or more. Those of a node lie together; the first of all holds every lamp. Means are weighted by strength.
    pub struct LightCluster {
        /// Of all points that shine.
        center: Vec3,
        /// The node below, as [`COUNT_SHIFT`] says, or the number of the one light with [`LIGHT`].
        inside: u32,
        /// Mean of the normals where they shine: of length 1 where all are the same, 0 where they are all around.
        normal: Vec3,
        /// The cluster whose node this one belongs to, NONE for the first of all.
        above: u32,
        /// Standard deviation of the points along each axis.
        deviation: Vec3,
        /// Radiance × area, as a share of that of all.
        strength: f32,
    }
}

/// A cluster of 48 bytes per lamp, and one per node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightTree {
    pub clusters: Vec<LightCluster>,
    /// How long it took to build.
    pub seconds: f64,
}

/// Of a lamp or of several.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    center: Vec3,
    normal: Vec3,
    /// Square of the deviation.
    variance: Vec3,
    strength: f32,
}

#[derive(Clone, Copy, Debug)]
struct Lamp {
    light: u32,
    moments: Moments,
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

/// All lights with their moments.
fn lamps(scene: &CompiledScene) -> Vec<Lamp> {
    let moments: Vec<(Moments, f64)> = scene
        .lights
        .par_iter()
        .map(|light| {
            let (moments, area) = match scene.shape_index(light.shape) {
                ShapeIndex::Sphere(i) => sphere_moments(scene.spheres[i].center, scene.spheres[i].radius),
                ShapeIndex::Quad(i) => {
                    let quad = &scene.quads[i];
                    let center = quad.corner + 0.5 * (quad.e1 + quad.e2);
                    let variance = (quad.e1 * quad.e1 + quad.e2 * quad.e2) / 12.0;
                    flat_moments(center, variance, quad.e1, quad.e2)
                }
                ShapeIndex::Triangle(i) => {
                    let t = &scene.triangles[i];
                    let (e1, e2) = (t.b - t.a, t.c - t.a);
                    let (middle, third) = ((e1 + e2) / 3.0, e1 * e1 + e2 * e2 - e1 * e2);
                    let (moments, area) = flat_moments(t.a + middle, third / 18.0, e1, e2);
                    (moments, 0.5 * area)
                }
            };
            (moments, radiance(scene, light.material) * area)
        })
        .collect();
    let total: f64 = moments.iter().map(|(_, strength)| strength).sum();
    let lamp = |(light, (moments, strength)): (u32, (Moments, f64))| {
        let strength = (strength / total).max(LEAST_STRENGTH) as f32;
        Lamp { light, moments: Moments { strength, ..moments } }
    };
    (0..).zip(moments).map(lamp).collect()
}

/// Of the channels together, as noise counts them: the root of the sum of their squares.
fn radiance(scene: &CompiledScene, material: u32) -> f64 {
    let emission = scene.materials[material as usize].emission * scene.surfaces.mean_emission(material);
    emission.as_dvec3().length()
}

/// Moments of a sphere, and its area. One that shines inwards is seen from every direction as well.
fn sphere_moments(center: Vec3, radius: f32) -> (Moments, f64) {
    let variance = Vec3::splat(radius * radius / 3.0);
    (Moments { center, variance, ..Default::default() }, 4.0 * PI * f64::from(radius).powi(2))
}

/// Moments of what is flat and has these sides, and the area of the parallelogram. The kernels round the product of its sides,
/// which turns the normal of a sliver: where that may be far, it counts as all around.
fn flat_moments(center: Vec3, variance: Vec3, e1: Vec3, e2: Vec3) -> (Moments, f64) {
    let rounded = double_area(Vec3::ZERO, e1, e2).as_dvec3();
    let turn = 8.0 * ROUNDING * e1.as_dvec3().length() * e2.as_dvec3().length() / rounded.length();
    let normal = if turn < 0.5 { rounded.normalize().as_vec3() } else { Vec3::ZERO };
    (Moments { center, normal, variance, strength: 0.0 }, rounded.length())
}

impl Moments {
    /// Of both together.
    fn merged(&self, other: &Moments) -> Moments {
        let strength = self.strength + other.strength;
        let share = other.strength / strength;
        let apart = other.center - self.center;
        let mean = |a: Vec3, b: Vec3| a + share * (b - a);
        Moments {
            center: mean(self.center, other.center),
            normal: mean(self.normal, other.normal),
            variance: mean(self.variance, other.variance) + share * (1.0 - share) * (apart * apart),
            strength,
        }
    }

    fn cluster(&self, inside: u32) -> LightCluster {
        let Moments { center, normal, variance, strength } = *self;
        LightCluster { center, inside, normal, above: NONE, deviation: variance.map(f32::sqrt), strength }
    }

    /// After the surface area orientation heuristic: strength × size × solid angle lit, from π for one direction to 4π for all.
    fn cost(&self) -> f32 {
        self.strength * (4.0 - 3.0 * self.normal.length().min(1.0)) * self.variance.element_sum().sqrt()
    }
}

/// Halves `lamps`, two or more, again and again, from node `first` on, each node in front of all below it. Node k is
/// clusters 2k and 2k + 1.
fn build(lamps: &mut [Lamp], clusters: &mut [LightCluster], first: u32) -> Moments {
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

/// What is inside the cluster that holds these lamps, and their moments.
fn child(lamps: &mut [Lamp], clusters: &mut [LightCluster], node: u32) -> (Moments, u32) {
    match lamps {
        [lamp] => (lamp.moments, LIGHT | lamp.light),
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
        0 => cluster.strength * cluster.deviation.length(),
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

/// Lamps whose centres are in one interval of an axis.
#[derive(Clone, Copy, Default)]
struct Bin {
    moments: Moments,
    count: usize,
}

impl Bin {
    fn add(&mut self, other: &Bin) {
        self.moments = if self.count == 0 { other.moments } else { self.moments.merged(&other.moments) };
        self.count += other.count;
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
        lamps.iter().fold(empty, |(low, high), l| (low.min(l.moments.center), high.max(l.moments.center)));
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
            partition(lamps, |l| bin_of(l.moments.center[axis], low[axis], scale) < bin)
        }
        // All in one place.
        None => lamps.len() / 2,
    }
}

/// The cheapest boundary between intervals along an axis: its cost, and the number of the first interval behind it.
fn best_boundary(lamps: &[Lamp], axis: usize, low: f32, scale: f32) -> Option<(f32, usize)> {
    let mut bins = [Bin::default(); BINS];
    for lamp in lamps {
        bins[bin_of(lamp.moments.center[axis], low, scale)].add(&Bin { moments: lamp.moments, count: 1 });
    }
    let mut behind = [Bin::default(); BINS + 1];
    for i in (0..BINS).rev() {
        behind[i] = behind[i + 1];
        behind[i].add(&bins[i]);
    }
    let mut before = Bin::default();
    let boundary = |i: usize| {
        before.add(&bins[i - 1]);
        let both = before.count > 0 && behind[i].count > 0;
        both.then(|| (before.moments.cost() + behind[i].moments.cost(), i))
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
