//! From the bytes of a .glb or .gltf file to its JSON, read and checked by the `gltf` crate, and the binary chunk.
//!
//! The crate is met through its JSON structures alone: its readers of accessors add without looking, and a first index out of
//! range makes its validation panic. What it could panic on, or allocate without bound, is refused here first.

use ::gltf::json::validation::{Error, Validate};
use ::gltf::json::{Path as JsonPath, Root};

use super::extensions;
use crate::scene::error::quoted;
use crate::scene::model::findings::Findings;

/// Objects that a file may describe, of up to about a kilobyte each.
const MOST_OBJECTS: usize = 1 << 20;
/// Values in all: a number takes two bytes in a file and up to 32 in memory.
const MOST_VALUES: usize = 1 << 23;

/// A checked description and the binary chunk, if there is one.
pub(super) fn read<'a>(bytes: &'a [u8], findings: &mut Findings) -> Result<(Root, Option<&'a [u8]>), String> {
    let (json, chunk) = match bytes.starts_with(b"glTF") {
        true => chunks(bytes)?,
        false => (bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes), None),
    };
    bounded(json)?;
    let root = Root::from_slice(json).map_err(|error| format!("is not a glTF file: {error}"))?;
    if !root.asset.version.starts_with("2.") {
        return Err(format!("is of glTF {}; write it as glTF 2.0", quoted(&root.asset.version)));
    }
    extensions::check(&root, findings)?;
    valid(&root)?;
    Ok((root, chunk))
}

/// JSON and binary of a .glb file.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    const HEADER: usize = 12;
    let word = |at: usize| -> Option<u32> {
        bytes.get(at..at + 4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
    };
    let cut_short = || "is cut short; copy it again".to_owned();
    let (Some(version), Some(length)) = (word(4), word(8)) else { return Err(cut_short()) };
    if version != 2 {
        return Err(format!("is of version {version} of the .glb format; write it as glTF 2.0"));
    }
    if (length as usize) < HEADER || length as usize > bytes.len() {
        return Err(format!(
            "promises {length} bytes in its header and has {}; it is cut short or damaged, write it anew",
            bytes.len()
        ));
    }
    let (mut json, mut binary) = (None, None);
    let mut at = HEADER;
    // Further chunks, and those of other kinds, are for extensions.
    while at < length as usize {
        let size = word(at).ok_or_else(cut_short)? as usize;
        let body = bytes.get(at + 8..at + 8 + size).ok_or_else(cut_short)?;
        match &bytes[at + 4..at + 8] {
            b"JSON" => json = json.or(Some(body)),
            b"BIN\0" => binary = binary.or(Some(body)),
            _ => (),
        }
        at += 8 + size;
    }
    Ok((json.ok_or("has no JSON chunk; write it anew")?, binary))
}

/// Refuses descriptions that would take memory out of proportion.
fn bounded(json: &[u8]) -> Result<(), String> {
    let (mut objects, mut values, mut text, mut escaped) = (0, 0, false, false);
    for &byte in json {
        match byte {
            _ if escaped => escaped = false,
            b'\\' => escaped = text,
            b'"' => text = !text,
            b'{' if !text => objects += 1,
            b',' | b'[' | b':' if !text => values += 1,
            _ => (),
        }
    }
    for (count, most, what) in [(objects, MOST_OBJECTS, "objects"), (values, MOST_VALUES, "values")] {
        if count > most {
            return Err(format!("describes {count} {what}; stay within {most}, split it"));
        }
    }
    Ok(())
}

/// The crate's checks, and those that it needs itself.
fn valid(root: &Root) -> Result<(), String> {
    let primitives = || root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let accessors = || primitives().flat_map(|primitive| primitive.attributes.values());
    if let Some(index) = accessors().find(|index| index.value() >= root.accessors.len()) {
        return Err(format!(
            "has an attribute with accessor {index} of {}; write it anew",
            root.accessors.len()
        ));
    }
    let mut first = None;
    root.validate(root, JsonPath::new, &mut |path, error| {
        if first.is_none() && !is_harmless(path().as_str(), error) {
            first = Some((path(), error));
        }
    });
    match first {
        None => Ok(()),
        Some((path, error)) => {
            let what = match error {
                Error::IndexOutOfBounds => "names something that is not there",
                Error::Missing => "is missing",
                _ => "has a value that is not allowed",
            };
            Err(format!("is not valid glTF 2.0: {} {what}; write it anew", quoted(path.as_str())))
        }
    }
}

/// What the rest of this module does not need: bounds of positions, extensions that were checked before, images of textures.
fn is_harmless(path: &str, error: Error) -> bool {
    let bounds = path.ends_with("[\"POSITION\"].min") || path.ends_with("[\"POSITION\"].max");
    let image = path.starts_with("textures[") && path.ends_with("].source");
    bounds || image || error == Error::Unsupported || path.starts_with("animations[")
}
