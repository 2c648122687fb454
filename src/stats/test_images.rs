//! Random numbers for unit tests, and synthetic images with known errors for those of this folder.

use super::ImageView;

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
    pub fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 * (0.5f64).powi(53)
    }

    /// In [0, 1), a multiple of 2⁻²⁴.
    pub fn uniform_f32(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }

    pub fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    /// Standard normal (Box & Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// An owned image with errors.
#[derive(Clone)]
pub struct TestImage {
    pub width: usize,
    pub height: usize,
    pub rgb: Vec<[f32; 3]>,
    pub standard_error: Vec<[f32; 3]>,
}

impl TestImage {
    pub fn constant(width: usize, height: usize, colour: [f32; 3]) -> Self {
        let pixels = width * height;
        Self { width, height, rgb: vec![colour; pixels], standard_error: vec![[0.0; 3]; pixels] }
    }

    /// A smooth image with normal noise of 2 to 8 % that its standard errors state rightly.
    pub fn noisy(seed: u64, width: usize, height: usize) -> Self {
        let mut rng = Rng::new(seed);
        let mut image = Self::constant(width, height, [0.0; 3]);
        for pixel in 0..width * height {
            for channel in 0..3 {
                let truth = 0.5 + 0.4 * (pixel as f64 * 0.03 + channel as f64).sin();
                let sigma = truth * (0.05 + 0.03 * (pixel as f64 * 0.7).cos());
                image.rgb[pixel][channel] = (truth + sigma * rng.normal()) as f32;
                image.standard_error[pixel][channel] = sigma as f32;
            }
        }
        image
    }

    pub fn scaled(mut self, factor: f32) -> Self {
        self.rgb.iter_mut().flatten().for_each(|value| *value *= factor);
        self
    }

    pub fn view(&self) -> ImageView<'_> {
        ImageView { standard_error: Some(&self.standard_error), ..self.exact() }
    }

    pub fn exact(&self) -> ImageView<'_> {
        ImageView { width: self.width, height: self.height, rgb: &self.rgb, standard_error: None }
    }
}
