//! Images and numbers for the tests of this folder.

use super::{Features, GuideLayers, Image};
pub use crate::stats::test_images::Rng;

fn triples(rng: &mut Rng, count: usize) -> Vec<[f32; 3]> {
    (0..count).map(|_| [0; 3].map(|_| rng.uniform_f32() * 10.0 - 1.0)).collect()
}

/// All layers, and values that are easily lost: infinities, denormals, −0.
pub fn full_image(width: u32, height: u32) -> Image {
    let mut rng = Rng::new(u64::from(width));
    let count = width as usize * height as usize;
    let mut image = Image::new(width, height, triples(&mut rng, count));
    let odd = [[f32::MAX, f32::MIN_POSITIVE, 1e-42], [f32::INFINITY, f32::NEG_INFINITY, -0.0]];
    odd.iter().zip(&mut image.rgb).for_each(|(odd, rgb)| *rgb = *odd);
    image.standard_error = Some(triples(&mut rng, count));
    image.samples = Some((0..count).map(|i| i as f32).collect());
    let depth = (0..count).map(|_| rng.uniform_f32()).collect();
    image.features =
        Some(Features { albedo: triples(&mut rng, count), normal: triples(&mut rng, count), depth });
    let ones = |rng: &mut Rng| (0..count).map(|_| rng.uniform_f32()).collect();
    image.guide = Some(GuideLayers {
        illumination: ones(&mut rng),
        direction: triples(&mut rng, count),
        cell: (0..count).map(|i| i as f32 - 1.0).collect(),
        entropy: ones(&mut rng),
    });
    image.metadata.set("scene", "scenes/cornell.toml");
    image.metadata.set("seed", 42);
    image.metadata.set("author", "Ærøskøbing ✓ 日本");
    image.metadata.set("empty", "");
    image.metadata.set("compression", "this name is EXR's own, too");
    image
}

/// Bits, so that −0 and NaN count.
pub fn bits(values: &[[f32; 3]]) -> Vec<[u32; 3]> {
    values.iter().map(|v| v.map(f32::to_bits)).collect()
}
