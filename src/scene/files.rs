//! Files that scenes are made from: where they may lie, how long they may be, what their headers may promise.

use std::fs::File;
use std::io::{ErrorKind, Read, Take};
use std::path::{Path, PathBuf};

use crate::untrusted::memory_for;

/// Files of one sort, for messages and limits.
pub(super) struct FileKind {
    /// Larger ones are refused unread.
    pub most_bytes: u64,
    /// What to name instead of a folder or a pipe, such as `a .png or .jpg file`.
    pub wanted: &'static str,
    /// What to do about one that is too large, such as `reduce the image`.
    pub smaller: &'static str,
}

impl FileKind {
    /// How many bytes a file has that may be read. `Err` says what is wrong and the remedy, as everywhere here.
    pub fn length(&self, path: &Path) -> Result<u64, String> {
        let found = std::fs::metadata(path).map_err(|error| io_problem(&error))?;
        if !found.is_file() {
            return Err(format!("is not a regular file; name {}", self.wanted));
        }
        if found.len() > self.most_bytes {
            return Err(format!("is larger than {} MiB; {}", self.most_bytes >> 20, self.smaller));
        }
        Ok(found.len())
    }

    /// The first `most` bytes of a file, opened, and how many there are.
    pub fn open(&self, path: &Path, most: u64) -> Result<(Take<File>, u64), String> {
        let length = self.length(path)?.min(most);
        let file = File::open(path).map_err(|error| io_problem(&error))?;
        Ok((file.take(length), length))
    }

    /// The first `most` bytes of a file.
    pub fn bytes(&self, path: &Path, most: u64) -> Result<Vec<u8>, String> {
        let (mut file, length) = self.open(path, most)?;
        let mut bytes = Vec::with_capacity(length as usize);
        file.read_to_end(&mut bytes).map_err(|error| io_problem(&error))?;
        Ok(bytes)
    }
}

pub(super) fn io_problem(error: &std::io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => "no such file; check the path".to_owned(),
        ErrorKind::PermissionDenied => "can't be read: permission denied; check its mode".to_owned(),
        _ => format!("can't be read: {error}"),
    }
}

/// The file that a scene in this folder calls so; links and `..` are followed, and must stay within.
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

/// Refuses images whose header promises more than so many bytes of file can hold, before anything is allocated.
pub(super) fn plausible_image(
    file_bytes: usize,
    width: u32,
    height: u32,
    texel_bytes: u64,
) -> Result<(), String> {
    match u64::from(width) * u64::from(height) * texel_bytes <= memory_for(file_bytes) {
        true => Ok(()),
        false => Err(format!(
            "is {width} x {height}, more than its {file_bytes} bytes can hold; it is cut short or damaged, write it anew"
        )),
    }
}
