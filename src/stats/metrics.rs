//! How far one image is from another, without asking whether noise explains it.

use super::StatsError;
use super::view::{ImageView, check_pair};

/// Relative mean squared error: the mean over pixels and channels of (I − R)² / (R² + ε).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct RelMse {
    /// Over all pixels.
    pub plain: f64,
    /// Without the worst 0.1 % of pixels (rounded down), which fireflies would otherwise dominate.
    pub trimmed: f64,
}

const TRIMMED_SHARE: f64 = 0.001;

/// Image differences that need no reference side.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Differences {
    /// Largest |a − b| of a channel.
    pub max_absolute: f64,
    /// Largest |a − b| / max(|a|, |b|) of a channel, in 0..=2.
    pub max_relative: f64,
    /// Share of pixels whose channels all agree within 1e-3, relatively.
    pub share_within_1e3: f64,
}

/// NaN means that nothing is known: count it as infinitely wrong, never as right.
fn nan_is_infinite(value: f64) -> f64 {
    if value.is_nan() { f64::INFINITY } else { value }
}

fn channel_pairs<'a>(a: &'a [f32; 3], b: &'a [f32; 3]) -> impl Iterator<Item = (f64, f64)> + 'a {
    a.iter().zip(b).map(|(&a, &b)| (f64::from(a), f64::from(b)))
}

/// Mean squared error over pixels and channels; infinite if a value is NaN.
pub fn mse(a: &ImageView, b: &ImageView) -> Result<f64, StatsError> {
    check_pair(a, b)?;
    let sum: f64 =
        a.rgb.iter().zip(b.rgb).flat_map(|(a, b)| channel_pairs(a, b)).map(|(a, b)| (a - b) * (a - b)).sum();
    Ok(nan_is_infinite(sum / (3 * a.pixel_count()) as f64))
}

/// See [`RelMse`]. `epsilon` keeps dark pixels from ruling; 0.01 is the usual choice.
pub fn relative_mse(image: &ImageView, reference: &ImageView, epsilon: f64) -> Result<RelMse, StatsError> {
    check_pair(image, reference)?;
    let pixel_error = |(image, reference)| {
        let sum: f64 =
            channel_pairs(image, reference).map(|(i, r)| (i - r) * (i - r) / (r * r + epsilon)).sum();
        nan_is_infinite(sum / 3.0)
    };
    let mut errors: Vec<f64> = image.rgb.iter().zip(reference.rgb).map(pixel_error).collect();
    let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    let plain = mean(&errors);
    errors.sort_by(f64::total_cmp);
    errors.truncate(errors.len() - (errors.len() as f64 * TRIMMED_SHARE) as usize);
    Ok(RelMse { plain, trimmed: mean(&errors) })
}

/// Mean of `a` over mean of `b`, per channel; 1 where both are 0.
pub fn mean_ratio(a: &ImageView, b: &ImageView) -> Result<[f64; 3], StatsError> {
    check_pair(a, b)?;
    let sum =
        |view: &ImageView, channel: usize| view.rgb.iter().map(|rgb| f64::from(rgb[channel])).sum::<f64>();
    Ok([0, 1, 2].map(|channel| match (sum(a, channel), sum(b, channel)) {
        (a, b) if a == b => 1.0,
        (a, b) => a / b,
    }))
}

/// See [`Differences`].
pub fn differences(a: &ImageView, b: &ImageView) -> Result<Differences, StatsError> {
    check_pair(a, b)?;
    let mut found = Differences { max_absolute: 0.0, max_relative: 0.0, share_within_1e3: 0.0 };
    let mut close = 0usize;
    for (a, b) in a.rgb.iter().zip(b.rgb) {
        let mut pixel_relative = 0.0f64;
        for (a, b) in channel_pairs(a, b).filter(|(a, b)| a != b) {
            let absolute = nan_is_infinite((a - b).abs());
            let relative = (absolute / a.abs().max(b.abs())).min(2.0);
            found.max_absolute = found.max_absolute.max(absolute);
            pixel_relative = pixel_relative.max(nan_is_infinite(relative));
        }
        found.max_relative = found.max_relative.max(pixel_relative.min(2.0));
        close += usize::from(pixel_relative <= 1e-3);
    }
    found.share_within_1e3 = close as f64 / a.pixel_count() as f64;
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::super::test_images::TestImage;
    use super::*;

    #[test]
    fn identical_images_have_no_error() {
        let a = TestImage::noisy(1, 20, 10);
        assert_eq!(mse(&a.view(), &a.view()), Ok(0.0));
        assert_eq!(relative_mse(&a.view(), &a.view(), 0.01), Ok(RelMse { plain: 0.0, trimmed: 0.0 }));
        assert_eq!(mean_ratio(&a.view(), &a.view()), Ok([1.0; 3]));
        let same = Differences { max_absolute: 0.0, max_relative: 0.0, share_within_1e3: 1.0 };
        assert_eq!(differences(&a.view(), &a.view()), Ok(same));
    }

    #[test]
    fn relative_mse_of_known_images() {
        let a = TestImage::constant(10, 10, [0.5; 3]);
        let b = TestImage::constant(10, 10, [0.3; 3]);
        let want = 0.04 / (0.09 + 0.01);
        assert!((relative_mse(&a.exact(), &b.exact(), 0.01).unwrap().plain - want).abs() < 1e-6);
        assert!((mse(&a.exact(), &b.exact()).unwrap() - 0.04).abs() < 1e-7);
        assert!((mean_ratio(&a.exact(), &b.exact()).unwrap()[1] - 5.0 / 3.0).abs() < 1e-6);
    }

    #[test]
    fn trimming_leaves_out_one_firefly_in_a_thousand() {
        let reference = TestImage::constant(50, 40, [0.5; 3]);
        let mut image = reference.clone();
        image.rgb[7] = [1e4; 3];
        image.rgb[8] = [1e4; 3];
        let error = relative_mse(&image.exact(), &reference.exact(), 0.01).unwrap();
        assert!(error.plain > 1e4);
        assert_eq!(error.trimmed, 0.0);
        image.rgb[9] = [1e4; 3];
        assert!(relative_mse(&image.exact(), &reference.exact(), 0.01).unwrap().trimmed > 1e4);
    }

    #[test]
    fn not_a_number_is_never_close() {
        let reference = TestImage::constant(4, 4, [0.5; 3]);
        let mut image = reference.clone();
        image.rgb[3][1] = f32::NAN;
        assert_eq!(mse(&image.exact(), &reference.exact()), Ok(f64::INFINITY));
        assert_eq!(relative_mse(&image.exact(), &reference.exact(), 0.01).unwrap().plain, f64::INFINITY);
        let found = differences(&image.exact(), &reference.exact()).unwrap();
        assert_eq!((found.max_absolute, found.max_relative), (f64::INFINITY, 2.0));
        assert_eq!(found.share_within_1e3, 15.0 / 16.0);
    }

    #[test]
    fn sizes_that_differ_are_an_error() {
        let (a, b) = (TestImage::noisy(1, 4, 6), TestImage::noisy(1, 6, 4));
        assert_eq!(mse(&a.view(), &b.view()), Err(StatsError::SizeMismatch(4, 6, 6, 4)));
        let short = ImageView { height: 7, ..a.view() };
        assert!(relative_mse(&short, &short, 0.01).is_err());
    }
}
