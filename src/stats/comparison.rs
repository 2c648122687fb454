//! Everything there is to say about two images, as one value.

use std::fmt;

use super::StatsError;
use super::flip::{FLIP_PIXELS_PER_DEGREE, flip};
use super::metrics::{Differences, RelMse, differences, mean_ratio, mse, relative_mse};
use super::view::ImageView;
use super::z_report::{Extreme, ZReport};
use super::z_test::{ZTestOptions, z_test};

/// What to compare with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComparisonOptions {
    /// ε of the relative MSE.
    pub epsilon: f64,
    pub pixels_per_degree: f64,
    pub z_test: ZTestOptions,
}

impl Default for ComparisonOptions {
    fn default() -> Self {
        Self { epsilon: 0.01, pixels_per_degree: FLIP_PIXELS_PER_DEGREE, z_test: ZTestOptions::default() }
    }
}

/// An image against a reference. Infinite values become `null` in JSON.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Comparison {
    pub width: usize,
    pub height: usize,
    pub relative_mse: RelMse,
    pub mse: f64,
    /// Mean of the image over mean of the reference, per channel.
    pub mean_ratio: [f64; 3],
    pub differences: Differences,
    /// Mean LDR-FLIP.
    pub flip: f64,
    /// `None` where neither image says its standard errors, or they can't be used (see `z_test_problem`).
    pub z_test: Option<ZReport>,
    /// Why there is no z-test.
    pub z_test_problem: Option<String>,
}

impl Comparison {
    /// Compares two images of one size. A z-test that can't be made is no error: its reason is kept.
    pub fn new(
        image: &ImageView,
        reference: &ImageView,
        options: &ComparisonOptions,
    ) -> Result<Self, StatsError> {
        let relative_mse = relative_mse(image, reference, options.epsilon)?;
        let (z_test, z_test_problem) = match z_test(image, reference, &options.z_test) {
            Ok(report) => (Some(report), None),
            Err(problem @ (StatsError::BadAlpha(_) | StatsError::EmptyBlock)) => {
                return Err(problem);
            }
            Err(problem) => (None, Some(problem.to_string())),
        };
        Ok(Self {
            width: image.width,
            height: image.height,
            relative_mse,
            mse: mse(image, reference)?,
            mean_ratio: mean_ratio(image, reference)?,
            differences: differences(image, reference)?,
            flip: flip(image, reference, options.pixels_per_degree)?,
            z_test,
            z_test_problem,
        })
    }

    /// The z-test's verdict, if there was one.
    pub fn passes(&self) -> Option<bool> {
        self.z_test.as_ref().map(|report| report.passes)
    }
}

fn row(f: &mut fmt::Formatter, name: &str, value: impl fmt::Display) -> fmt::Result {
    writeln!(f, "{name:<24}{value}")
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let [r, g, b] = self.mean_ratio;
        row(f, "size", format_args!("{}x{}", self.width, self.height))?;
        row(f, "relative MSE", format_args!("{:.4e}", self.relative_mse.plain))?;
        row(f, "  worst 0.1 % left out", format_args!("{:.4e}", self.relative_mse.trimmed))?;
        row(f, "MSE", format_args!("{:.4e}", self.mse))?;
        row(f, "mean ratio R G B", format_args!("{r:.5} {g:.5} {b:.5}"))?;
        row(f, "largest difference", format_args!("{:.4e}", self.differences.max_absolute))?;
        row(f, "  relative", format_args!("{:.4e}", self.differences.max_relative))?;
        row(f, "pixels within 1e-3", format_args!("{:.2} %", 100.0 * self.differences.share_within_1e3))?;
        row(f, "FLIP", format_args!("{:.5}", self.flip))?;
        match (&self.z_test, &self.z_test_problem) {
            (Some(report), _) => write!(f, "{report}"),
            (None, Some(problem)) => row(f, "z-test", problem),
            (None, None) => Ok(()),
        }
    }
}

impl fmt::Display for ZReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let verdict = |pass: bool, decisive: bool| match (pass, decisive) {
            (true, _) => "",
            (false, true) => "  FAILS",
            (false, false) => "  (above, not decisive)",
        };
        let family = |f: &mut fmt::Formatter, name: &str, e: &Extreme, decisive: bool| {
            let (channel, mark) = (["R", "G", "B"][e.channel.min(2)], verdict(e.passes(), decisive));
            let (z, limit) = (e.max_abs_z, e.threshold);
            row(f, name, format_args!("{z:<8.2} limit {limit:.2}  at ({}, {}) {channel}{mark}", e.x, e.y))
        };
        row(
            f,
            "z-test",
            format_args!("{} at {} %", if self.passes { "PASS" } else { "FAIL" }, 100.0 * self.alpha),
        )?;
        family(f, "  max |z| of blocks", &self.blocks, true)?;
        family(f, "  max |z| of means", &self.means, true)?;
        family(f, "  max |z| of pixels", &self.pixels.extreme, self.pixels_decisive)?;
        row(
            f,
            "  pixels above 3",
            format_args!("{:.3} %  (0.270 % expected)", 100.0 * self.pixels.share_above_3),
        )?;
        let (square, p) = (self.dispersion.mean_square_z, self.dispersion.p_value);
        let mark = verdict(self.dispersion.passes(), self.dispersion_decisive);
        row(f, "  mean z² of blocks", format_args!("{square:<8.3} p {p:.3}{mark}"))
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_images::TestImage;
    use super::*;

    #[test]
    fn a_comparison_prints_a_table_and_serialises() {
        let (a, b) = (TestImage::noisy(1, 32, 16), TestImage::noisy(2, 32, 16));
        let comparison = Comparison::new(&a.view(), &b.view(), &ComparisonOptions::default()).unwrap();
        assert_eq!(comparison.passes(), Some(true));
        let table = comparison.to_string();
        for word in ["relative MSE", "FLIP", "PASS at 1 %", "max |z| of blocks"] {
            assert!(table.contains(word), "no {word} in\n{table}");
        }
        let json = serde_json::to_value(&comparison).unwrap();
        assert_eq!(json["z_test"]["passes"], true);
        assert!(json["relative_mse"]["trimmed"].as_f64().unwrap() > 0.0);
    }

    #[test]
    fn images_without_errors_compare_without_a_z_test() {
        let (a, b) = (TestImage::noisy(1, 8, 8), TestImage::noisy(2, 8, 8));
        let comparison = Comparison::new(&a.exact(), &b.exact(), &ComparisonOptions::default()).unwrap();
        assert_eq!(comparison.passes(), None);
        assert!(comparison.to_string().contains("2 samples per pixel or more"));
    }

    #[test]
    fn a_wrong_image_says_where_it_fails() {
        let a = TestImage::noisy(1, 32, 32).scaled(1.05);
        let comparison =
            Comparison::new(&a.view(), &TestImage::noisy(2, 32, 32).view(), &ComparisonOptions::default())
                .unwrap();
        assert!(comparison.to_string().contains("FAILS"));
        assert_eq!(comparison.passes(), Some(false));
    }
}
