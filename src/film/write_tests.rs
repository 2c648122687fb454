//! What is promised about image files as they are written.

use std::io::Cursor;

use super::super::read_image;
use super::super::test_files::{bits, full_image};
use super::*;

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

fn write(path: &Path, image: &Image) -> Result<(), ImageError> {
    write_image(path, image, &WriteOptions::default())
}

#[test]
fn exr_round_trip_keeps_every_layer_bit_for_bit() {
    let dir = folder();
    for (width, height) in [(1, 1), (37, 19), (64, 33)] {
        let path = dir.path().join("image.exr");
        let image = full_image(width, height);
        write(&path, &image).unwrap();
        let back = read_image(&path).unwrap();
        assert_eq!(bits(&back.rgb), bits(&image.rgb));
        assert_eq!(back, image);
        let keys: Vec<_> = back.metadata.iter().map(|(key, _)| key.to_string()).collect();
        assert_eq!(keys, ["scene", "seed", "author", "empty", "compression"]);
    }
}

#[test]
fn equal_images_are_equal_bytes() {
    let dir = folder();
    let image = full_image(37, 100);
    for extension in ["exr", "png"] {
        let [a, b] = ["a", "b"].map(|name| {
            let path = dir.path().join(name).with_extension(extension);
            write(&path, &image).unwrap();
            fs::read(path).unwrap()
        });
        assert!(a == b, "{extension}");
    }
}

#[test]
fn exr_without_layers_reads_back_without_layers() {
    let dir = folder();
    let path = dir.path().join("plain.EXR");
    let image = Image::new(2, 1, vec![[f32::NAN, 1.0, 2.0], [3.0, 4.0, 5.0]]);
    write(&path, &image).unwrap();
    let back = read_image(&path).unwrap();
    assert_eq!(bits(&back.rgb), bits(&image.rgb));
    assert!(back.standard_error.is_none() && back.samples.is_none() && back.features.is_none());
    assert!(back.metadata.is_empty());
}

#[test]
fn png_round_trip_is_within_half_a_step_and_keeps_text() {
    let dir = folder();
    let path = dir.path().join("image.png");
    let mut image = Image::new(256, 1, (0..256).map(|i| [i as f32 / 255.0, 2.0, -1.0]).collect());
    image.metadata.set("seed", 7);
    image.metadata.set("author", "日本");
    write(&path, &image).unwrap();
    let back = read_image(&path).unwrap();
    for (a, b) in image.rgb.iter().zip(&back.rgb) {
        let step = |v: f32| (super::super::linear_to_srgb(v.clamp(0.0, 1.0)) * 255.0, 0.501);
        assert!((0..3).all(|c| (step(a[c]).0 - step(b[c]).0).abs() < step(a[c]).1));
    }
    let reader = png::Decoder::new(Cursor::new(fs::read(&path).unwrap())).read_info().unwrap();
    assert_eq!(reader.info().uncompressed_latin1_text[0].text, "7");
    assert_eq!(reader.info().utf8_text[0].get_text().unwrap(), "日本");
    assert!(reader.info().srgb.is_some());
}

#[test]
fn one_stop_of_exposure_doubles_the_light() {
    let dir = folder();
    let (a, b) = (dir.path().join("a.png"), dir.path().join("b.png"));
    write(&a, &Image::new(1, 1, vec![[0.5, 0.25, 0.125]])).unwrap();
    write_image(&b, &Image::new(1, 1, vec![[0.25, 0.125, 0.0625]]), &WriteOptions { exposure: 1.0 }).unwrap();
    assert_eq!(read_image(&a).unwrap().rgb, read_image(&b).unwrap().rgb);
}

#[test]
fn a_finished_write_leaves_only_the_image() {
    let dir = folder();
    let path = dir.path().join("image.exr");
    write(&path, &full_image(8, 8)).unwrap();
    write(&path, &full_image(9, 8)).unwrap();
    assert_eq!(names(dir.path()), ["image.exr"]);
    assert_eq!(read_image(&path).unwrap().width, 9);
}

#[test]
fn a_failed_write_keeps_the_older_image_and_leaves_nothing_behind() {
    let dir = folder();
    let path = dir.path().join("image.exr");
    write(&path, &full_image(8, 8)).unwrap();
    let before = fs::read(&path).unwrap();
    let mut broken = full_image(8, 8);
    broken.samples = Some(vec![1.0; 3]);
    let error = write(&path, &broken).unwrap_err().to_string();
    assert!(error.contains("\"samples\" does not match its 8x8 pixels"), "{error}");
    drop(Draft::new(&path).unwrap());
    assert_eq!(fs::read(&path).unwrap(), before);
    assert_eq!(names(dir.path()), ["image.exr"]);
    assert!(write(&path, &Image::default()).is_err());
}

/// A disk with room for so many bytes.
struct SmallDisk(Cursor<Vec<u8>>, usize);

impl Write for SmallDisk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.0.position() as usize + bytes.len() > self.1 {
            return Err(io::Error::from(io::ErrorKind::StorageFull));
        }
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for SmallDisk {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}

#[test]
fn a_full_disk_is_an_error_wherever_it_strikes() {
    for format in [Format::Exr, Format::Png] {
        for room in [0, 3, 50, 400, 1000, 4000] {
            let mut disk = SmallDisk(Cursor::new(Vec::new()), room);
            let error = encode(&mut disk, format, &full_image(60, 60), &WriteOptions::default()).unwrap_err();
            let message = error.at(Path::new("x.exr")).to_string();
            assert!(message.contains("free some space or choose another place"), "{message}");
        }
    }
}

#[test]
fn a_missing_folder_is_named_with_its_remedy() {
    let error = check_writable(Path::new("no/such/folder/y.exr")).unwrap_err().to_string();
    assert_eq!(
        error,
        "cannot write \"no/such/folder/y.exr\": folder \"no/such/folder\" does not exist; create it or choose another place"
    );
}

#[test]
fn check_writable_knows_bad_targets_and_leaves_nothing_behind() {
    let dir = folder();
    let at = |name: &str| dir.path().join(name);
    fs::create_dir(at("folder.exr")).unwrap();
    fs::write(at("file"), "").unwrap();
    let message = |name: &str| check_writable(&at(name)).unwrap_err().to_string();
    assert!(message("folder.exr").contains("is a folder"));
    assert!(message("image.tiff").contains("cannot write .tiff images; name the image .exr"));
    assert!(message("image").contains("has no extension"));
    assert!(message("file/image.png").contains("not a folder"));
    for good in ["image.exr", "image.PNG"] {
        check_writable(&at(good)).unwrap();
    }
    let mut left = names(dir.path());
    left.sort();
    assert_eq!(left, ["file", "folder.exr"]);
}

#[cfg(unix)]
#[test]
fn a_link_is_followed_and_stays_a_link() {
    let dir = folder();
    let (real, link) = (dir.path().join("real.exr"), dir.path().join("link.exr"));
    write(&real, &full_image(4, 4)).unwrap();
    std::os::unix::fs::symlink(&real, &link).unwrap();
    write(&link, &full_image(5, 4)).unwrap();
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(read_image(&real).unwrap().width, 5);
}
