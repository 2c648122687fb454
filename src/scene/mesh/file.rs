//! Meshes from files: where a scene may take them from, and which reader reads them.

use std::io::{BufReader, Read};
use std::path::Path;

use super::{MeshData, obj, ply};
use crate::scene::SceneError;
use crate::scene::error::quoted;
use crate::scene::files::FileKind;

/// Of models too.
pub(in crate::scene) const MESHES: FileKind =
    FileKind { most_bytes: 2 << 30, wanted: "a .glb, .gltf, .ply or .obj file", smaller: "reduce the mesh" };

impl MeshData {
    /// Reads a `.ply` (text or binary, either byte order) or `.obj` file. Faces of more than three corners become fans.
    ///
    /// # Errors
    /// Files that are missing, not regular, above 2 GiB, of another extension, truncated or malformed. Whether what they
    /// hold makes a mesh is checked when a scene takes it in.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SceneError> {
        let path = path.as_ref();
        read(path).map_err(|problem| SceneError::File { path: path.to_owned(), problem })
    }

    /// Reads a mesh file that lies in memory.
    ///
    /// # Errors
    /// What is truncated or malformed; says what is wrong and the remedy.
    pub fn from_bytes(format: MeshFormat, bytes: &[u8]) -> Result<Self, String> {
        parse(format, bytes, bytes.len() as u64)
    }
}

/// What [`MeshData::load`] reads. `Err` says what is wrong and the remedy.
pub(in crate::scene) fn read(path: &Path) -> Result<MeshData, String> {
    let (file, length) = MESHES.open(path, u64::MAX)?;
    match path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase().as_str() {
        "ply" => parse(MeshFormat::Ply, file, length),
        "obj" => parse(MeshFormat::Obj, file, length),
        "" => Err("has no extension; mesh files end in .glb, .gltf, .ply or .obj".to_owned()),
        other => {
            Err(format!("has the extension {}; mesh files end in .glb, .gltf, .ply or .obj", quoted(other)))
        }
    }
}

/// Formats of files of one mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// Polygon files (`.ply`), text or binary in either byte order.
    Ply,
    /// Wavefront OBJ.
    Obj,
}

/// Reads a mesh of at most `length` bytes, which bounds what is allocated.
pub(super) fn parse(format: MeshFormat, source: impl Read, length: u64) -> Result<MeshData, String> {
    let source = BufReader::with_capacity(1 << 16, source.take(length));
    match format {
        MeshFormat::Ply => ply::read(source, length),
        MeshFormat::Obj => obj::read(source),
    }
}
