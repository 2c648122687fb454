//! Parallel locally-ordered clustering (Meister & Bittner 2018): boxes in the order of a space-filling curve are joined with
//! the neighbour in that order with which they make the smallest box, where both agree, again and again until one is left.
//!
//! Deviation: where few agree, as among boxes nested in each other, all are joined with the next one in the order. So passes
//! are as many as the logarithm of the number of boxes, whatever they are, and the time is about proportional to that number.

use glam::DVec3;
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, node::Bvh2Node};
use obvhs::ploc::morton::morton_encode_u64_unorm;
use rayon::prelude::*;
use std::ops::Range;

/// How far on either side in the order of the curve a box looks for its partner.
const REACH: usize = 14;
/// A pass that joins fewer than one pair of so many boxes is taken to be stuck.
const STUCK: usize = 16;
/// Boxes that a thread takes at once.
const CHUNK: usize = 512;

/// The tree over `boxes`, of which there is at least one; each is a leaf. After `patience` passes all are joined with the
/// next. Its `max_depth` is one more than the passes that it took.
pub(super) fn ploc(boxes: &[Aabb], patience: usize) -> Bvh2 {
    let mut clusters = along_the_curve(boxes);
    let mut nodes = vec![Bvh2Node::default(); 2 * boxes.len() - 1];
    let mut end = nodes.len();
    let mut passes = 0;
    while clusters.len() > 1 {
        let mut partners = if passes < patience { partners(&clusters) } else { vec![0; clusters.len()] };
        keep_mutual(&mut partners);
        clusters = joined(&clusters, &partners, &mut nodes, &mut end);
        passes += 1;
    }
    nodes[0] = clusters[0];
    Bvh2 {
        nodes,
        primitive_indices: (0..boxes.len() as u32).collect(),
        children_are_ordered_after_parents: true,
        max_depth: passes + 1,
        ..Default::default()
    }
}

/// A leaf for each box, in the order of a Morton curve through their middles.
fn along_the_curve(boxes: &[Aabb]) -> Vec<Bvh2Node> {
    let around = boxes.iter().fold(Aabb::INVALID, |all, b| all.union(b));
    let begin = around.min.as_dvec3();
    let scale = DVec3::ONE / around.diagonal().as_dvec3().max(DVec3::splat(f64::MIN_POSITIVE));
    let place = |b: &Aabb| morton_encode_u64_unorm((b.center().as_dvec3() - begin) * scale);
    let mut order: Vec<(u64, u32)> =
        boxes.par_iter().enumerate().map(|(i, b)| (place(b), i as u32)).collect();
    order.par_sort_unstable();
    order.par_iter().map(|&(_, i)| Bvh2Node::new(boxes[i as usize], 1, i)).collect()
}

/// For each cluster the one within reach with which it makes the smallest box. Of equally small ones that whose number differs
/// in the lowest bits, which is mutual: so all of many equal ones find partners at once.
fn partners(clusters: &[Bvh2Node]) -> Vec<u32> {
    let mut partners = vec![0; clusters.len()];
    partners.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, partners)| {
        let first = chunk * CHUNK;
        let seen = first.saturating_sub(REACH)..(first + partners.len() + REACH).min(clusters.len());
        let best = best_in(&clusters[seen.clone()], seen.start as u32);
        for (i, partner) in (first..).zip(partners) {
            *partner = match best[i - seen.start] {
                // Boxes without a size have no partner.
                u32::MAX => i as u32,
                bits => i as u32 ^ bits,
            };
        }
    });
    partners
}

/// [`partners`] of a stretch of clusters, from number `first` on: in what bits their numbers differ. What is asked of a pair is
/// the same on both sides, so each pair is asked once; plain loops over arrays, which compilers turn into vectors.
fn best_in(clusters: &[Bvh2Node], first: u32) -> Vec<u32> {
    let n = clusters.len();
    let edges: [Vec<f32>; 6] = std::array::from_fn(|k| {
        let edge = |c: &Bvh2Node| if k < 3 { c.aabb().min[k] } else { -c.aabb().max[k - 3] };
        clusters.iter().map(edge).collect()
    });
    let (mut areas, mut bits) = (vec![f32::INFINITY; n], vec![u32::MAX; n]);
    let (mut with, mut differ) = (vec![0.0; n], vec![0; n]);
    for step in 1..=REACH.min(n - 1) {
        let count = n - step;
        areas_with(&edges, step, &mut with[..count]);
        for (i, differ) in (first..).zip(&mut differ[..count]) {
            *differ = i ^ (i + step as u32);
        }
        for own in [0..count, step..n] {
            take_smaller(&mut areas[own.clone()], &mut bits[own], &with[..count], &differ[..count]);
        }
    }
    bits
}

/// Half the area of the box around each cluster and the one `step` after it. `edges` are least coordinates, negative greatest ones.
fn areas_with(edges: &[Vec<f32>; 6], step: usize, areas: &mut [f32]) {
    let least = |a: f32, b: f32| if a < b { a } else { b };
    let count = areas.len();
    let [x0, y0, z0, x1, y1, z1] = edges.each_ref().map(|edge| (&edge[..count], &edge[step..][..count]));
    for (i, area) in areas.iter_mut().enumerate() {
        let along = |low: (&[f32], &[f32]), high: (&[f32], &[f32])| {
            -least(low.0[i], low.1[i]) - least(high.0[i], high.1[i])
        };
        let (x, y, z) = (along(x0, x1), along(y0, y1), along(z0, z1));
        *area = x * y + y * z + z * x;
    }
}

/// The smaller of both, with its bits; of equal ones that with less bits.
fn take_smaller(areas: &mut [f32], bits: &mut [u32], others: &[f32], their_bits: &[u32]) {
    for (((area, bits), &other), &their_bits) in areas.iter_mut().zip(bits).zip(others).zip(their_bits) {
        let better = (other < *area) | ((other == *area) & (their_bits < *bits));
        *area = if better { other } else { *area };
        *bits = if better { their_bits } else { *bits };
    }
}

/// Leaves those partners that agree; others get themselves, or the next one of them where few agree.
fn keep_mutual(partners: &mut [u32]) {
    let alone: Vec<usize> = (0..partners.len())
        .filter(|&i| partners[partners[i] as usize] as usize != i || partners[i] as usize == i)
        .collect();
    let agreed = partners.len() - alone.len();
    for &i in &alone {
        partners[i] = i as u32;
    }
    if agreed / 2 < partners.len().div_ceil(STUCK) {
        for pair in alone.chunks_exact(2) {
            partners[pair[0]] = pair[1] as u32;
            partners[pair[1]] = pair[0] as u32;
        }
    }
}

/// The clusters of the next pass, in order; children go in front of `end`.
fn joined(clusters: &[Bvh2Node], partners: &[u32], nodes: &mut [Bvh2Node], end: &mut usize) -> Vec<Bvh2Node> {
    let mut next = Vec::with_capacity(clusters.len());
    for (i, cluster) in clusters.iter().enumerate() {
        let partner = partners[i] as usize;
        if partner == i {
            next.push(*cluster);
        } else if partner < i {
            let pair: Range<usize> = *end - 2..*end;
            *end = pair.start;
            nodes[pair].copy_from_slice(&[clusters[partner], *cluster]);
            next.push(Bvh2Node::new(cluster.aabb().union(clusters[partner].aabb()), 0, *end as u32));
        }
    }
    next
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3A;
    use std::f32::consts::TAU;

    fn boxes(count: usize, corners: impl Fn(f32) -> [Vec3A; 2]) -> Vec<Aabb> {
        let at = |i| corners(i as f32 / count as f32);
        (0..count).map(|i| Aabb { min: at(i)[0], max: at(i)[1] }).collect()
    }

    /// Boxes of which few agree on partners: nested ones, equal ones, those of a fan of triangles. By agreement alone 20,000
    /// nested ones take 20,000 passes and 15 seconds.
    #[test]
    fn clustering_takes_few_passes_whatever_the_boxes_are() {
        let rim = |t: f32| Vec3A::new((TAU * t).cos(), (TAU * t).sin(), 0.3 * (TAU * t).cos());
        let nested = boxes(20_000, |t| [Vec3A::splat(-1.0 - t), Vec3A::splat(1.0 + t)]);
        let equal = boxes(20_000, |_| [Vec3A::ZERO, Vec3A::ONE]);
        let fan = boxes(20_000, |t| [rim(0.0).min(rim(t)), rim(0.0).max(rim(t))]);
        let row = boxes(20_000, |t| [Vec3A::X * t, Vec3A::X * t + 1e-4]);
        for (name, boxes) in [("nested", nested), ("equal", equal), ("fan", fan), ("row", row)] {
            let tree = ploc(&boxes, 64);
            let passes = tree.max_depth - 1;
            println!("{name}: {passes} passes");
            assert!(passes <= 40, "{name}: {passes} passes");
            assert_eq!(tree.nodes.len(), 2 * boxes.len() - 1);
        }
        let equal = boxes(20_000, |_| [Vec3A::ZERO, Vec3A::ONE]);
        assert_eq!(ploc(&equal, 0).max_depth - 1, 15, "halves each time");
    }

    /// What the loops over arrays find is what looking at each neighbour finds.
    #[test]
    fn partners_make_the_smallest_boxes_within_reach() {
        let wave = |t: f32| Vec3A::new((t * 900.0).sin(), (t * 1700.0).cos(), (t * 331.0).sin() * t);
        let boxes = boxes(2000, |t| [wave(t), wave(t) + wave(t + 0.3).abs()]);
        let clusters = along_the_curve(&boxes);
        for (i, &partner) in partners(&clusters).iter().enumerate() {
            let area = |j: usize| clusters[i].aabb().union(clusters[j].aabb()).half_area();
            let near = (i.saturating_sub(REACH)..(i + REACH + 1).min(clusters.len())).filter(|&j| j != i);
            let least = near.map(area).fold(f32::INFINITY, f32::min);
            assert!(
                partner as usize != i && area(partner as usize) <= least * (1.0 + 1e-5),
                "{i}: {partner}"
            );
        }
    }
}
