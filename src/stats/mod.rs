//! Is this image right, and how far off is it? Statistics that decide, and measures that describe.
//!
//! Everything here reads plain slices ([`ImageView`]), so that this floor knows nothing of films and files.
//! The one call for two images is [`Comparison::new`]; the one call for a histogram is [`chi2_test`].

mod chi2;
mod comparison;
mod error;
mod flip;
mod gamma;
mod metrics;
mod normal;
#[cfg(test)]
pub(crate) mod test_images;
mod view;
mod z_report;
mod z_test;

pub use chi2::{ChiSquare, chi2_survival, chi2_test};
pub use comparison::{Comparison, ComparisonOptions};
pub use error::StatsError;
pub use flip::{FLIP_PIXELS_PER_DEGREE, flip, flip_map};
pub use metrics::{Differences, RelMse, differences, mean_ratio, mse, relative_mse};
pub use normal::{erfc, normal_cdf, normal_quantile, normal_survival, normal_two_sided_threshold, sidak};
pub use view::ImageView;
pub use z_report::{Dispersion, Extreme, PixelReport, ZReport};
pub use z_test::{ZTestOptions, z_test};
