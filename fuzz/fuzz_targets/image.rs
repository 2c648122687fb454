//! Images that `compare` and `merge` read: .exr with all layers, .png, .jpg, .hdr.
#![no_main]

use libfuzzer_sys::fuzz_target;
use qtracer::Image;
use qtracer::stats::{Comparison, ComparisonOptions};

/// Pixels of images that are compared.
const MOST_COMPARED: usize = 1 << 14;

fuzz_target!(init: qtracer_fuzz::prepare(), |bytes: &[u8]| {
    let image = match Image::from_bytes(bytes) {
        Ok(image) => image,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    assert_eq!(image.rgb.len(), image.pixel_count());
    if image.pixel_count() > MOST_COMPARED {
        return;
    }
    if let Err(error) = Comparison::new(&image.view(), &image.view(), &ComparisonOptions::default()) {
        assert!(!error.to_string().is_empty());
    }
});
