//! Meshes from files: where a scene may take them from, and which reader reads them.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use super::{MeshData, obj, ply};
use crate::scene::SceneError;
use crate::scene::error::quoted;
use crate::scene::load::{io_problem, within_folder};

/// Larger files are refused unread.
pub(in crate::scene) const LARGEST_FILE: u64 = 2 << 30;

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

    /// The same, with what is wrong and the remedy alone.
    pub(in crate::scene) fn load_plain(path: &Path) -> Result<Self, String> {
        read(path)
    }
}

/// All of a file. `Err` says what is wrong and the remedy.
pub(in crate::scene) fn bytes(path: &Path) -> Result<Vec<u8>, String> {
    let length = length_of(path)?;
    let mut bytes = Vec::with_capacity(length as usize);
    let file = File::open(path).map_err(|error| io_problem(&error))?;
    file.take(length).read_to_end(&mut bytes).map_err(|error| io_problem(&error))?;
    Ok(bytes)
}

/// The file that a scene names, which must lie within the scene's folder.
pub(in crate::scene) fn of_scene(name: &str, folder: Option<&Path>) -> Result<PathBuf, String> {
    let file = format!("file {}", quoted(name));
    within_folder(folder, name).map_err(|problem| format!("{file} {problem}"))
}

/// How many bytes a file has that may be read.
pub(in crate::scene) fn length_of(path: &Path) -> Result<u64, String> {
    let kind = std::fs::metadata(path).map_err(|error| io_problem(&error))?;
    if !kind.is_file() {
        return Err("is not a regular file; name a .glb, .gltf, .ply or .obj file".to_owned());
    }
    if kind.len() > LARGEST_FILE {
        return Err(format!("is larger than {} GiB; reduce the mesh", LARGEST_FILE >> 30));
    }
    Ok(kind.len())
}

fn read(path: &Path) -> Result<MeshData, String> {
    let length = length_of(path)?;
    let open = || File::open(path).map_err(|error| io_problem(&error));
    match path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase().as_str() {
        "ply" => parse(MeshFormat::Ply, open()?, length),
        "obj" => parse(MeshFormat::Obj, open()?, length),
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
