//! Images and numbers for the tests of this folder.

use super::{Features, Image};

/// splitmix64 (Steele, Lea, Flood 2014).
pub struct Rng(u64);

impl Rng {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub fn uniform(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }

    pub fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    fn triples(&mut self, count: usize) -> Vec<[f32; 3]> {
        (0..count).map(|_| [0; 3].map(|_| self.uniform() * 10.0 - 1.0)).collect()
    }
}

/// All layers, and values that are easily lost: infinities, denormals, −0.
pub fn full_image(width: u32, height: u32) -> Image {
    let mut rng = Rng::new(u64::from(width));
    let count = width as usize * height as usize;
    let mut image = Image::new(width, height, rng.triples(count));
    let odd = [[f32::MAX, f32::MIN_POSITIVE, 1e-42], [f32::INFINITY, f32::NEG_INFINITY, -0.0]];
    odd.iter().zip(&mut image.rgb).for_each(|(odd, rgb)| *rgb = *odd);
    image.standard_error = Some(rng.triples(count));
    image.samples = Some((0..count).map(|i| i as f32).collect());
    let depth = (0..count).map(|_| rng.uniform()).collect();
    image.features = Some(Features { albedo: rng.triples(count), normal: rng.triples(count), depth });
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
