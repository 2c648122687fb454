//! Scenes from files and text.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use super::document::Node;
use super::error::{Fault, quoted};
use super::{Scene, SceneError, description, model};

/// Larger files are refused unread.
const LARGEST_FILE: u64 = 64 << 20;

#[derive(Clone, Copy)]
enum Format {
    Toml,
    Json,
}

impl Scene {
    /// Reads and validates a `.toml` or `.json` scene file, or a model that is to be a scene of its own: glTF 2.0 (`.gltf`,
    /// `.glb`), `.ply` or `.obj`.
    ///
    /// A model is seen by the first of its cameras, 640 pixels wide or high, 64 samples per pixel. Without a camera it is seen
    /// whole, from above right; without a light it stands under an even white sky of radiance 0.5. Whatever was chosen,
    /// repaired or left out, [`file_warnings`](Self::file_warnings) says.
    ///
    /// # Errors
    /// Files that are missing, not regular, above 64 MiB (2 GiB for models), not UTF-8 or of another extension; malformed
    /// text; mesh files outside the scene's folder or with anything wrong; models that need extensions of glTF which are not
    /// read, or files outside their own folder; and everything that [`validate`](Self::validate) refuses. Each error names the
    /// file.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SceneError> {
        Self::load_seen_by(path.as_ref(), None)
    }

    /// The same, seen by that one of a model's cameras. They have the names of their nodes, else their own, else `camera 0`,
    /// `camera 1`, … in the order of the file.
    ///
    /// # Errors
    /// As [`load`](Self::load), and where there is no such camera; a scene file's camera has no name.
    pub fn load_with_camera(path: impl AsRef<Path>, camera: &str) -> Result<Self, SceneError> {
        Self::load_seen_by(path.as_ref(), Some(camera))
    }

    fn load_seen_by(path: &Path, camera: Option<&str>) -> Result<Self, SceneError> {
        if model::is_model(path) {
            return model::load_whole(path, camera);
        }
        let refuse = |problem| SceneError::File { path: path.to_owned(), problem };
        let text = read(path).map_err(refuse)?;
        if camera.is_some() {
            return Err(refuse("has one camera, which has no name; leave the name out".to_owned()));
        }
        let tree = match format(path).map_err(refuse)? {
            Format::Toml => not_empty(&text).and_then(Node::from_toml),
            Format::Json => not_empty(&text).and_then(Node::from_json),
        };
        let scene = tree.and_then(|tree| description::scene(&tree, path.parent()));
        scene.map_err(|error| error.in_file(path))
    }

    /// Reads and validates TOML text. It has no folder in which to look for meshes.
    ///
    /// # Errors
    /// Malformed text, and everything that [`validate`](Self::validate) refuses.
    pub fn from_toml(text: &str) -> Result<Self, SceneError> {
        description::scene(&Node::from_toml(not_empty(text)?)?, None)
    }

    /// Reads and validates JSON text, with the keys of the TOML form.
    ///
    /// # Errors
    /// As [`from_toml`](Self::from_toml).
    pub fn from_json(text: &str) -> Result<Self, SceneError> {
        description::scene(&Node::from_json(not_empty(text)?)?, None)
    }

    /// Reads and validates a glTF 2.0 model that lies in memory, `.glb` or `.gltf` by its first bytes, as [`load`](Self::load)
    /// does a file. It has no folder in which to look for buffers and images, so `data:` URIs and the chunk of a `.glb` are all.
    ///
    /// # Errors
    /// Those of [`load`](Self::load) for models.
    pub fn from_gltf(name: impl Into<String>, bytes: &[u8]) -> Result<Self, SceneError> {
        model::gltf_in_memory(name.into(), bytes)
    }
}

/// The text without a byte-order mark.
fn not_empty(text: &str) -> Result<&str, SceneError> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    if text.trim().is_empty() {
        return Err(
            Fault::from("is empty; give it a name and a [camera] at least".to_owned()).of("scene", None)
        );
    }
    Ok(text)
}

fn format(path: &Path) -> Result<Format, String> {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    match extension.to_ascii_lowercase().as_str() {
        "toml" => Ok(Format::Toml),
        "json" => Ok(Format::Json),
        "" => Err("has no extension; scene files end in .toml or .json, models in .glb, .gltf, .ply or .obj"
            .to_owned()),
        other => Err(format!(
            "has the extension {}; scene files end in .toml or .json, models in .glb, .gltf, .ply or .obj",
            quoted(other)
        )),
    }
}

fn read(path: &Path) -> Result<String, String> {
    let kind = std::fs::metadata(path).map_err(|error| io_problem(&error))?;
    if kind.is_dir() {
        return Err("is a directory; name a scene file in it".to_owned());
    }
    if !kind.is_file() {
        return Err("is not a regular file; copy the scene into one".to_owned());
    }
    format(path)?;
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|error| io_problem(&error))?;
    file.take(LARGEST_FILE + 1).read_to_end(&mut bytes).map_err(|error| io_problem(&error))?;
    if bytes.len() as u64 > LARGEST_FILE {
        return Err(format!("is larger than {} MiB; split the scene or describe less", LARGEST_FILE >> 20));
    }
    String::from_utf8(bytes).map_err(|error| {
        format!("is not UTF-8 text (byte {}); save it as plain text", error.utf8_error().valid_up_to())
    })
}

pub(super) fn io_problem(error: &std::io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => "no such file; check the path".to_owned(),
        ErrorKind::PermissionDenied => "can't be read: permission denied; check its mode".to_owned(),
        _ => format!("can't be read: {error}"),
    }
}

/// Refuses images whose header promises more than so many bytes of file can hold, before anything is allocated. No compression
/// of real images exceeds the share (deflate reaches 1032); small ones are always allowed.
pub(super) fn plausible_image(
    file_bytes: usize,
    width: u32,
    height: u32,
    texel_bytes: u64,
) -> Result<(), String> {
    const MOST_EXPANSION: u64 = 1 << 12;
    const ALWAYS: u64 = 1 << 24;
    let needed = u64::from(width) * u64::from(height) * texel_bytes;
    match needed <= ALWAYS + (file_bytes as u64).saturating_mul(MOST_EXPANSION) {
        true => Ok(()),
        false => Err(format!(
            "is {width} x {height}, more than its {file_bytes} bytes can hold; it is cut short or damaged, write it anew"
        )),
    }
}

/// The file that a scene in this folder calls so; links and `..` are followed, and must stay within. `Err` says what is wrong.
pub(super) fn within_folder(folder: Option<&Path>, name: &str) -> Result<PathBuf, String> {
    let folder =
        folder.ok_or("is looked for beside the scene, which has no folder; load the scene from a file")?;
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
