//! What can go wrong with image files. Every message names the file and a way out.

use std::io;
use std::path::PathBuf;

/// Why an image could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    #[error("cannot write \"{path}\": {found}; name the image .exr (linear, with all layers) or .png (8 bits)", path = path.display())]
    UnknownExtension { path: PathBuf, found: String },
    #[error("cannot write \"{}\": folder \"{}\" does not exist; create it or choose another place", path.display(), folder.display())]
    MissingFolder { path: PathBuf, folder: PathBuf },
    #[error("cannot write \"{}\": \"{}\" is not a folder; choose another place", path.display(), folder.display())]
    NotAFolder { path: PathBuf, folder: PathBuf },
    #[error("cannot write \"{}\": it is a folder; name a file in it", path.display())]
    TargetIsFolder { path: PathBuf },
    #[error("cannot write \"{}\": {source}; {remedy}", path.display(), remedy = write_remedy(source))]
    Write { path: PathBuf, source: io::Error },
    #[error("cannot write \"{}\": {reason}", path.display())]
    Encode { path: PathBuf, reason: String },
    #[error("cannot read \"{}\": {source}; {remedy}", path.display(), remedy = read_remedy(source))]
    Read { path: PathBuf, source: io::Error },
    #[error("cannot read \"{}\": {reason}; give an undamaged .exr, .png, .jpg or .hdr image", path.display())]
    NotAnImage { path: PathBuf, reason: String },
    #[error("cannot read \"{}\": {width}x{height} pixels is too large ({reason}); give a smaller image", path.display())]
    TooLarge { path: PathBuf, width: usize, height: usize, reason: &'static str },
    #[error("cannot read \"{}\": it has no R, G, B channels but {found}; export it as RGB", path.display())]
    NoColour { path: PathBuf, found: String },
}

fn write_remedy(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free some space or choose another place"
        }
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "make the folder writable or choose another place"
        }
        _ => "choose another place",
    }
}

fn read_remedy(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::NotFound => "check the name",
        io::ErrorKind::PermissionDenied => "make it readable",
        _ => "check that it is a readable file",
    }
}
