//! Walks of the light tree: down to a light chosen by what it may send to a point, and up to find how likely that was (Conty
//! Estévez & Kulla 2018). GPU twin: kernels/transport/light_tree.wesl
//!
//! Direct light chooses by the normal of the surface too; where a ray meets a lamp by itself, the normal that it left is not
//! known any more. Weights of multiple importance sampling are right whatever they are made of, if both sides make them of the
//! same: so they are made of [`Importance::anywhere`], and only the choice itself of [`Importance::facing`].

use crate::sampling::BELOW_ONE;
use crate::scene::compiled::{CompiledScene, NONE};
use crate::scene::light_tree::{COUNT_SHIFT, LIGHT, LightCluster, MOST_CLUSTERS};
use glam::{Vec2, Vec3};

/// What is spread out with deviation 1 reaches so far about its mean: √8, as far as the corners of a triangle reach from its
/// middle, further than those of a quad do.
const REACH: f32 = 2.828_427_2;
/// Share of the variance of points that is added to the square of their distance.
const BLUR: f32 = 0.2;
/// So often a node's clusters are chosen evenly, whatever they send: none is as good as never chosen, and there are numbers that
/// choose each.
const EVEN_SHARE: f32 = 1.0 / 128.0;
/// Added to each importance: what sends nothing is chosen too where nothing else is there.
const LEAST_IMPORTANCE: f32 = 1e-36;
/// Squares of distances that stand for zero: no quotient by it overflows.
const SMALLEST_DISTANCE_SQUARE: f32 = 1e-30;
/// Intervals narrower than this stand for none: no quotient by their width overflows.
const NARROWEST: f32 = 1e-20;
/// Distance between the numbers that may be drawn; and from which distance on the tree fills them up from a second one.
const FINE: f32 = 1.0 / 16_777_216.0;
const COARSE: f32 = 1.0 / 65_536.0;

/// A light, and how likely the tree chooses it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeChoice {
    pub light: u32,
    /// Facing the normal: how likely it was.
    pub probability: f32,
    /// As far as the point tells: [`probability_in_tree`].
    pub weighing: f32,
}

/// About what a cluster sends, up to a factor that all share.
#[derive(Clone, Copy, Debug)]
pub struct Importance {
    /// To the point.
    pub anywhere: f32,
    /// To a surface there.
    pub facing: f32,
}

/// Mean of the positive part of what lies evenly between `mean` − `reach` and `mean` + `reach`.
#[inline(always)]
fn mean_above_zero(mean: f32, reach: f32) -> f32 {
    let above = mean + reach;
    if mean >= reach {
        mean
    } else if above <= 0.0 {
        0.0
    } else {
        above * above / (4.0 * reach)
    }
}

/// What `cluster` may be expected to send to `origin`, and to a surface there with that normal, 0 for none: strength over squared
/// distance, by the mean cosines on both sides. Normals that are `normal` on average lie about as far apart as that falls short
/// of 1: all around, for 0, a quarter of their area faces any point.
#[inline(always)]
pub fn importance(origin: Vec3, normal: Vec3, cluster: &LightCluster) -> Importance {
    let to_center = cluster.center - origin;
    let deviation = cluster.deviation;
    let distance2 =
        (to_center.dot(to_center) + BLUR * deviation.dot(deviation)).max(SMALLEST_DISTANCE_SQUARE);
    let inverse = 1.0 / distance2.sqrt();
    let reach = deviation * (REACH * inverse);
    let spread = (2.0 - 2.0 * cluster.normal.dot(cluster.normal)).max(0.0).sqrt();
    let turned = (spread + cluster.normal.abs().dot(reach)).min(1.0);
    let leaving = mean_above_zero(-cluster.normal.dot(to_center) * inverse, turned);
    let anywhere = cluster.strength / distance2 * leaving + LEAST_IMPORTANCE;
    let arriving = mean_above_zero(normal.dot(to_center) * inverse, normal.abs().dot(reach));
    Importance {
        anywhere,
        facing: if normal == Vec3::ZERO { anywhere } else { anywhere * arriving + LEAST_IMPORTANCE },
    }
}

/// How likely a node's cluster is chosen.
#[inline(always)]
fn share_of_cluster(importance: f32, total: f32, count: u32) -> f32 {
    EVEN_SHARE / count as f32 + (1.0 - EVEN_SHARE) * (importance / total)
}

/// A number on its way down: the choice of a child spends some of its digits, and the rest is stretched over 0 to 1.
#[derive(Clone, Copy, Debug)]
struct Digits {
    u: f32,
    /// Distance between the values that `u` may have.
    grid: f32,
    /// Digits to fill up with.
    spare: f32,
}

/// What is left of `digits` within the interval that begins at `low` and is `width` wide. When fewer than sixteen binary digits
/// are left, eight of the second number follow.
#[inline(always)]
fn stretched(digits: Digits, low: f32, width: f32) -> Digits {
    let width = width.max(NARROWEST);
    let u = ((digits.u - low) / width).clamp(0.0, BELOW_ONE);
    let grid = digits.grid / width;
    if grid <= COARSE {
        return Digits { u, grid, spare: digits.spare };
    }
    let scaled = digits.spare * 256.0;
    let next = scaled.floor();
    let grid = grid * (1.0 / 256.0);
    Digits { u: (u + next * grid).min(BELOW_ONE), grid, spare: scaled - next }
}

/// Where to go on from a node, and what was there.
#[derive(Clone, Copy, Debug, Default)]
struct Step {
    inside: u32,
    taken: (f32, f32),
    total: (f32, f32),
}

/// The cluster of a node that `digits` choose, where what they send is laid out from 0 to 1.
#[inline(always)]
fn step_down(scene: &CompiledScene, origin: Vec3, normal: Vec3, node: u32, digits: &mut Digits) -> Step {
    let (first, count) = node_of(node);
    let clusters = &clusters(scene)[first as usize..][..count as usize];
    let evenly = digits.u < EVEN_SHARE;
    let (low, width) = if evenly { (0.0, EVEN_SHARE) } else { (EVEN_SHARE, 1.0 - EVEN_SHARE) };
    *digits = stretched(*digits, low, width);
    let mut weights = [0.0; MOST_CLUSTERS];
    let mut step = Step::default();
    for (weight, cluster) in weights.iter_mut().zip(clusters) {
        let Importance { anywhere, facing } = importance(origin, normal, cluster);
        step.total = (step.total.0 + facing, step.total.1 + anywhere);
        *weight = if evenly { 1.0 } else { facing };
    }
    let total = if evenly { count as f32 } else { step.total.0 };
    let aim = digits.u * total;
    let mut before = 0.0;
    let mut chosen = 0;
    while chosen + 1 < clusters.len() && aim >= before + weights[chosen] {
        before += weights[chosen];
        chosen += 1;
    }
    *digits = stretched(*digits, before / total, weights[chosen] / total);
    let Importance { anywhere, facing } = importance(origin, normal, &clusters[chosen]);
    Step { inside: clusters[chosen].inside, taken: (facing, anywhere), ..step }
}

/// The first cluster of a node, and how many there are.
#[inline(always)]
fn node_of(inside: u32) -> (u32, u32) {
    (inside & ((1 << COUNT_SHIFT) - 1), (inside >> COUNT_SHIFT) + 1)
}

/// A light of a scene that has a tree, by what it may send to a surface at `origin` with that normal, or to the point itself if
/// the normal is 0. `u` in [0, 1)²: the second fills up the digits of the first.
#[inline(always)]
pub fn choose_in_tree(scene: &CompiledScene, origin: Vec3, normal: Vec3, u: Vec2) -> TreeChoice {
    let mut digits = Digits { u: u.x, grid: FINE, spare: u.y };
    let (mut probability, mut weighing) = (1.0, 1.0);
    let mut inside = clusters(scene)[0].inside;
    while inside & LIGHT == 0 {
        let (_, count) = node_of(inside);
        let step = step_down(scene, origin, normal, inside, &mut digits);
        probability *= share_of_cluster(step.taken.0, step.total.0, count);
        weighing *= share_of_cluster(step.taken.1, step.total.1, count);
        inside = step.inside;
    }
    TreeChoice { light: inside & !LIGHT, probability, weighing }
}

/// How likely the light is chosen for the point `origin`, whatever the surface there.
#[inline(always)]
pub fn probability_in_tree(scene: &CompiledScene, origin: Vec3, light: u32) -> f32 {
    let clusters = clusters(scene);
    let mut at = scene.lights[light as usize].cluster;
    let mut above = clusters[at as usize].above;
    let mut probability = 1.0;
    while above != NONE {
        let (first, count) = node_of(clusters[above as usize].inside);
        let (mut own, mut total) = (0.0, 0.0);
        for i in first..first + count {
            let Importance { anywhere, .. } = importance(origin, Vec3::ZERO, &clusters[i as usize]);
            total += anywhere;
            own = if i == at { anywhere } else { own };
        }
        probability *= share_of_cluster(own, total, count);
        at = above;
        above = clusters[at as usize].above;
    }
    probability
}

#[inline(always)]
fn clusters(scene: &CompiledScene) -> &[LightCluster] {
    scene.light_tree.as_ref().map_or(&[], |tree| &tree.clusters)
}
