//! FLIP: how different two images look when one flips between them, 0 (same) to 1.
//! Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild, "FLIP: A Difference Evaluator for
//! Alternating Images", 2020; section numbers below are the paper's. Written from the paper; all filters are
//! separable, so each is two passes of one dimension.

use rayon::prelude::*;

use super::StatsError;
use super::view::{ImageView, check_pair};

/// A 0.7 m distant, 0.7 m wide display of 3840 pixels.
pub const FLIP_PIXELS_PER_DEGREE: f64 = 67.0;

/// Mean of [`flip_map`].
pub fn flip(a: &ImageView, b: &ImageView, pixels_per_degree: f64) -> Result<f64, StatsError> {
    let map = flip_map(a, b, pixels_per_degree)?;
    Ok(map.iter().map(|&e| f64::from(e)).sum::<f64>() / map.len() as f64)
}

/// LDR-FLIP per pixel of two linear images, each clamped to [0, 1] as on an sRGB display. NaN counts as black.
pub fn flip_map(a: &ImageView, b: &ImageView, pixels_per_degree: f64) -> Result<Vec<f32>, StatsError> {
    check_pair(a, b)?;
    if !(1.0..=1000.0).contains(&pixels_per_degree) {
        return Err(StatsError::BadPixelsPerDegree(pixels_per_degree));
    }
    let (a, b) = (Perceived::new(a, pixels_per_degree), Perceived::new(b, pixels_per_degree));
    let c_max = hyab(hunt(linear_to_lab([0.0, 1.0, 0.0])), hunt(linear_to_lab([0.0, 0.0, 1.0]))).powf(Q_C);
    let pixel = |i: usize| {
        let colour = redistribute(hyab(a.lab[i], b.lab[i]).powf(Q_C), c_max);
        let edges = (a.edges[i] - b.edges[i]).abs();
        let points = (a.points[i] - b.points[i]).abs();
        let feature = (edges.max(points) / std::f32::consts::SQRT_2).powf(Q_F).min(1.0);
        colour.powf(1.0 - feature)
    };
    Ok((0..a.lab.len()).into_par_iter().map(pixel).collect())
}

/// §4.1.3: compresses large colour differences.
const Q_C: f32 = 0.7;
/// §4.2.2: raises small feature differences.
const Q_F: f32 = 0.5;

/// §4.1.3: differences below `P_C` · max fill [0, `P_T`].
fn redistribute(error: f32, max: f32) -> f32 {
    const P_C: f32 = 0.4;
    const P_T: f32 = 0.95;
    let knee = P_C * max;
    if error < knee { error * P_T / knee } else { P_T + (error - knee) / (max - knee) * (1.0 - P_T) }
}

/// What the eye makes of one image.
struct Perceived {
    /// Hunt-adjusted L*a*b* after the contrast sensitivity filters.
    lab: Vec<[f32; 3]>,
    /// Gradient magnitudes of edge and point detectors.
    edges: Vec<f32>,
    points: Vec<f32>,
}

impl Perceived {
    fn new(view: &ImageView, pixels_per_degree: f64) -> Self {
        let opponent: Vec<[f32; 3]> =
            view.rgb.par_iter().map(|&rgb| xyz_to_ycxcz(linear_to_xyz(clamp(rgb)))).collect();
        let plane = |f: &(dyn Fn(&[f32; 3]) -> f32 + Sync)| Plane {
            width: view.width,
            values: opponent.par_iter().map(f).collect(),
        };
        let filtered = |channel: usize| contrast_filter(&plane(&|v| v[channel]), channel, pixels_per_degree);
        let [y, cx, cz] = [0, 1, 2].map(filtered);
        let to_lab = |i| hunt(linear_to_lab(clamp(xyz_to_linear(ycxcz_to_xyz([y[i], cx[i], cz[i]])))));
        let lab = (0..opponent.len()).into_par_iter().map(to_lab).collect();
        let luminance = plane(&|v| (v[0] + 16.0) / 116.0);
        let [edges, points] =
            [edge_kernel, point_kernel].map(|kernel| features(&luminance, kernel, pixels_per_degree));
        Self { lab, edges, points }
    }
}

/// One channel of an image.
struct Plane {
    width: usize,
    values: Vec<f32>,
}

impl Plane {
    /// Convolves rows with `along_x`, columns with `along_y` (odd lengths); borders repeat.
    fn convolve(&self, along_x: &[f32], along_y: &[f32]) -> Vec<f32> {
        let (width, height) = (self.width, self.values.len() / self.width);
        let (rx, ry) = (along_x.len() / 2, along_y.len() / 2);
        let mut rows = vec![0.0f32; self.values.len()];
        rows.par_chunks_mut(width).zip(self.values.par_chunks(width)).for_each(|(out, row)| {
            for (x, out) in out.iter_mut().enumerate() {
                let at = |k: usize| row[(x + k).saturating_sub(rx).min(width - 1)];
                *out = along_x.iter().enumerate().map(|(k, weight)| weight * at(k)).sum();
            }
        });
        let mut result = vec![0.0f32; self.values.len()];
        result.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
            for (k, weight) in along_y.iter().enumerate() {
                let source = (y + k).saturating_sub(ry).min(height - 1) * width;
                out.iter_mut()
                    .zip(&rows[source..source + width])
                    .for_each(|(out, value)| *out += weight * value);
            }
        });
        result
    }
}

/// Values of f at the integers −radius..=radius.
fn sampled(radius: usize, f: impl Fn(f64) -> f64) -> Vec<f64> {
    (0..=2 * radius).map(|i| f(i as f64 - radius as f64)).collect()
}

fn to_f32(kernel: &[f64], scale: f64) -> Vec<f32> {
    kernel.iter().map(|v| (v * scale) as f32).collect()
}

/// §4.1.1, table 1: contrast sensitivity of Y, Cx, Cz as sums of Gaussians a·√(π/b)·exp(−π²d²/b), d in degrees.
fn contrast_filter(plane: &Plane, channel: usize, pixels_per_degree: f64) -> Vec<f32> {
    use std::f64::consts::PI;
    const WIDEST: f64 = 0.04;
    const GAUSSIANS: [&[(f64, f64)]; 3] =
        [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];
    let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as usize;
    let kernels: Vec<(f64, Vec<f64>)> = GAUSSIANS[channel]
        .iter()
        .map(|&(a, b)| {
            (a * (PI / b).sqrt(), sampled(radius, |x| (-(PI * x / pixels_per_degree).powi(2) / b).exp()))
        })
        .collect();
    let total: f64 = kernels.iter().map(|(scale, kernel)| scale * kernel.iter().sum::<f64>().powi(2)).sum();
    let mut sum = vec![0.0f32; plane.values.len()];
    for (scale, kernel) in &kernels {
        let part = plane.convolve(&to_f32(kernel, scale / total), &to_f32(kernel, 1.0));
        sum.par_iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
    }
    sum
}

/// §4.2.1: first derivative of a Gaussian.
fn edge_kernel(x: f64, sigma: f64) -> f64 {
    -x * (-0.5 * (x / sigma).powi(2)).exp()
}

/// §4.2.1: second derivative of a Gaussian.
fn point_kernel(x: f64, sigma: f64) -> f64 {
    ((x / sigma).powi(2) - 1.0) * (-0.5 * (x / sigma).powi(2)).exp()
}

/// Magnitude of the (x, y) response to a derivative kernel whose positive weights sum to 1, negative ones to −1.
fn features(plane: &Plane, kernel: fn(f64, f64) -> f64, pixels_per_degree: f64) -> Vec<f32> {
    const DETECTOR_WIDTH_DEGREES: f64 = 0.082;
    let sigma = 0.5 * DETECTOR_WIDTH_DEGREES * pixels_per_degree;
    let radius = (3.0 * sigma).ceil() as usize;
    let smooth = sampled(radius, |x| (-0.5 * (x / sigma).powi(2)).exp());
    let smooth = to_f32(&smooth, 1.0 / smooth.iter().sum::<f64>());
    let derivative = sampled(radius, |x| kernel(x, sigma));
    let positive: f64 = derivative.iter().filter(|v| **v > 0.0).sum();
    let negative: f64 = -derivative.iter().filter(|v| **v < 0.0).sum::<f64>();
    let balanced: Vec<f32> =
        derivative.iter().map(|&v| (v / if v > 0.0 { positive } else { negative }) as f32).collect();
    let (x, y) = (plane.convolve(&balanced, &smooth), plane.convolve(&smooth, &balanced));
    x.into_par_iter().zip(y).map(|(x, y)| x.hypot(y)).collect()
}

/// Not `f32::clamp`, which would keep NaN.
#[allow(clippy::manual_clamp)]
fn clamp(rgb: [f32; 3]) -> [f32; 3] {
    rgb.map(|v| v.max(0.0).min(1.0))
}

/// XYZ of the display's white (D65), so that white has a* = b* = 0.
const WHITE: [f32; 3] = [0.950_428_5, 1.0, 1.088_900_4];

fn linear_to_xyz([r, g, b]: [f32; 3]) -> [f32; 3] {
    [
        0.412_386_56 * r + 0.357_591_5 * g + 0.180_450_5 * b,
        0.212_636_82 * r + 0.715_182_98 * g + 0.072_180_2 * b,
        0.019_330_62 * r + 0.119_197_16 * g + 0.950_372_6 * b,
    ]
}

fn xyz_to_linear([x, y, z]: [f32; 3]) -> [f32; 3] {
    [
        3.241_003_3 * x - 1.537_399 * y - 0.498_615_9 * z,
        -0.969_224_3 * x + 1.875_93 * y + 0.041_554_226 * z,
        0.055_639_42 * x - 0.204_011_2 * y + 1.057_148_9 * z,
    ]
}

fn xyz_to_ycxcz(xyz: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = [0, 1, 2].map(|i| xyz[i] / WHITE[i]);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn ycxcz_to_xyz([yy, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (yy + 16.0) / 116.0;
    [(y + cx / 500.0) * WHITE[0], y * WHITE[1], (y - cz / 200.0) * WHITE[2]]
}

fn linear_to_lab(rgb: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let curve = |t: f32| {
        if t > DELTA * DELTA * DELTA { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
    };
    let xyz = linear_to_xyz(rgb);
    let [x, y, z] = [0, 1, 2].map(|i| curve(xyz[i] / WHITE[i]));
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Hunt effect (§4.1.2): the darker, the less coloured.
fn hunt([l, a, b]: [f32; 3]) -> [f32; 3] {
    [l, 0.01 * l * a, 0.01 * l * b]
}

/// HyAB distance (§4.1.2): city block in lightness, Euclidean in colour.
fn hyab(p: [f32; 3], q: [f32; 3]) -> f32 {
    (p[0] - q[0]).abs() + (p[1] - q[1]).hypot(p[2] - q[2])
}

#[cfg(test)]
mod tests {
    use super::super::test_images::TestImage;
    use super::*;

    fn mean(a: &TestImage, b: &TestImage) -> f64 {
        flip(&a.exact(), &b.exact(), FLIP_PIXELS_PER_DEGREE).unwrap()
    }

    fn constant(colour: [f32; 3]) -> TestImage {
        TestImage::constant(33, 21, colour)
    }

    #[test]
    fn identical_images_do_not_flip() {
        let a = TestImage::noisy(1, 40, 30);
        assert_eq!(mean(&a, &a), 0.0);
    }

    #[test]
    fn flip_is_symmetric() {
        let (a, b) = (TestImage::noisy(1, 40, 30), TestImage::noisy(2, 40, 30));
        assert!((mean(&a, &b) - mean(&b, &a)).abs() < 1e-6);
        assert!(mean(&a, &b) > 0.01);
    }

    /// Constant images have no features: the value follows from L* = 100 against 0 and the green-blue distance.
    #[test]
    fn black_against_white_is_nearly_one() {
        let error = mean(&constant([0.0; 3]), &constant([1.0; 3]));
        assert!((error - 0.967).abs() < 0.002, "{error}");
    }

    #[test]
    fn green_against_blue_is_one() {
        let error = mean(&constant([0.0, 1.0, 0.0]), &constant([0.0, 0.0, 1.0]));
        assert!((error - 1.0).abs() < 1e-3, "{error}");
    }

    #[test]
    fn more_noise_flips_more_and_never_above_one() {
        let truth = constant([0.5; 3]);
        let errors: Vec<f64> = [0.02, 0.1, 0.5, 5.0]
            .iter()
            .map(|&amplitude| {
                let mut noisy = truth.clone();
                for (i, rgb) in noisy.rgb.iter_mut().enumerate() {
                    *rgb = rgb.map(|v| v + amplitude * (i as f32 * 12.9898).sin());
                }
                mean(&noisy, &truth)
            })
            .collect();
        assert!(errors.windows(2).all(|pair| pair[0] < pair[1]), "{errors:?}");
        assert!(errors[3] <= 1.0);
    }

    #[test]
    fn colour_spaces_come_back_and_white_is_neutral() {
        let rgb = [0.2, 0.7, 0.4];
        let back = xyz_to_linear(ycxcz_to_xyz(xyz_to_ycxcz(linear_to_xyz(rgb))));
        assert!(rgb.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-4), "{back:?}");
        let white = linear_to_lab([1.0; 3]);
        assert!(
            (white[0] - 100.0).abs() < 1e-2 && white[1].abs() < 1e-2 && white[2].abs() < 1e-2,
            "{white:?}"
        );
    }

    /// A filtered constant stays itself; a detector sees nothing in it.
    #[test]
    fn filters_keep_constants_and_detectors_ignore_them() {
        let plane = Plane { width: 9, values: vec![40.0; 63] };
        for channel in 0..3 {
            let filtered = contrast_filter(&plane, channel, FLIP_PIXELS_PER_DEGREE);
            assert!(filtered.iter().all(|v| (v - 40.0).abs() < 1e-3));
        }
        for kernel in [edge_kernel, point_kernel] {
            assert!(features(&plane, kernel, FLIP_PIXELS_PER_DEGREE).iter().all(|v| v.abs() < 1e-4));
        }
    }

    #[test]
    fn displays_that_can_not_be_are_errors() {
        let a = constant([0.5; 3]);
        for ppd in [0.0, -67.0, 1e9, f64::NAN] {
            assert!(flip(&a.exact(), &a.exact(), ppd).is_err());
        }
    }

    #[test]
    fn one_pixel_and_not_a_number_do_no_harm() {
        let a = TestImage::constant(1, 1, [f32::NAN, 2.0, -1.0]);
        let b = TestImage::constant(1, 1, [0.0, 1.0, 0.0]);
        assert!(mean(&a, &b) < 1e-6);
    }
}
