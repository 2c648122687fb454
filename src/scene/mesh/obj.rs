//! OBJ files by `tobj`, which is met in this file only. Their materials are not read: the scene gives one.

use std::io::{BufRead, ErrorKind};

use glam::DVec3;
use tobj::{LoadError, LoadOptions};

use super::MeshData;

/// All objects of the file as one mesh. `Err` says what is wrong and the remedy.
pub(super) fn read(mut source: impl BufRead) -> Result<MeshData, String> {
    // Names of objects may be in any encoding, so what is no UTF-8 is read as if it were.
    let mut bytes = Vec::new();
    source.read_to_end(&mut bytes).map_err(|error| format!("can't be read: {error}"))?;
    let text = String::from_utf8_lossy(&bytes);
    // A byte order mark would make the first line one that is skipped.
    let text = plain_lines(text.trim_start_matches('\u{feff}'))?;
    // A corner for each normal and each texture coordinate that a position is used with.
    let options =
        LoadOptions { single_index: true, triangulate: true, ignore_points: true, ignore_lines: true };
    let no_materials = |_: &std::path::Path| Err(LoadError::OpenFileFailed);
    let (models, _) = tobj::load_obj_buf(&mut text.as_bytes(), &options, no_materials).map_err(problem)?;
    let mut data = MeshData::default();
    for model in models {
        add(&mut data, &model.mesh)?;
    }
    Ok(data)
}

/// Objects that are kept apart; those behind are one with the last.
const MOST_OBJECTS: usize = 1 << 16;

/// What makes corners and faces, without comments behind it and with lines that go on in the next joined to it, which tobj does
/// not take. The rest would only take memory, and names of materials that are not there make tobj refuse a file.
fn plain_lines(text: &str) -> Result<String, String> {
    let mut plain = String::with_capacity(text.len() + 1);
    let mut met = Met::default();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let begin = plain.len();
        let mut rest = line;
        while let Some(head) = rest.strip_suffix('\\') {
            plain.extend([head, " "]);
            rest = lines.next().unwrap_or_default();
        }
        plain.push_str(rest);
        let end = plain[begin..].find('#').map_or(plain.len(), |length| begin + length);
        plain.truncate(end);
        if met.takes(&plain[begin..])? {
            plain.push('\n');
        } else {
            plain.truncate(begin);
        }
    }
    Ok(plain)
}

/// What there was in the lines before.
#[derive(Default)]
struct Met {
    objects: usize,
    /// Positions, texture coordinates, normals.
    listed: [i64; 3],
}

impl Met {
    /// Whether a line says anything about triangles. `Err` says what is wrong and the remedy.
    fn takes(&mut self, line: &str) -> Result<bool, String> {
        let mut words = line.split_whitespace();
        match words.next().unwrap_or_default() {
            "v" => self.listed[0] += 1,
            "vt" => self.listed[1] += 1,
            "vn" => self.listed[2] += 1,
            "f" if !words.clone().all(|corner| self.may_have(corner)) => {
                return Err(NO_SUCH_CORNER.to_owned());
            }
            // Fewer corners make points and lines.
            "f" => return Ok(words.nth(2).is_some()),
            "o" | "g" => {
                self.objects += 1;
                return Ok(self.objects <= MOST_OBJECTS);
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// Whether the numbers of a corner, counted from the first or backwards from the last, are such that tobj can calculate
    /// with them. What is no number it finds itself.
    fn may_have(&self, corner: &str) -> bool {
        corner.split('/').zip(self.listed).all(|(number, listed)| match number.parse::<i128>() {
            Ok(number) => (-i128::from(listed)..=u32::MAX.into()).contains(&number),
            Err(_) => number.len() < 20,
        })
    }
}

const NO_SUCH_CORNER: &str = "has a face with a corner that it does not have; write it anew";

/// Adds one object. Where some objects have normals and others do not, those others get none that is a direction; texture
/// coordinates likewise, and the mesh warns of both. An object that has them at some corners only is taken to have none.
fn add(data: &mut MeshData, mesh: &tobj::Mesh) -> Result<(), String> {
    let vectors = |values: &[f32]| -> Vec<DVec3> {
        values
            .as_chunks()
            .0
            .iter()
            .map(|&[x, y, z]: &[f32; 3]| DVec3::new(x.into(), y.into(), z.into()))
            .collect()
    };
    let first =
        u32::try_from(data.positions.len()).map_err(|_| "has too many corners; split it".to_owned())?;
    data.positions.extend(vectors(&mesh.positions));
    let (before, corners) = (first as usize, data.positions.len());
    if mesh.normals.len() == mesh.positions.len() {
        data.normals.resize(before, DVec3::ZERO);
        data.normals.extend(vectors(&mesh.normals));
    } else if !data.normals.is_empty() {
        data.normals.resize(corners, DVec3::ZERO);
    }
    if mesh.texcoords.len() / 2 == mesh.positions.len() / 3 {
        data.uvs.resize(before, [f32::NAN; 2]);
        // Upwards from the lower edge of the image.
        data.uvs.extend(mesh.texcoords.as_chunks().0.iter().map(|&[u, v]: &[f32; 2]| [u, 1.0 - v]));
    } else if !data.uvs.is_empty() {
        data.uvs.resize(corners, [f32::NAN; 2]);
    }
    // A number beyond 2³² names no corner, which the mesh says.
    let moved = |&[a, b, c]: &[u32; 3]| [a, b, c].map(|corner| corner.saturating_add(first));
    data.triangles.extend(mesh.indices.as_chunks().0.iter().map(moved));
    Ok(())
}

fn problem(error: LoadError) -> String {
    match error {
        LoadError::ReadError => format!("can't be read: {}", ErrorKind::UnexpectedEof),
        LoadError::FaceVertexOutOfBounds => NO_SUCH_CORNER.to_owned(),
        error => format!("is not a valid OBJ file ({error}); write it anew"),
    }
}
