//! Scenes from files and text.

use std::path::Path;

use super::document::Node;
use super::error::{Fault, quoted};
use super::files::FileKind;
use super::{Scene, SceneError, description, model};

const SCENES: FileKind = FileKind {
    most_bytes: 64 << 20,
    wanted: "a .toml or .json file",
    smaller: "split the scene or describe less",
};

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
    if path.is_dir() {
        return Err("is a directory; name a scene file in it".to_owned());
    }
    SCENES.length(path)?;
    format(path)?;
    let bytes = SCENES.bytes(path, u64::MAX)?;
    String::from_utf8(bytes).map_err(|error| {
        format!("is not UTF-8 text (byte {}); save it as plain text", error.utf8_error().valid_up_to())
    })
}
