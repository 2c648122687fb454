//! What a render leaves behind: sums per pixel ([`Film`]), the finished [`Image`] with its errors, and image files.

mod accumulate;
mod combined;
mod countable;
mod error;
mod exr_file;
mod false_colour;
mod image;
mod metadata;
mod png_file;
mod read;
mod srgb;
#[cfg(test)]
mod test_files;
mod write;

pub use accumulate::{BlockSum, Film, FilmError, PixelSum, luminance};
pub use combined::{CombinedFilm, rough_luminances};
pub use countable::{BRIGHTEST, is_countable};
pub use error::ImageError;
pub use false_colour::false_colour;
pub use image::{Features, GuideLayers, Image};
pub use metadata::Metadata;
pub use read::{MAX_PIXELS, read_image};
pub use srgb::{linear_to_srgb, srgb_to_linear};
pub(crate) use write::Draft;
pub use write::{WriteOptions, check_writable, write_image};
