//! Meshes from files: where a scene may take them from, and which reader reads them.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use super::{MeshData, obj, ply};
use crate::scene::SceneError;
use crate::scene::error::quoted;
use crate::scene::load::io_problem;

/// Larger files are refused unread.
const LARGEST_FILE: u64 = 2 << 30;

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
}

/// Reads a mesh file that a scene names, which must lie within the scene's folder.
pub(in crate::scene) fn of_scene(name: &str, folder: Option<&Path>) -> Result<MeshData, String> {
    let file = format!("file {}", quoted(name));
    let Some(folder) = folder else {
        return Err(format!(
            "{file} is looked for beside the scene, which has no folder; load the scene from a file"
        ));
    };
    let path = within(folder, Path::new(name)).map_err(|problem| format!("{file} {problem}"))?;
    read(&path).map_err(|problem| format!("{file} {problem}"))
}

/// The file of that name, relative to the folder; links and `..` are followed, and must stay within.
pub(in crate::scene) fn within(folder: &Path, name: &Path) -> Result<PathBuf, String> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let folder = folder.canonicalize().map_err(|error| io_problem(&error))?;
    let path = folder.join(name).canonicalize().map_err(|error| io_problem(&error))?;
    match path.starts_with(&folder) {
        true => Ok(path),
        false => {
            Err("lies outside the scene's folder; copy it there and name it relative to the scene".to_owned())
        }
    }
}

fn read(path: &Path) -> Result<MeshData, String> {
    let kind = std::fs::metadata(path).map_err(|error| io_problem(&error))?;
    if !kind.is_file() {
        return Err("is not a regular file; name a .ply or .obj file".to_owned());
    }
    if kind.len() > LARGEST_FILE {
        return Err(format!("is larger than {} GiB; reduce the mesh", LARGEST_FILE >> 30));
    }
    let open = || File::open(path).map_err(|error| io_problem(&error));
    match path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase().as_str() {
        "ply" => parse(Format::Ply, open()?, kind.len()),
        "obj" => parse(Format::Obj, open()?, kind.len()),
        "" => Err("has no extension; mesh files end in .ply or .obj".to_owned()),
        other => Err(format!("has the extension {}; mesh files end in .ply or .obj", quoted(other))),
    }
}

#[derive(Clone, Copy)]
pub(super) enum Format {
    Ply,
    Obj,
}

/// Reads a mesh of at most `length` bytes, which bounds what is allocated.
pub(super) fn parse(format: Format, source: impl Read, length: u64) -> Result<MeshData, String> {
    let source = BufReader::with_capacity(1 << 16, source.take(length));
    match format {
        Format::Ply => ply::read(source, length),
        Format::Obj => obj::read(source),
    }
}
