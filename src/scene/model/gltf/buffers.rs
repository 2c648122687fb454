//! The bytes of buffers: the binary chunk, `data:` URIs, and files in the folder of the .gltf file or below.

use std::borrow::Cow;
use std::path::Path;

use ::gltf::json::Root;
use ::gltf::json::buffer::Buffer;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use percent_encoding::percent_decode_str;

use crate::scene::error::quoted;
use crate::scene::files::FileKind;
use crate::scene::files::within_folder;
use crate::scene::mesh::file::MESHES;

/// The buffers of a file, in their order.
pub(super) type Buffers<'a> = Vec<Cow<'a, [u8]>>;

/// Reads all buffers, which may be as long as a file together.
pub(super) fn read<'a>(
    root: &Root,
    chunk: Option<&'a [u8]>,
    folder: Option<&Path>,
) -> Result<Buffers<'a>, String> {
    let total: u128 = root.buffers.iter().map(|buffer| u128::from(buffer.byte_length.0)).sum();
    if total > u128::from(MESHES.most_bytes) {
        return Err(format!(
            "promises buffers of {total} bytes together; reduce the model to {} GiB or less",
            MESHES.most_bytes >> 30
        ));
    }
    let numbered = root.buffers.iter().enumerate();
    numbered
        .map(|(number, buffer)| {
            one(number, buffer, chunk, folder).map_err(|problem| format!("buffers[{number}] {problem}"))
        })
        .collect()
}

fn one<'a>(
    number: usize,
    buffer: &Buffer,
    chunk: Option<&'a [u8]>,
    folder: Option<&Path>,
) -> Result<Cow<'a, [u8]>, String> {
    let length = buffer.byte_length.0;
    let bytes = match (&buffer.uri, chunk) {
        (Some(uri), _) => Cow::Owned(from_uri(uri, &MESHES, length, folder)?),
        (None, Some(chunk)) if number == 0 => Cow::Borrowed(chunk),
        (None, _) => return Err("has neither a uri nor a binary chunk; write the model anew".to_owned()),
    };
    match bytes.len() as u64 >= length {
        true => Ok(bytes),
        false => Err(format!(
            "promises {length} bytes and has {}; it is cut short or damaged, write it anew",
            bytes.len()
        )),
    }
}

/// The bytes that a URI names: of them, a file gives the first `length`.
pub(super) fn from_uri(
    uri: &str,
    kind: &FileKind,
    length: u64,
    folder: Option<&Path>,
) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        return from_data(data);
    }
    let name = quoted(uri);
    let scheme = uri.split(['/', '\\', '?', '#']).next().is_some_and(|head| head.contains(':'));
    if scheme {
        return Err(format!(
            "is at {name}, and qtracer reads nothing from networks or by full names; put it beside the model and name it \
             relative to that"
        ));
    }
    let path = percent_decode_str(uri)
        .decode_utf8()
        .map_err(|_| format!("has the uri {name}, which is no UTF-8"))?;
    let path = within_folder(folder, &path).map_err(|problem| format!("file {name} {problem}"))?;
    kind.bytes(&path, length).map_err(|problem| format!("file {name} {problem}"))
}

/// `application/octet-stream;base64,AAAA`, or plain text with percent signs.
fn from_data(data: &str) -> Result<Vec<u8>, String> {
    let (kind, body) = data.split_once(',').ok_or("has a data: uri without a comma; write the model anew")?;
    match kind.ends_with(";base64") {
        true => STANDARD
            .decode(body)
            .map_err(|error| format!("has a data: uri that is not base64 ({error}); write the model anew")),
        false => Ok(percent_decode_str(body).collect()),
    }
}
