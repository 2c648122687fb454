//! Primitives: corners, and how they make triangles.

use std::collections::HashMap;

use ::gltf::json::Root;
use ::gltf::json::accessor::ComponentType;
use ::gltf::json::mesh::{Mode, Primitive, Semantic};
use ::gltf::json::validation::Checked;
use glam::DVec3;

use super::accessor::Rows;
use super::buffers::Buffers;
use crate::scene::MeshData;

/// A primitive that was checked, and not read yet.
pub(super) struct Faces<'a> {
    mode: Mode,
    positions: Rows<'a>,
    normals: Option<Rows<'a>>,
    uvs: Option<Rows<'a>>,
    indices: Option<Rows<'a>>,
}

/// `Err` says what is wrong and the remedy; nothing for points and lines.
pub(super) fn open<'a>(
    root: &Root,
    buffers: &'a Buffers<'_>,
    primitive: &Primitive,
) -> Result<Option<Faces<'a>>, String> {
    let Checked::Valid(mode) = primitive.mode else {
        return Err("has an unknown mode; write it anew".to_owned());
    };
    if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
        return Ok(None);
    }
    let attribute = |semantic: Semantic| -> Result<Option<Rows<'a>>, String> {
        let index = primitive.attributes.get(&Checked::Valid(semantic));
        index.map(|&index| Rows::open(root, buffers, index)).transpose()
    };
    let positions = attribute(Semantic::Positions)?.ok_or("has no POSITION; write it anew")?;
    let normals = attribute(Semantic::Normals)?;
    let uvs = attribute(Semantic::TexCoords(0))?;
    let indices = primitive.indices.map(|index| Rows::open(root, buffers, index)).transpose()?;
    for (what, rows, width) in [
        ("POSITION", Some(&positions), 3),
        ("NORMAL", normals.as_ref(), 3),
        ("TEXCOORD_0", uvs.as_ref(), 2),
        ("indices", indices.as_ref(), 1),
    ] {
        if let Some(rows) = rows.filter(|rows| rows.width != width) {
            return Err(format!("has {what} of {} numbers each, not {width}; write it anew", rows.width));
        }
    }
    if indices.is_some_and(|rows| {
        !matches!(rows.component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32)
    }) {
        return Err("has indices that are no whole numbers from 0 on; write it anew".to_owned());
    }
    let too_few = |rows: &Option<Rows<'_>>| rows.is_some_and(|rows| rows.count < positions.count);
    if too_few(&normals) || too_few(&uvs) {
        return Err("has fewer NORMALs or TEXCOORDs than POSITIONs; write it anew".to_owned());
    }
    Ok(Some(Faces { mode, positions, normals, uvs, indices }))
}

impl Faces<'_> {
    /// How many triangles there are.
    pub fn len(&self) -> usize {
        let corners = self.corners();
        match self.mode {
            Mode::Triangles => corners / 3,
            _ => corners.saturating_sub(2),
        }
    }

    /// Corners left over behind the last triangle of a list.
    pub fn left_over(&self) -> usize {
        if self.mode == Mode::Triangles { self.corners() % 3 } else { 0 }
    }

    fn corners(&self) -> usize {
        self.indices.as_ref().unwrap_or(&self.positions).count
    }

    /// The places in the order of corners of triangle `i` (glTF 2.0, 3.7.2.1).
    fn places(&self, i: usize) -> [usize; 3] {
        match self.mode {
            Mode::TriangleStrip => [i, i + 1 + i % 2, i + 2 - i % 2],
            Mode::TriangleFan => [i + 1, i + 2, 0],
            _ => [3 * i, 3 * i + 1, 3 * i + 2],
        }
    }

    /// Reads the triangles and those corners that they use. Triangles with a corner twice, which tie strips together, are
    /// dropped.
    pub fn read(&self) -> Result<MeshData, String> {
        let mut corners = Corners::new(self.positions.count, self.corners());
        let mut triangles = Vec::new();
        for i in 0..self.len() {
            let [a, b, c] = self.triangle(i)?;
            let ties = self.mode != Mode::Triangles && (a == b || b == c || c == a);
            if !ties {
                triangles.push([a, b, c].map(|corner| corners.number(corner)));
            }
        }
        let used = &corners.used;
        let positions = vectors(&self.positions, used);
        if let Some(number) = positions.iter().position(|position| !position.is_finite()) {
            return Err(format!(
                "has a corner (number {}, from 0) that is infinite or not a number (nan); remove it",
                used[number]
            ));
        }
        let normals = self.normals.as_ref().map(|rows| vectors(rows, used)).unwrap_or_default();
        let uv = |rows: &Rows<'_>, row: u32| rows.row(row as usize).map(|x| x as f32);
        let uvs = self.uvs.as_ref().map(|rows| used.iter().map(|&row| uv(rows, row)).collect());
        Ok(MeshData { positions, normals, uvs: uvs.unwrap_or_default(), triangles })
    }

    /// The corners of triangle `i`, by their numbers in the accessor.
    fn triangle(&self, i: usize) -> Result<[usize; 3], String> {
        let corner = |place| self.indices.as_ref().map_or(place, |indices| indices.index(place));
        let triangle = self.places(i).map(corner);
        match triangle.iter().find(|&&corner| corner >= self.positions.count) {
            None => Ok(triangle),
            Some(corner) => Err(format!(
                "has a triangle (number {i}, from 0) with corner {corner} of {}; it is damaged, write it anew",
                self.positions.count
            )),
        }
    }
}

fn vectors(rows: &Rows<'_>, used: &[u32]) -> Vec<DVec3> {
    used.iter().map(|&row| DVec3::from_array(rows.row(row as usize))).collect()
}

/// New numbers for those corners that are used: several primitives may share one long list.
struct Corners {
    used: Vec<u32>,
    numbers: Numbers,
}

enum Numbers {
    /// For each corner of the list, or [`UNUSED`].
    Dense(Vec<u32>),
    Sparse(HashMap<u32, u32>),
}

const UNUSED: u32 = u32::MAX;

impl Corners {
    /// For a list of that length, of which so many are met.
    fn new(listed: usize, met: usize) -> Self {
        let numbers = match listed <= met.saturating_mul(8) {
            true => Numbers::Dense(vec![UNUSED; listed]),
            false => Numbers::Sparse(HashMap::new()),
        };
        Corners { used: Vec::new(), numbers }
    }

    fn number(&mut self, corner: usize) -> u32 {
        let next = self.used.len() as u32;
        let number = match &mut self.numbers {
            Numbers::Dense(numbers) => &mut numbers[corner],
            Numbers::Sparse(numbers) => numbers.entry(corner as u32).or_insert(UNUSED),
        };
        if *number == UNUSED {
            *number = next;
            self.used.push(corner as u32);
        }
        *number
    }
}
