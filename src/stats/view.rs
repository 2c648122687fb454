//! A borrowed image: what the statistics look at.

use super::StatsError;

/// Linear RGB, row 0 at the top, with the standard error of each value where known (`None`: the image is exact).
#[derive(Debug, Clone, Copy)]
pub struct ImageView<'a> {
    pub width: usize,
    pub height: usize,
    pub rgb: &'a [[f32; 3]],
    pub standard_error: Option<&'a [[f32; 3]]>,
}

impl ImageView<'_> {
    pub fn pixel_count(&self) -> usize {
        self.rgb.len()
    }

    /// Standard error of one value; 0 for an exact image.
    pub(super) fn error_at(&self, pixel: usize, channel: usize) -> f64 {
        self.standard_error.map_or(0.0, |se| f64::from(se[pixel][channel]))
    }

    fn check_lengths(&self, what: &'static str) -> Result<(), StatsError> {
        let expected = self.width.saturating_mul(self.height);
        let wrong = |item, got| Err(StatsError::WrongLength { what, item, got, expected });
        match self.standard_error {
            _ if expected == 0 => Err(StatsError::EmptyImage),
            _ if self.rgb.len() != expected => wrong("colours", self.rgb.len()),
            Some(se) if se.len() != expected => wrong("standard errors", se.len()),
            _ => Ok(()),
        }
    }
}

/// Both images are whole and of one size. Every public function over two images asks this first.
pub(super) fn check_pair(a: &ImageView, b: &ImageView) -> Result<(), StatsError> {
    a.check_lengths("first")?;
    b.check_lengths("second")?;
    if (a.width, a.height) != (b.width, b.height) {
        return Err(StatsError::SizeMismatch(a.width, a.height, b.width, b.height));
    }
    Ok(())
}
