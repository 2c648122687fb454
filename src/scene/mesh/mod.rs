//! Surfaces of triangles: as given ([`MeshData`]), from code or from a file, and as the renderer takes them ([`Mesh`]).

pub(super) mod file;
mod obj;
mod placement;
mod ply;
mod sharing;
#[cfg(test)]
mod tests;

use std::collections::HashSet;

use glam::{DVec3, Vec3};

use super::triangle::{SMALLEST_SQUARE, double_area};

pub use file::MeshFormat;
pub use placement::Placement;
pub use sharing::MeshInstance;
pub(super) use sharing::Sharing;

/// Coordinates beyond which products of areas would overflow an f32.
const LARGEST: f64 = 1e9;
/// Texture coordinates beyond which f32 tells few texels apart.
const FARTHEST_UV: f32 = 1e6;
/// Triangles that a scene can number.
const MOST_TRIANGLES: usize = 1 << 30;

/// Corners and triangles as someone gave them; nothing is checked before a scene takes them in.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshData {
    /// Corners.
    pub positions: Vec<DVec3>,
    /// A normal for each corner, of any length, or none at all: then the triangles are flat. Light is reflected as by a
    /// surface that has these normals; what emits, casts shadows and is met are the triangles.
    pub normals: Vec<DVec3>,
    /// Where each corner lies in textures, or nothing: (0, 0) is the upper left corner of an image, (1, 1) the lower right.
    pub uvs: Vec<[f32; 2]>,
    /// Three numbers of corners each, counterclockwise as seen from the outer side, the one that emits.
    pub triangles: Vec<[u32; 3]>,
}

/// A checked mesh in world units: corners are finite and in the precision in which rays meet them, triangles have areas and
/// are all different.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    uvs: Vec<[f32; 2]>,
    triangles: Vec<[u32; 3]>,
    repairs: Repairs,
}

/// What was left out of a mesh, or replaced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Repairs {
    /// Triangles without an area that f32 can tell from zero.
    pub degenerate: usize,
    /// Triangles with the corners of one before them, in whatever order.
    pub duplicate: usize,
    /// Corners of triangles whose normal is no direction, or points away from the triangle's outer side: there the
    /// triangle's own normal stands in.
    pub normals: usize,
    /// Whether all normals were turned around first, since most pointed away from the outer side.
    pub turned: bool,
    /// Texture coordinates that are no numbers, or beyond ±1e6, and became 0.
    pub uvs: usize,
}

impl Mesh {
    /// Checks and repairs. `Err` says what is wrong and the remedy.
    pub(super) fn new(data: &MeshData) -> Result<Mesh, String> {
        Mesh::with_area(data)?.ok_or_else(|| match data.triangles.len() {
            1 => "has no area: its triangle is a point or a line; scale it up".to_owned(),
            given => format!("has no area: its {given} triangles are points or lines; scale it up"),
        })
    }

    /// The same, but `None` if there are triangles and none of them has an area.
    pub(super) fn with_area(data: &MeshData) -> Result<Option<Mesh>, String> {
        let positions = positions(&data.positions)?;
        let normals = normals(&data.normals, positions.len())?;
        match data.triangles.len() {
            0 => return Err("has no triangles; give it faces of three corners or more".to_owned()),
            given if given > MOST_TRIANGLES => {
                return Err(format!("has {given} triangles; stay within {MOST_TRIANGLES}"));
            }
            _ => {}
        }
        let mut repairs = Repairs::default();
        let uvs = uvs(&data.uvs, positions.len(), &mut repairs)?;
        let mut mesh = Mesh { positions, normals, uvs, triangles: Vec::new(), repairs };
        mesh.take_in(&data.triangles)?;
        mesh.turn_normals();
        Ok((!mesh.is_empty()).then_some(mesh))
    }

    /// How many triangles it has.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Never true: a mesh has a triangle at least.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// The corners of each triangle.
    pub fn triangles(&self) -> impl ExactSizeIterator<Item = [Vec3; 3]> + '_ {
        self.triangles.iter().map(|triangle| self.corners(triangle))
    }

    /// The normals at the corners of each triangle, for smooth shading, all on its outer side; nothing if there were none.
    pub fn normals(&self) -> impl Iterator<Item = [Vec3; 3]> + '_ {
        let given = self.is_smooth().then_some(&self.triangles);
        given.into_iter().flatten().map(|triangle| {
            let own = self.face_normal(triangle);
            triangle
                .map(|corner| Some(self.normals[corner as usize]).filter(|n| n.dot(own) > 0.0).unwrap_or(own))
        })
    }

    /// The texture coordinates of the corners of each triangle; nothing if there were none.
    pub fn uvs(&self) -> impl Iterator<Item = [[f32; 2]; 3]> + '_ {
        let given = self.has_uvs().then_some(&self.triangles);
        given.into_iter().flatten().map(|triangle| triangle.map(|corner| self.uvs[corner as usize]))
    }

    /// Whether it has normals.
    pub fn is_smooth(&self) -> bool {
        !self.normals.is_empty()
    }

    /// Whether it has texture coordinates.
    pub fn has_uvs(&self) -> bool {
        !self.uvs.is_empty()
    }

    /// The box around all triangles: its least and its greatest corner.
    pub fn bounds(&self) -> [Vec3; 2] {
        let corners = || self.triangles().flatten();
        [corners().fold(Vec3::INFINITY, Vec3::min), corners().fold(Vec3::NEG_INFINITY, Vec3::max)]
    }

    /// What was left out.
    pub fn repairs(&self) -> Repairs {
        self.repairs
    }

    fn face_normal(&self, triangle: &[u32; 3]) -> Vec3 {
        let [a, b, c] = self.corners(triangle);
        double_area(a, b, c).normalize()
    }

    /// Turns all normals around if most point inwards, and counts those that are of no use.
    fn turn_normals(&mut self) {
        if !self.is_smooth() {
            return;
        }
        let [mut outwards, mut inwards] = [0, 0];
        for triangle in &self.triangles {
            let own = self.face_normal(triangle);
            let sides = triangle.map(|corner| self.normals[corner as usize].dot(own));
            outwards += sides.iter().filter(|&&side| side > 0.0).count();
            inwards += sides.iter().filter(|&&side| side < 0.0).count();
        }
        self.repairs.turned = inwards > outwards;
        if self.repairs.turned {
            self.normals.iter_mut().for_each(|normal| *normal = -*normal);
        }
        self.repairs.normals = 3 * self.triangles.len() - outwards.max(inwards);
    }

    fn corners(&self, triangle: &[u32; 3]) -> [Vec3; 3] {
        triangle.map(|corner| self.positions[corner as usize])
    }

    /// Adds the triangles that can be met, and counts the others.
    fn take_in(&mut self, triangles: &[[u32; 3]]) -> Result<(), String> {
        let count = self.positions.len();
        // Twice as many as a closed surface has. Many more are mostly repetitions, which cost bytes in files that are few.
        let usual = triangles.len().min(4 * count);
        let mut seen = HashSet::with_capacity(usual);
        self.triangles.reserve(usual);
        for (number, triangle) in triangles.iter().enumerate() {
            if let Some(corner) = triangle.iter().find(|&&corner| corner as usize >= count) {
                return Err(format!(
                    "has a triangle (number {number}, from 0) with corner {corner} of {count}; it is damaged, write it anew"
                ));
            }
            let corners = self.corners(triangle);
            if !has_area(corners) {
                self.repairs.degenerate += 1;
            } else if !seen.insert(unordered(corners)) {
                self.repairs.duplicate += 1;
            } else {
                self.triangles.push(*triangle);
            }
        }
        Ok(())
    }
}

fn positions(given: &[DVec3]) -> Result<Vec<Vec3>, String> {
    let check = |(number, position): (usize, &DVec3)| {
        let problem = match position.abs().max_element() {
            _ if position.is_nan() => "that is not a number (nan); remove it",
            largest if largest <= LARGEST => return Ok(position.as_vec3()),
            f64::INFINITY => "that is infinite; write finite numbers",
            _ => "beyond ±1e9; scale it down",
        };
        Err(format!("has a corner (number {number}, from 0) {problem}"))
    };
    given.iter().enumerate().map(check).collect()
}

/// One for each corner, or none; what is no direction becomes zero, which says that there is none.
fn normals(given: &[DVec3], corners: usize) -> Result<Vec<Vec3>, String> {
    if !given.is_empty() && given.len() != corners {
        return Err(format!("has {} normals for {corners} corners; give one for each, or none", given.len()));
    }
    Ok(given.iter().map(|normal| normal.normalize_or_zero().as_vec3()).collect())
}

/// One pair for each corner, or none; what is of no use becomes 0 and is counted.
fn uvs(given: &[[f32; 2]], corners: usize, repairs: &mut Repairs) -> Result<Vec<[f32; 2]>, String> {
    if !given.is_empty() && given.len() != corners {
        return Err(format!(
            "has {} texture coordinates for {corners} corners; give one for each, or none",
            given.len()
        ));
    }
    // NaN is not within either.
    let fits = |uv: &[f32; 2]| uv.iter().all(|value| value.abs() <= FARTHEST_UV);
    repairs.uvs = given.iter().filter(|uv| !fits(uv)).count();
    Ok(given.iter().map(|uv| if fits(uv) { *uv } else { [0.0; 2] }).collect())
}

/// Whether f32 can tell which way the triangle faces.
fn has_area([a, b, c]: [Vec3; 3]) -> bool {
    double_area(a, b, c).length_squared() > SMALLEST_SQUARE
}

/// The same for triangles with the same corners.
fn unordered(corners: [Vec3; 3]) -> [[u32; 3]; 3] {
    // Adding zero makes of -0 the other 0.
    let mut bits = corners.map(|corner| (corner + 0.0).to_array().map(f32::to_bits));
    bits.sort_unstable();
    bits
}
