//! Files from anywhere.

use std::io::Cursor;
use std::path::PathBuf;

use exr::prelude::{AnyChannel, AnyChannels, FlatSamples, WritableImage, f16};

use super::super::test_files::{Rng, full_image};
use super::super::{WriteOptions, write_image};
use super::*;

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }

    fn ours(&self, name: &str) -> Vec<u8> {
        let path = self.0.path().join(name);
        write_image(&path, &full_image(20, 18), &WriteOptions::default()).unwrap();
        fs::read(path).unwrap()
    }
}

/// An EXR as other programs write it: half floats, alpha, layers as channel names.
fn foreign_exr(names: &[&str]) -> Vec<u8> {
    let channel = |(i, name): (usize, &&str)| {
        AnyChannel::new(*name, FlatSamples::F16(vec![f16::from_f32(i as f32 + 0.5); 6]))
    };
    let channels = AnyChannels::sort(names.iter().enumerate().map(channel).collect());
    let mut bytes = Cursor::new(Vec::new());
    exr::prelude::Image::from_channels((3, 2), channels).write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

#[test]
fn foreign_exr_files_read_by_channel_name() {
    let folder = Folder::new();
    let plain = read_image(&folder.file("a.exr", &foreign_exr(&["R", "G", "B", "A"]))).unwrap();
    assert_eq!((plain.width, plain.height, plain.rgb[5]), (3, 2, [0.5, 1.5, 2.5]));
    let layered =
        read_image(&folder.file("b.exr", &foreign_exr(&["x.Z", "beauty.R", "beauty.G", "beauty.B"])))
            .unwrap();
    assert_eq!(layered.rgb[0], [1.5, 2.5, 3.5]);
    let error = read_image(&folder.file("c.exr", &foreign_exr(&["Y", "Z"]))).unwrap_err().to_string();
    assert!(error.contains("no R, G, B channels but Y Z"), "{error}");
}

#[test]
fn hdr_files_are_linear_and_the_content_decides_the_format() {
    let folder = Folder::new();
    let mut hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n".to_vec();
    hdr.extend([128, 64, 32, 130, 128, 128, 128, 128]);
    let image = read_image(&folder.file("misnamed.png", &hdr)).unwrap();
    assert_eq!((image.width, image.rgb[0]), (2, [2.0, 1.0, 0.5]));
}

#[test]
fn garbage_is_an_error_that_names_the_file() {
    let folder = Folder::new();
    let mut rng = Rng::new(1);
    let noise: Vec<u8> = (0..5000).map(|_| rng.next() as u8).collect();
    let mut false_exr = EXR_MAGIC.to_vec();
    false_exr.extend(&noise);
    let png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    for (name, bytes) in
        [("empty.exr", vec![]), ("noise.png", noise), ("false.exr", false_exr), ("short.png", png)]
    {
        let error = read_image(&folder.file(name, &bytes)).unwrap_err().to_string();
        assert!(error.starts_with("cannot read ") && error.contains(name), "{error}");
    }
    let missing = read_image(&folder.0.path().join("none.exr")).unwrap_err().to_string();
    assert!(missing.contains("check the name"), "{missing}");
    let not_a_file = read_image(folder.0.path()).unwrap_err().to_string();
    assert!(not_a_file.contains("no regular file"), "{not_a_file}");
}

#[test]
fn every_truncation_is_an_error() {
    let folder = Folder::new();
    for name in ["whole.exr", "whole.png"] {
        let bytes = folder.ours(name);
        for end in (0..bytes.len() - 12).step_by(97) {
            assert!(
                read_image(&folder.file(&format!("cut-{name}"), &bytes[..end])).is_err(),
                "{name} cut at {end}"
            );
        }
    }
}

/// Damage may go unseen (EXR has no checksums) but never panics or takes all memory.
#[test]
fn flipped_bytes_are_survived() {
    let folder = Folder::new();
    let mut rng = Rng::new(2);
    for name in ["whole.exr", "whole.png"] {
        let bytes = folder.ours(name);
        for _ in 0..400 {
            let mut damaged = bytes.clone();
            for _ in 0..=rng.below(3) {
                let header_or_any = if rng.below(2) == 0 { 600 } else { bytes.len() as u64 };
                let at = rng.below(header_or_any.min(bytes.len() as u64)) as usize;
                damaged[at] = rng.next() as u8;
            }
            if let Ok(image) = read_image(&folder.file("damaged", &damaged)) {
                assert_eq!(image.malformed(), None);
            }
        }
    }
}

#[test]
fn absurd_sizes_are_refused_before_memory_is_taken() {
    let folder = Folder::new();
    let mut bytes = folder.ours("whole.exr");
    for window in ["dataWindow\0box2i\0", "displayWindow\0box2i\0"] {
        let at = bytes.windows(window.len()).position(|w| w == window.as_bytes()).unwrap() + window.len() + 4;
        bytes[at + 8..at + 12].copy_from_slice(&16_000i32.to_le_bytes());
        bytes[at + 12..at + 16].copy_from_slice(&16_000i32.to_le_bytes());
    }
    let error = read_image(&folder.file("huge.exr", &bytes)).unwrap_err().to_string();
    assert!(error.contains("16001x16001 pixels is too large (more than its bytes can hold)"), "{error}");

    let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n";
    let error = read_image(&folder.file("huge.hdr", hdr)).unwrap_err().to_string();
    assert!(error.contains("60000x60000 pixels is too large (the limit is 2^28)"), "{error}");
}
