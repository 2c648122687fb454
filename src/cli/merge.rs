//! `merge`: renders of different samples of one scene, put together as if they had been one.

use super::console;
use super::failure::Failure;
use clap::Args;
use qtracer::film::{Metadata, PixelSum, WriteOptions, check_writable, read_image, write_image};
use qtracer::{Film, Image};
use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

#[derive(Args)]
#[command(after_help = "\
Examples:
  qtracer render room.toml --spp 512 -o a.exr
  qtracer render room.toml --spp 512 --first-sample 512 -o b.exr
  qtracer merge a.exr b.exr -o room.exr
      As good as one render of 1024 samples; with --guide off the same, to about 1e-6 (the library's Film::merge:
      to the bit).
  qtracer merge seed1.exr seed2.exr seed3.exr -o room.exr
      Renders of different seeds can be merged too.
  qtracer merge room.exr c.exr -o room.exr
      And merged ones once more.

The parts must be .exr images that qtracer rendered, of one scene and size, and no sample may be in two of them.")]
pub struct MergeArgs {
    /// Images (.exr) with their standard errors and sample counts
    #[arg(required = true, num_args = 2.., value_name = "IMAGE")]
    images: Vec<PathBuf>,

    /// Image to write (.exr, or .png to look at)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Print only warnings and errors
    #[arg(short, long)]
    quiet: bool,
}

pub fn run(args: &MergeArgs) -> Result<(), Failure> {
    check_writable(&args.output).map_err(Failure::bad_input)?;
    let mut merged = Shard::read(&args.images[0])?;
    for path in &args.images[1..] {
        merged.add(Shard::read(path)?)?;
    }
    let image = merged.into_image();
    write_image(&args.output, &image, &WriteOptions::default()).map_err(Failure::failed)?;
    if !args.quiet {
        let (count, path) = (args.images.len(), args.output.display());
        let samples = image.metadata.get("samples").unwrap_or_default();
        console::line(format!("merged {count} images of {samples} samples/pixel; wrote {path}"));
    }
    Ok(())
}

/// Consecutive samples of one seed.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Part {
    seed: u32,
    samples: Range<u64>,
    /// The file that holds it.
    path: PathBuf,
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}..{}", self.seed, self.samples.start, self.samples.end)
    }
}

/// One or more renders, as sums.
struct Shard {
    path: PathBuf,
    film: Film,
    parts: Vec<Part>,
    image: Image,
}

impl Shard {
    fn read(path: &Path) -> Result<Shard, Failure> {
        let image = read_image(path).map_err(Failure::bad_input)?;
        let refuse = |what: &str| {
            let path = path.display();
            Failure::bad_input(format!(
                "cannot merge \"{path}\": {what}; only .exr images that qtracer rendered can be merged"
            ))
        };
        Ok(Shard {
            film: film(&image).map_err(refuse)?,
            parts: parts(path, &image.metadata)
                .ok_or_else(|| refuse("it does not say which samples it has"))?,
            path: path.into(),
            image,
        })
    }

    /// Adds another shard, if it is of the same picture and all its samples are new.
    fn add(&mut self, other: Shard) -> Result<(), Failure> {
        let path = other.path.display();
        self.same(&other, &["scene", "max_bounces"])?;
        self.same_estimand(&other)?;
        for part in &other.parts {
            if let Some(old) = self.parts.iter().find(|old| overlap(old, part)) {
                let old_path = old.path.display();
                return Err(Failure::bad_input(format!(
                    "cannot merge \"{path}\" (samples {}..{}) with \"{old_path}\" (samples {}..{}): both have seed {} \
                     and share samples; render with another --first-sample or --seed",
                    part.samples.start, part.samples.end, old.samples.start, old.samples.end, part.seed
                )));
            }
        }
        let merged = self.film.merge(&other.film);
        merged.map_err(|e| Failure::bad_input(format!("cannot merge \"{path}\": {e}")))?;
        self.same(&other, &["fingerprint"])?;
        self.parts.extend(other.parts);
        let (metadata, more) = (&mut self.image.metadata, &other.image.metadata);
        join(metadata, more, "engine");
        join(metadata, more, "device");
        join(metadata, more, "guide");
        join(metadata, more, "roulette");
        if self.image.features.is_none() {
            self.image.features = other.image.features;
        }
        Ok(())
    }

    /// Refuses another shard whose metadata say otherwise about any of `keys`.
    fn same(&self, other: &Shard, keys: &[&str]) -> Result<(), Failure> {
        for key in keys {
            let get = |image: &Image| image.metadata.get(key).unwrap_or("unknown").to_string();
            let (ours, theirs) = (get(&self.image), get(&other.image));
            if ours != theirs {
                let (path, first) = (other.path.display(), self.path.display());
                return Err(Failure::bad_input(format!(
                    "cannot merge \"{path}\" ({key} {theirs}) with \"{first}\" ({key} {ours}); \
                     merge renders of one scene, seen alike"
                )));
            }
        }
        Ok(())
    }

    /// Guided and plain renders converge to the same; those of a biased guide to something of its own.
    fn same_estimand(&self, other: &Shard) -> Result<(), Failure> {
        let guide = |shard: &Shard| {
            let get = |key| shard.image.metadata.get(key);
            let rule = get("guide_rule").map_or(String::new(), |rule| format!(": {rule}"));
            format!("{}{rule}", get("guide").unwrap_or("off"))
        };
        let (ours, theirs) = (guide(self), guide(other));
        let biased = |guide: &str| guide.contains("(biased)");
        if ours == theirs || !(biased(&ours) || biased(&theirs)) {
            return Ok(());
        }
        let (path, first) = (other.path.display(), self.path.display());
        Err(Failure::bad_input(format!(
            "cannot merge \"{path}\" (guide {theirs}) with \"{first}\" (guide {ours}): a biased guide converges to \
             another image; merge it with its own kind only"
        )))
    }

    fn into_image(self) -> Image {
        let samples = self.film.samples().1;
        Image {
            features: self.image.features,
            metadata: described(&self.image.metadata, self.parts, samples),
            ..self.film.image()
        }
    }
}

fn overlap(a: &Part, b: &Part) -> bool {
    a.seed == b.seed && a.samples.start < b.samples.end && b.samples.start < a.samples.end
}

/// The sums that an image was made of, from means m, their standard errors s and counts n:
/// s² = (Σx² − n m²) / (n (n − 1)).
fn film(image: &Image) -> Result<Film, &'static str> {
    let errors = image.standard_error.as_ref().ok_or("it has no standard errors")?;
    let counts = image.samples.as_ref().ok_or("it has no sample counts")?;
    let mut film = Film::new(image.width, image.height);
    let pixels = film.pixels_mut().iter_mut().zip(&image.rgb).zip(errors).zip(counts);
    for (((pixel, mean), error), &count) in pixels {
        if !(0.0..=1e15).contains(&count) {
            return Err("a sample count is no count");
        }
        let n = f64::from(count.round());
        *pixel = PixelSum {
            sum: mean.map(|m| f64::from(m) * n),
            sum_sq: [0, 1, 2].map(|channel| {
                let (m, s) = (f64::from(mean[channel]), f64::from(error[channel]));
                // The error of a single sample is unknown, but its square is not.
                let scatter = if n < 2.0 { 0.0 } else { s * s * n * (n - 1.0) };
                scatter + m * m * n
            }),
            count: n as u64,
        };
    }
    Ok(film)
}

/// Which samples an image says it has: `parts` of a merged one, else one range.
fn parts(path: &Path, metadata: &Metadata) -> Option<Vec<Part>> {
    if let Some(list) = metadata.get("parts") {
        return list.split_whitespace().map(|text| part(path, text)).collect();
    }
    let number = |key: &str| metadata.get(key)?.parse::<u64>().ok();
    let (seed, first, samples) = (number("seed")?, number("first_sample")?, number("samples")?);
    let text = format!("{seed}:{first}..{}", first.checked_add(samples)?);
    Some(vec![part(path, &text)?])
}

/// `SEED:FIRST..END`.
fn part(path: &Path, text: &str) -> Option<Part> {
    let (seed, range) = text.split_once(':')?;
    let (first, end) = range.split_once("..")?;
    Some(Part {
        seed: seed.parse().ok()?,
        samples: first.parse().ok()?..end.parse().ok()?,
        path: path.into(),
    })
}

/// Says both values where they differ.
fn join(metadata: &mut Metadata, more: &Metadata, key: &str) {
    let (Some(ours), Some(theirs)) = (metadata.get(key), more.get(key)) else {
        return;
    };
    if !ours.split(", ").any(|known| known == theirs) {
        let both = format!("{ours}, {theirs}");
        metadata.set(key, both);
    }
}

/// The metadata of the whole: one range if the parts make one, else `parts`.
fn described(metadata: &Metadata, parts: Vec<Part>, samples: u64) -> Metadata {
    let parts = coalesced(parts);
    let mut whole = Metadata::new();
    for (key, value) in metadata.iter() {
        if !["seed", "first_sample", "samples", "parts"].contains(&key) {
            whole.set(key, value);
        }
    }
    match parts.as_slice() {
        [one] => {
            whole.set("seed", one.seed);
            whole.set("first_sample", one.samples.start);
        }
        many => {
            let list: Vec<String> = many.iter().map(Part::to_string).collect();
            whole.set("parts", list.join(" "));
        }
    }
    whole.set("samples", samples);
    whole
}

/// Ranges that meet become one.
fn coalesced(mut parts: Vec<Part>) -> Vec<Part> {
    parts.sort_by_key(|part| (part.seed, part.samples.start));
    let mut joined: Vec<Part> = Vec::new();
    for part in parts {
        match joined.last_mut() {
            Some(last) if last.seed == part.seed && last.samples.end == part.samples.start => {
                last.samples.end = part.samples.end;
            }
            _ => joined.push(part),
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Part {
        part(Path::new("a.exr"), text).unwrap()
    }

    #[test]
    fn parts_are_read_and_written_alike() {
        assert_eq!(of("7:32..64").to_string(), "7:32..64");
        for text in ["", "7", "7:3", "x:0..1", "1:0..x", "-1:0..1"] {
            assert!(part(Path::new("a.exr"), text).is_none(), "{text}");
        }
    }

    #[test]
    fn only_equal_seeds_with_common_samples_overlap() {
        assert!(overlap(&of("1:0..32"), &of("1:31..40")));
        assert!(overlap(&of("1:10..20"), &of("1:0..32")));
        assert!(!overlap(&of("1:0..32"), &of("1:32..64")));
        assert!(!overlap(&of("1:0..32"), &of("2:0..32")));
    }

    #[test]
    fn ranges_that_meet_become_one() {
        let joined = coalesced(vec![of("1:32..64"), of("2:0..8"), of("1:0..32"), of("1:70..80")]);
        let texts: Vec<String> = joined.iter().map(Part::to_string).collect();
        assert_eq!(texts, ["1:0..64", "1:70..80", "2:0..8"]);
    }

    #[test]
    fn sums_come_back_from_means_errors_and_counts() {
        let mut film = Film::new(1, 1);
        for value in [0.5, 1.5, 4.0] {
            film.add_sample(0, [value, 2.0 * value, 0.0].into());
        }
        let (expected, back) = (film.pixels()[0], super::film(&film.image()).unwrap());
        assert_eq!(back.pixels()[0].count, 3);
        for channel in 0..3 {
            let (a, b) = (expected.sum_sq[channel], back.pixels()[0].sum_sq[channel]);
            assert!((a - b).abs() <= 1e-6 * a, "{a} {b}");
        }
    }
}
