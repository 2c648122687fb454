//! What a z-test found, and on what its verdict rests.

/// The worst of a family of z statistics, against the threshold that the whole family keeps with probability 1 − level.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Extreme {
    /// How many statistics the family has.
    pub tests: usize,
    /// The largest |z|; infinite where values that claim to be exact differ, or where one is NaN.
    pub max_abs_z: f64,
    /// Two-sided and Šidák-corrected.
    pub threshold: f64,
    /// Upper left pixel (x, y) of the worst place, and its channel.
    pub x: usize,
    pub y: usize,
    pub channel: usize,
}

impl Extreme {
    /// NaN does not pass.
    pub fn passes(&self) -> bool {
        self.max_abs_z <= self.threshold
    }
}

/// Single pixels.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct PixelReport {
    #[serde(flatten)]
    pub extreme: Extreme,
    /// Share of pixel channels with |z| > 3; 0.0027 where errors are normal.
    pub share_above_3: f64,
}

/// Are the block differences as large, over all, as their errors say?
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Dispersion {
    /// Mean of z² over blocks and channels: 1 if all is well, more if images or errors are wrong.
    pub mean_square_z: f64,
    /// Chance of as much or more, from χ² with as many degrees of freedom as blocks
    /// (channels of one pixel share their samples, so only blocks are counted as independent).
    pub p_value: f64,
    /// The p-value below which it would fail.
    pub level: f64,
}

impl Dispersion {
    pub fn passes(&self) -> bool {
        self.p_value >= self.level
    }
}

/// Outcome of [`z_test`](super::z_test).
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct ZReport {
    /// Chance that a right image fails: the promise of the decisive families together.
    pub alpha: f64,
    /// Means of square blocks, per channel. Always decisive.
    pub blocks: Extreme,
    /// Means of the whole image, per channel. Always decisive.
    pub means: Extreme,
    /// Decisive by option only.
    pub pixels: PixelReport,
    /// Decisive by option only.
    pub dispersion: Dispersion,
    pub pixels_decisive: bool,
    pub dispersion_decisive: bool,
    /// The verdict: every decisive family passes.
    pub passes: bool,
}
