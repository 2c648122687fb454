//! Meshes that stand in several places: what they share, and each place.

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;

use super::{LARGEST, Mesh, MeshData, has_area};
use crate::scene::instance::{Instance, place_corner};
use crate::scene::triangle::double_area;

/// Coordinates in the world may be so many times smaller than what adds up to them; beyond that, too many of their digits
/// would be lost in f32, and the mesh is placed in f64.
const MOST_CANCELLED: f32 = 4.0;
/// A mesh smaller than this is not shared: f32 might not tell its triangles from nothing before they are scaled up.
const SMALLEST: f64 = 1e-3;
/// What rounding moves corners by, at most, as a share of the instance's reach: eight half units in the last place.
const MOVED: f64 = 8.0 / 16_777_216.0;

/// Corners or triangles that a thread takes at once.
const CHUNK: usize = 1 << 13;
/// The box around nothing.
const NOTHING: [Vec3; 2] = [Vec3::INFINITY, Vec3::NEG_INFINITY];

fn joined([low, high]: [Vec3; 2], [a, b]: [Vec3; 2]) -> [Vec3; 2] {
    [low.min(a), high.max(b)]
}

/// A mesh at one of the places where it stands. It shares its triangles with the others; in the world they are where its
/// matrix brings them in f32.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshInstance {
    mesh: Arc<Mesh>,
    /// All but its numbers and its material.
    place: Instance,
    bounds: [Vec3; 2],
}

impl MeshInstance {
    /// The mesh in its own coordinates.
    pub fn mesh(&self) -> &Arc<Mesh> {
        &self.mesh
    }

    /// The box around all triangles: its least and its greatest corner.
    pub fn bounds(&self) -> [Vec3; 2] {
        self.bounds
    }

    pub(in crate::scene) fn place(&self) -> Instance {
        self.place
    }
}

/// A mesh that may be shared, and what decides where.
#[derive(Debug)]
pub(in crate::scene) struct Sharing {
    mesh: Arc<Mesh>,
    /// Of the triangles, each once.
    corners: Vec<Vec3>,
    /// Largest coordinates.
    farthest: DVec3,
    /// Of each triangle its least distance of a corner from the opposite edge, and its number; the flattest first.
    heights: Vec<(f32, u32)>,
    /// Least double area.
    least_area: f64,
}

impl Sharing {
    /// Nothing where the mesh had better be placed in f64, each time anew, or is none.
    pub fn new(data: &MeshData) -> Option<Sharing> {
        let mesh = Mesh::with_area(data).ok()??;
        let mut used = vec![false; mesh.positions.len()];
        mesh.triangles.iter().flatten().for_each(|&corner| used[corner as usize] = true);
        let corners: Vec<Vec3> =
            mesh.positions.iter().zip(used).filter(|(_, used)| *used).map(|(p, _)| *p).collect();
        let farthest = corners.iter().fold(Vec3::ZERO, |most, p| most.max(p.abs())).as_dvec3();
        let (mut heights, mut least_area) = (Vec::with_capacity(mesh.len()), f64::MAX);
        for (number, [a, b, c]) in mesh.triangles().enumerate() {
            let area = double_area(a, b, c).length();
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            heights.push((area / longest, number as u32));
            least_area = least_area.min(f64::from(area));
        }
        heights.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mesh = Arc::new(mesh);
        let sharing = Sharing { mesh, corners, farthest, heights, least_area };
        (sharing.farthest.max_element() >= SMALLEST).then_some(sharing)
    }

    /// The mesh under that map; nothing where it had better be placed in f64, or where a triangle would lose its area.
    pub fn at(&self, map: &DAffine3) -> Option<MeshInstance> {
        let place = Instance::new(map, self.farthest)?;
        let placed = |corner: Vec3| place_corner(&place, corner);
        let [low, high] = self
            .corners
            .par_chunks(CHUNK)
            .map(|corners| {
                corners.iter().map(|&p| placed(p)).fold(NOTHING, |around, p| joined(around, [p; 2]))
            })
            .reduce(|| NOTHING, joined);
        let largest = low.abs().max(high.abs()).max_element();
        let fits = f64::from(largest) <= LARGEST && place.reach <= MOST_CANCELLED * largest;
        let has_area = |&(_, number): &(f32, u32)| {
            has_area(self.mesh.corners(&self.mesh.triangles[number as usize]).map(placed))
        };
        let whole = || self.doubtful(&place).par_chunks(CHUNK).all(|chunk| chunk.iter().all(has_area));
        (fits && whole()).then(|| MeshInstance { mesh: self.mesh.clone(), place, bounds: [low, high] })
    }

    /// The triangles that may lose their area there. Places shrink heights by the square of the least factor over the largest at
    /// most, and rounding moves corners by less than what is left of the others.
    fn doubtful(&self, place: &Instance) -> &[(f32, u32)] {
        let (least, most) = place.sizes();
        if self.least_area * least * least <= 1e-17 {
            return &self.heights;
        }
        let needed = 8.0 * MOVED * f64::from(place.reach) * most / (least * least);
        &self.heights[..self.heights.partition_point(|&(height, _)| f64::from(height) <= needed)]
    }
}
