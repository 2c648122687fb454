//! Maps: what files give, what is repaired, what is refused; packed radiance; and that no bytes make a reader panic.

use std::fs;
use std::path::Path;

use exr::prelude::{WritableImage, write_rgb_file};
use glam::Vec3;
use image::codecs::hdr::HdrEncoder;
use image::{ExtendedColorType, ImageEncoder};
use proptest::prelude::*;

use super::cells::{CHANNEL_BITS, pack_radiance, unpack_radiance};
use super::file::decode;
use super::{EnvironmentMap, Sky};
use crate::scene::{Scene, SceneWarning};

/// 4 × 2 texels, exact in both formats.
fn texels() -> Vec<[f32; 3]> {
    (0..8).map(|i| [0.5 * i as f32, 2.0, 8.0 - i as f32]).collect()
}

fn radiance_file(width: u32, height: u32, texels: &[[f32; 3]]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let values: Vec<u8> = texels.iter().flatten().flat_map(|v| v.to_ne_bytes()).collect();
    let encoder = HdrEncoder::new(&mut bytes);
    encoder.write_image(&values, width, height, ExtendedColorType::Rgb32F).unwrap();
    bytes
}

fn exr_file(width: usize, height: usize, texel: impl Fn(usize) -> [f32; 3] + Sync) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.exr");
    write_rgb_file(&path, width, height, |x, y| texel(y * width + x).into()).unwrap();
    fs::read(path).unwrap()
}

#[test]
fn both_formats_give_their_texels() {
    let given = texels();
    for bytes in [radiance_file(4, 2, &given), exr_file(4, 2, |i| given[i])] {
        let map = decode(&bytes).unwrap();
        assert_eq!((map.width(), map.height(), map.texels(), map.negative()), (4, 2, &given[..], 0));
    }
    // Others begin so.
    let bytes = radiance_file(4, 2, &given);
    let other = [b"#?RGBE", bytes.strip_prefix(b"#?RADIANCE").unwrap()].concat();
    assert_eq!(decode(&other).unwrap().texels(), given);
}

#[test]
fn negative_texels_become_black_and_are_told() {
    let bytes = exr_file(4, 2, |i| if i == 3 { [-1.0, 2.0, -0.5] } else { [1.0; 3] });
    let map = decode(&bytes).unwrap();
    assert_eq!((map.texels()[3], map.negative()), ([0.0, 2.0, 0.0], 1));
    let scene = Scene::builder("sky").camera([0.0, 0.0, 1.0], [0.0; 3], 40.0).environment_map(map).build();
    assert_eq!(scene.unwrap().warnings(), [SceneWarning::NegativeRadiance { texels: 1 }]);
}

/// What is wrong, and words that the message must have.
#[test]
fn bad_maps_are_refused_with_the_remedy() {
    let says = |bytes: &[u8], words: &[&str]| {
        let message = decode(bytes).unwrap_err();
        assert!(words.iter().all(|word| message.contains(word)), "{message} has not all of {words:?}");
    };
    says(&exr_file(4, 2, |i| [if i == 6 { f32::NAN } else { 1.0 }; 3]), &["column 2, row 1", "finite"]);
    says(
        &exr_file(4, 2, |i| [if i == 0 { f32::INFINITY } else { 1.0 }; 3]),
        &["column 0, row 0", "infinite"],
    );
    let mut png = Vec::new();
    image::codecs::png::PngEncoder::new(&mut png)
        .write_image(&[1, 2, 3], 1, 1, ExtendedColorType::Rgb8)
        .unwrap();
    says(&png, &["low dynamic range", ".hdr or .exr"]);
    says(b"what is this?", &["neither", "convert"]);
    says(b"", &["neither"]);
    let whole = radiance_file(4, 2, &texels());
    says(&whole[..whole.len() - 3], &["damaged"]);
    // Sizes that lie: nothing of that size is made.
    says(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2000000000 +X 2000000000\n", &["too large"]);
    says(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8192 +X 16384\n", &["16384 × 8192", "4096 × 2048"]);
    says(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2048 +X 4096\n", &["more than its", "bytes can hold"]);
    says(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 0 +X 4\n", &["no texels"]);
    // A luminance without colour.
    let grey = exr::prelude::Image::from_channels(
        (2, 2),
        exr::prelude::SpecificChannels::build().with_channel("Y").with_pixel_fn(|_| (1.0f32,)),
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("grey.exr");
    grey.write().to_file(&path).unwrap();
    says(&fs::read(path).unwrap(), &["R, G and B"]);
    assert!(EnvironmentMap::new(2, 2, vec![[1.0; 3]; 3]).unwrap_err().to_string().contains("give 4"));
    assert!(EnvironmentMap::new(0, 2, vec![]).unwrap_err().to_string().contains("no texels"));
}

/// What a scene file says of its environment, in a folder with a map.
fn scene_with(folder: &Path, environment: &str) -> Result<Scene, String> {
    let camera = "[camera]\norigin = [0, 0, 1]\ntarget = [0, 0, 0]\nfov_y_deg = 40\nwidth = 8\nheight = 8\n";
    let path = folder.join("scene.toml");
    fs::write(&path, format!("name = \"sky\"\n{camera}[environment]\n{environment}\n")).unwrap();
    Scene::load(path).map_err(|error| error.to_string())
}

#[test]
fn scene_files_name_their_maps() {
    let folder = tempfile::tempdir().unwrap();
    let (inner, map) = (folder.path().join("inner"), radiance_file(4, 2, &texels()));
    fs::create_dir(&inner).unwrap();
    fs::write(inner.join("sky.hdr"), &map).unwrap();
    fs::write(folder.path().join("outside.hdr"), &map).unwrap();
    fs::write(inner.join("empty.hdr"), []).unwrap();
    let scene =
        scene_with(&inner, "map = \"sky.hdr\"\nscale = 2\nradiance = [1, 0.5, 0]\nrotate_y_deg = -30")
            .unwrap();
    assert_eq!(scene.environment.to_array(), [2.0, 1.0, 0.0]);
    assert_eq!(scene.environment_map.as_ref().unwrap().rotate_y_deg(), -30.0);
    assert_eq!(scene_with(&inner, "map = \"sky.hdr\"").unwrap().environment.to_array(), [1.0; 3]);
    let says = |environment: &str, words: &[&str]| {
        let message = scene_with(&inner, environment).unwrap_err();
        let all = ["scene.toml:", "environment"].iter().chain(words).all(|word| message.contains(word));
        assert!(all, "{environment}: {message} has not all of {words:?}");
    };
    says("map = \"../outside.hdr\"", &["outside the scene's folder", ":9:"]);
    says("map = \"missing.hdr\"", &["no such file", "missing.hdr"]);
    says("map = \"empty.hdr\"", &["neither"]);
    says("map = \".\"", &["regular file"]);
    says("map = 3", &["a text in quotes"]);
    says("radiance = [1, 1, 1]\nscale = 2", &["scale needs a map"]);
    says("rotate_y_deg = 2", &["rotate_y_deg needs a map"]);
    says("map = \"sky.hdr\"\nscale = -1", &["scale", "negative"]);
    says("map = \"sky.hdr\"\nscale = 1e15", &["too bright"]);
    says("map = \"sky.hdr\"\nrotate_y_deg = nan", &["rotate_y_deg", "not a number"]);
    says("mapp = \"sky.hdr\"", &["did you mean \"map\"?"]);
    assert!(
        Scene::from_toml("name = \"a\"\n[environment]\nmap = \"sky.hdr\"")
            .unwrap_err()
            .to_string()
            .contains("no folder")
    );
}

/// Packing rounds to 2⁻¹⁸ of the largest channel, half a unit each way; whole halves lose nothing.
#[test]
fn packed_radiance_is_what_it_was() {
    let bound = 0.5 / f64::from(1u32 << (CHANNEL_BITS - 1)) * 1.0001;
    let check = |v: [f32; 3]| {
        let packed = unpack_radiance(pack_radiance(v));
        let largest = f64::from(v.into_iter().fold(0f32, f32::max));
        let error = (packed.as_dvec3() - Vec3::from(v).as_dvec3()).abs().max_element();
        assert!(error <= bound * largest || largest < 1e-32, "{v:?} became {packed}");
    };
    let ones = f32::from_bits(0x3fff_ffff);
    for scale in [1e-33f32, 1e-10, 1.0, ones, 65504.0, 1e15] {
        for [a, b] in [[0.0, 0.0], [1.0, 0.5], [0.999_999, 1.0], [1e-7, 0.3]] {
            check([scale, a * scale, b * scale]);
            check([b * scale, scale, a * scale]);
        }
    }
    assert_eq!(unpack_radiance(pack_radiance([0.0; 3])), Vec3::ZERO);
    assert_eq!(
        unpack_radiance(pack_radiance([1.0, 0.5, 131071.0 / 131072.0])),
        Vec3::new(1.0, 0.5, 131071.0 / 131072.0)
    );
}

/// A large map of noise: 16 bytes a texel and for one more row, with tables that draw each column.
#[test]
fn maps_take_sixteen_bytes_a_texel() {
    let map = EnvironmentMap::new(64, 32, (0..64 * 32).map(|i| [(i % 7) as f32; 3]).collect()).unwrap();
    let sky = Sky::new(&map, glam::DVec3::ONE).unwrap();
    assert_eq!(sky.bytes(), 16 * (64 * 33 + 33));
    let black = EnvironmentMap::new(4, 2, vec![[0.0; 3]; 8]).unwrap();
    assert!(Sky::new(&black, glam::DVec3::ONE).is_none() && Sky::new(&map, glam::DVec3::ZERO).is_none());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..Default::default() })]

    /// Files with a few bytes changed or cut: a map or an error.
    #[test]
    fn damaged_files_are_errors_or_maps(
        exr in any::<bool>(),
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        kept in any::<prop::sample::Index>(),
    ) {
        let mut bytes = if exr { exr_file(4, 2, |i| texels()[i]) } else { radiance_file(4, 2, &texels()) };
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if kept.index(3) == 0 {
            bytes.truncate(kept.index(bytes.len()));
        }
        // Whatever it says, it says it without a panic, and a map is what it says that it is.
        if let Ok(map) = decode(&bytes) {
            prop_assert_eq!(map.texels().len(), map.width() as usize * map.height() as usize);
            prop_assert!(map.texels().iter().flatten().all(|v| *v >= 0.0 && v.is_finite()));
        }
    }
}
