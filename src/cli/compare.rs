//! `compare`: an image against a reference, in figures and as a verdict.

use super::console;
use super::diff;
use super::failure::Failure;
use super::values;
use clap::Args;
use qtracer::Image;
use qtracer::film::{check_writable, read_image};
use qtracer::stats::{Comparison, ComparisonOptions};
use serde::Serialize;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

#[derive(Args)]
#[command(after_help = "\
Examples:
  qtracer compare cornell.exr reference.exr
      How far apart are they?
  qtracer compare cornell.exr reference.exr --max-relmse 0.01
      Exits 1 if the relative mean square error is larger.
  qtracer compare cornell.exr reference.exr --z-test
      Exits 1 unless noise explains every difference: a right image fails once in a hundred times.
  qtracer compare cornell.exr reference.exr --diff difference.png
      Where is it brighter (red), where darker (blue)?

Standard errors come from the .exr's own layers, as qtracer writes them; else from NAME.se.exr beside NAME.exr, whose
colours are then the errors. An image without any is taken as exact. Images are .exr, .png, .jpg or .hdr; the
8 bits of a .png are too coarse for a z-test.")]
pub struct CompareArgs {
    /// Image
    a: PathBuf,

    /// Reference
    b: PathBuf,

    /// Fail if the relative mean square error (of all pixels, none left out) is above this
    #[arg(long, value_name = "X", value_parser = values::not_negative, allow_negative_numbers = true)]
    max_relmse: Option<f64>,

    /// Relative mean square error: mean of (A - B)² / (B² + EPSILON)
    #[arg(long, default_value = "0.01", value_parser = values::positive, allow_negative_numbers = true)]
    epsilon: f64,

    /// Fail unless the standard errors explain every difference
    #[arg(long)]
    z_test: bool,

    /// Chance that the z-test fails a right image
    #[arg(long, default_value = "0.01", value_parser = values::probability, allow_negative_numbers = true)]
    alpha: f64,

    /// Image whose colours are the standard errors of B
    #[arg(long, value_name = "FILE")]
    stderr_of_b: Option<PathBuf>,

    /// Write a picture of the difference: .png in false colours (red: A is brighter, blue: darker, black: equal,
    /// green: not a number), .exr with A - B itself
    #[arg(long, value_name = "FILE")]
    diff: Option<PathBuf>,

    /// Relative difference of luminance that has the full colour in a --diff .png
    #[arg(long, value_name = "REL", default_value = "0.25", value_parser = values::positive, allow_negative_numbers = true)]
    diff_range: f64,

    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Named<'a> {
    image: String,
    reference: String,
    #[serde(flatten)]
    comparison: &'a Comparison,
}

pub fn run(args: &CompareArgs) -> Result<(), Failure> {
    if let Some(path) = &args.diff {
        check_writable(path).map_err(Failure::bad_input)?;
    }
    let a = read(&args.a, None)?;
    let b = read(&args.b, args.stderr_of_b.as_deref())?;
    let mut options = ComparisonOptions { epsilon: args.epsilon, ..Default::default() };
    options.z_test.alpha = args.alpha;
    let comparison = Comparison::new(&a.view(), &b.view(), &options).map_err(Failure::bad_input)?;
    note_exact_images(args, &a, &b);
    note_stratified(&args.a, &a);
    note_stratified(&args.b, &b);
    if args.json {
        console::json(&Named {
            image: args.a.display().to_string(),
            reference: args.b.display().to_string(),
            comparison: &comparison,
        })?;
    } else {
        console::data(&comparison)?;
    }
    let mut problems = verdict(args, &comparison);
    if let Some(path) = &args.diff {
        let written = diff::write(path, &a, &b, args.diff_range as f32);
        problems.extend(written.err().map(|e| e.to_string()));
    }
    match problems.is_empty() {
        true => Ok(()),
        // Images that can't answer are bad images, not different ones.
        false if args.z_test && comparison.z_test_problem.is_some() => {
            Err(Failure::bad_input(problems.join("\nerror: ")))
        }
        false => Err(Failure::failed_all(problems)),
    }
}

/// What fails the comparison. NaN is above every limit.
fn verdict(args: &CompareArgs, comparison: &Comparison) -> Vec<String> {
    let mut problems = Vec::new();
    let plain = comparison.relative_mse.plain;
    match args.max_relmse {
        Some(limit) if plain.is_nan() || plain > limit => {
            problems.push(format!("relative MSE {plain:.4e} is above --max-relmse {limit}"));
        }
        _ => (),
    }
    if args.z_test && comparison.passes() != Some(true) {
        problems.push(match &comparison.z_test_problem {
            Some(reason) => format!("--z-test can't be made: {reason}"),
            None => "--z-test: the images differ by more than their standard errors explain".into(),
        });
    }
    problems
}

/// With the standard errors that belong to it, if there are any.
fn read(path: &Path, errors: Option<&Path>) -> Result<Image, Failure> {
    let mut image = read_image(path).map_err(Failure::bad_input)?;
    let beside = sibling(path);
    let errors = match errors {
        Some(errors) => Some(errors),
        None if image.standard_error.is_none() => beside.is_file().then_some(beside.as_path()),
        None => None,
    };
    if let Some(errors) = errors {
        image.standard_error = Some(read_errors(path, &image, errors)?);
    }
    Ok(image)
}

/// `NAME.se.exr` for `NAME.exr`.
fn sibling(path: &Path) -> PathBuf {
    let mut name: OsString = path.file_stem().unwrap_or_default().to_owned();
    name.push(".se.exr");
    path.with_file_name(name)
}

fn read_errors(path: &Path, image: &Image, errors: &Path) -> Result<Vec<[f32; 3]>, Failure> {
    let read = read_image(errors).map_err(Failure::bad_input)?;
    let (path, errors) = (path.display(), errors.display());
    if (read.width, read.height) != (image.width, image.height) {
        return Err(Failure::bad_input(format!(
            "\"{errors}\" has {}x{} pixels, but \"{path}\", whose standard errors it should hold, {}x{}; \
             give the file that belongs to it",
            read.width, read.height, image.width, image.height
        )));
    }
    console::note(format!("standard errors of \"{path}\" are from \"{errors}\""));
    Ok(read.rgb)
}

/// Errors of evenly spread samples are estimated too large, so that a z-test passes too easily.
fn note_stratified(path: &Path, image: &Image) {
    if image.standard_error.is_some() && image.metadata.get("sampler") == Some("stratified") {
        let path = path.display();
        console::note(format!(
            "\"{path}\" has stratified samples, whose standard errors are too large as a rule; \
             for a strict z-test render with --sampler independent"
        ));
    }
}

/// A z-test against an image without errors takes it as exact, which must be meant.
fn note_exact_images(args: &CompareArgs, a: &Image, b: &Image) {
    let exact = match (&a.standard_error, &b.standard_error) {
        (None, Some(_)) => &args.a,
        (Some(_), None) => &args.b,
        _ => return,
    };
    let exact = exact.display();
    console::note(format!("\"{exact}\" has no standard errors: the z-test takes it as exact"));
}
