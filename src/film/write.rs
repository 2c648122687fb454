//! Writing images so that an interrupted or failed write never destroys an older one.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use super::{Image, ImageError, exr_file, png_file};

/// How to write; formats ignore what does not concern them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct WriteOptions {
    /// PNG only: colours are multiplied by 2^exposure before they are clamped. EXR keeps radiance as it is.
    pub exposure: f32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Exr,
    Png,
}

fn format_of(path: &Path) -> Result<Format, ImageError> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let unknown = |found| Err(ImageError::UnknownExtension { path: path.into(), found });
    match extension.as_str() {
        "exr" => Ok(Format::Exr),
        "png" => Ok(Format::Png),
        "" => unknown("its name has no extension".to_string()),
        other => unknown(format!("cannot write .{other} images")),
    }
}

/// Writes an image in the format its extension names. The target is replaced only by a complete file.
pub fn write_image(path: &Path, image: &Image, options: &WriteOptions) -> Result<(), ImageError> {
    let format = format_of(path)?;
    if let Some(list) = image.malformed() {
        let reason =
            format!("image list \"{list}\" does not match its {}x{} pixels", image.width, image.height);
        return Err(ImageError::Encode { path: path.into(), reason });
    }
    let mut draft = Draft::new(path)?;
    let encoded = encode(&mut draft.writer, format, image, options);
    encoded.map_err(|error| error.at(path))?;
    draft.publish().map_err(|source| ImageError::Write { path: path.into(), source })
}

fn encode(
    out: &mut (impl Write + Seek),
    format: Format,
    image: &Image,
    options: &WriteOptions,
) -> Result<(), EncodeError> {
    match format {
        Format::Exr => exr_file::encode(out, image),
        Format::Png => png_file::encode(out, image, options.exposure),
    }
}

/// Whether [`write_image`] can work, to be asked before hours of rendering: the extension is known, the target is no
/// folder, its folder exists and takes files. Leaves nothing behind.
pub fn check_writable(path: &Path) -> Result<(), ImageError> {
    format_of(path)?;
    Draft::new(path).map(drop)
}

/// What encoders report; [`write_image`] adds the name of the file.
#[derive(Debug)]
pub(super) enum EncodeError {
    Io(io::Error),
    Format(String),
}

impl EncodeError {
    fn at(self, path: &Path) -> ImageError {
        match self {
            EncodeError::Io(source) => ImageError::Write { path: path.into(), source },
            EncodeError::Format(reason) => ImageError::Encode { path: path.into(), reason },
        }
    }
}

/// A temporary file beside the target. Dropped, it is gone; published, it is the target.
pub(crate) struct Draft {
    target: PathBuf,
    draft: PathBuf,
    pub(crate) writer: BufWriter<File>,
}

impl Draft {
    pub(crate) fn new(path: &Path) -> Result<Draft, ImageError> {
        let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
        if target.is_dir() {
            return Err(ImageError::TargetIsFolder { path: path.into() });
        }
        let folder = match target.parent() {
            Some(folder) if folder != Path::new("") => folder,
            _ => Path::new("."),
        };
        let (path, at) = (path.to_path_buf(), folder.to_path_buf());
        if !folder.exists() {
            return Err(ImageError::MissingFolder { path, folder: at });
        }
        if !folder.is_dir() {
            return Err(ImageError::NotAFolder { path, folder: at });
        }
        let (draft, file) = create_beside(folder).map_err(|source| ImageError::Write { path, source })?;
        Ok(Draft { target, draft, writer: BufWriter::new(file) })
    }

    /// Everything on disk, then the name: after a crash the target is the old image or the new one.
    pub(crate) fn publish(mut self) -> io::Result<()> {
        self.writer.flush()?;
        self.writer.get_ref().sync_all()?;
        fs::rename(&self.draft, &self.target)
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        // After `publish` there is nothing by this name, which is the point.
        let _ = fs::remove_file(&self.draft);
    }
}

/// A new file with a name that nobody else has. Short, so that it fits wherever the target's name does.
fn create_beside(folder: &Path) -> io::Result<(PathBuf, File)> {
    static COUNTER: AtomicU32 = AtomicU32::new(0);
    loop {
        let number = COUNTER.fetch_add(1, Ordering::Relaxed);
        let path = folder.join(format!(".qtracer-{}-{number}.tmp", std::process::id()));
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
            result => return result.map(|file| (path, file)),
        }
    }
}

#[cfg(test)]
#[path = "write_tests.rs"]
mod tests;
