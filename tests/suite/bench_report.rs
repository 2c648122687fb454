//! What benches/support makes of measurements: errors, means, rows, curves, the page.

#[path = "../../benches/support/mod.rs"]
#[allow(dead_code)] // The rest is for the bench.
mod bench;

use bench::chart::{Axis, digits, escape, number};
use bench::measure::Checks;
use bench::rows::{Row, csv, parse};
use bench::summary::{Estimate, summarize};
use bench::truth::{self, Reference};
use bench::variant::Variant;
use bench::{machine, page};
use qtracer::Image;
use qtracer::stats::relative_mse;

/// Values of mean 0 and variance 1, by summing twelve uniform ones: a fixed sequence for each seed.
fn noise(seed: u32, count: usize) -> Vec<f64> {
    let mut state = u64::from(seed).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1u32 << 31)
    };
    (0..count).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect()
}

/// A grey image of 0.5 with noise of this standard deviation in every channel.
fn grey(seed: u32, deviation: f64) -> Image {
    let values = noise(seed, 3 * 64 * 64);
    let rgb = values.chunks(3).map(|v| [0, 1, 2].map(|c| (0.5 + deviation * v[c]) as f32)).collect();
    Image::new(64, 64, rgb)
}

fn reference(seed: u32, deviation: f64) -> Reference {
    let image = grey(seed, deviation);
    let errors = vec![[deviation as f32; 3]; image.rgb.len()];
    Reference { image: Image { standard_error: Some(errors), ..image }, name: "grey".to_string() }
}

#[test]
fn variants_are_read_and_wrong_ones_named() {
    let variant: Variant = "auto:learnt:2.5".parse().unwrap();
    assert!(variant.trial && variant.scale == Some(2.5));
    assert!(!"adaptive".parse::<Variant>().unwrap().trial);
    for (text, problem) in [
        ("", "guide \"\""),
        ("of", "guide \"of\""),
        ("off:on", "roulette \"on\""),
        ("off:learnt:0", "\"0\" is no scale"),
        ("off:learnt:1:2:3:4", "too much"),
    ] {
        let message = text.parse::<Variant>().unwrap_err();
        assert!(message.contains(problem) && message.contains("write GUIDE"), "{text}: {message}");
    }
}

/// The error of an image is its own variance, whatever the reference's; without the subtraction it would not be (control).
#[test]
fn a_references_own_noise_is_taken_off() {
    let (own, of_reference, epsilon) = (0.05, 0.03, 0.01);
    let want = own * own / (0.25 + epsilon);
    let (image, reference) = (grey(1, own), reference(2, of_reference));
    let found = reference.error_of(&image.rgb, epsilon).unwrap();
    assert!((found.plain / want - 1.0).abs() < 0.05, "{} instead of {want}", found.plain);
    let raw = relative_mse(&image.view(), &reference.image.view(), epsilon).unwrap();
    assert!((raw.plain - reference.noise(epsilon) - found.plain).abs() < 1e-9);
    assert!((raw.plain / want - 1.0).abs() > 0.2, "control: the reference's noise is seen");
}

#[test]
fn fireflies_are_trimmed_and_numbers_that_are_none_refused() {
    let reference = reference(3, 0.0);
    let mut image = grey(4, 0.05);
    let before = reference.error_of(&image.rgb, 0.01).unwrap();
    image.rgb[100] = [1e3; 3];
    let after = reference.error_of(&image.rgb, 0.01).unwrap();
    assert!(after.plain > 100.0 * before.plain && (after.trimmed / before.trimmed - 1.0).abs() < 0.02);
    image.rgb[100][1] = f32::NAN;
    assert!(reference.error_of(&image.rgb, 0.01).is_err());
}

/// Seeds' scatter is their variance; that all of them are wrong alike it can't see (control).
#[test]
fn scatter_is_variance_and_blind_to_a_common_bias() {
    let images: Vec<Vec<[f32; 3]>> = (10..16).map(|seed| grey(seed, 0.05).rgb).collect();
    let scale = vec![[0.5; 3]; 64 * 64];
    let mean = |noise: Vec<truth::Noise>| noise.iter().map(|n| n.plain).sum::<f64>() / noise.len() as f64;
    let found = mean(truth::scatter(&images, &scale, 0.01).unwrap());
    assert!((found / (0.0025 / 0.26) - 1.0).abs() < 0.03, "{found}");
    let brighter: Vec<_> =
        images.iter().map(|i| i.iter().map(|rgb| rgb.map(|v| v + 1.0)).collect()).collect();
    assert!((mean(truth::scatter(&brighter, &scale, 0.01).unwrap()) / found - 1.0).abs() < 1e-3);
    assert!(truth::scatter(&images[..1], &scale, 0.01).is_err(), "one seed tells nothing");
}

#[test]
fn self_made_references_know_their_error_and_shrink() {
    let parts: Vec<Image> = (20..36).map(|seed| grey(seed, 0.08)).collect();
    let made = truth::self_made(&parts);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("grey.exr");
    truth::write(&path, &made).unwrap();
    let whole = Reference::read(&path, None).unwrap();
    let want = 0.08 * 0.08 / 16.0 / 0.26;
    assert!((whole.noise(0.01) / want - 1.0).abs() < 0.05, "{}", whole.noise(0.01));
    // What it says of its noise is what its noise is.
    let truth = reference(0, 0.0);
    let actual = truth.error_of(&whole.image.rgb, 0.01).unwrap().plain;
    assert!((actual / want - 1.0).abs() < 0.05, "{actual}");
    let small = Reference::read(&path, Some((16, 16))).unwrap();
    assert!((small.noise(0.01) / (want / 16.0) - 1.0).abs() < 0.1);
    let refused = Reference::read(&path, Some((20, 20))).err().unwrap();
    assert!(refused.contains("can't be averaged"), "{refused}");
}

#[test]
fn means_have_standard_errors() {
    assert_eq!(Estimate::of(&[1.0, 2.0, 3.0]), Estimate { mean: 2.0, error: (1.0f64 / 3.0).sqrt() });
    assert!(Estimate::of(&[5.0]).error.is_nan(), "one value knows no error");
}

#[test]
fn check_points_are_geometric_and_reached() {
    assert_eq!(Checks::geometric(4.0, 3), Checks::Seconds(vec![1.0, 2.0, 4.0]));
    let scene = crate::support::scene("furnace-open");
    let options = qtracer::RenderOptions { size: Some((16, 16)), ..qtracer::RenderOptions::cpu() };
    let mut renderer = qtracer::Renderer::new(&scene, options).unwrap();
    let mut seen = Vec::new();
    let checks = Checks::Samples(vec![1, 7, 40]);
    bench::measure::render(&mut renderer, &checks, |point| seen.push((point.samples, point.seconds)))
        .unwrap();
    assert_eq!(seen.iter().map(|s| s.0).collect::<Vec<_>>(), [1, 7, 40]);
    assert!(seen.windows(2).all(|pair| pair[0].1 < pair[1].1), "{seen:?}");
}

fn row(engine: &str, variant: &str, seed: u32, check: u32, error: f64) -> Row {
    Row {
        scene: "a <scene> & \"more\"".to_string(),
        renderer: "qtracer".to_string(),
        engine: engine.to_string(),
        variant: variant.to_string(),
        direct_light: true,
        max_bounces: 64,
        width: 32,
        height: 16,
        seed,
        goal: format!("{} s", 1 << check),
        samples: 10 << check,
        seconds: f64::from(1 << check),
        relative_mse: Some(error),
        trimmed: Some(0.75 * error),
        epsilon: 0.01,
        truth: "independent reference x".to_string(),
        truth_noise: 1.0 / 8192.0,
        device: "a device, with a comma".to_string(),
        ..Row::default()
    }
}

/// Errors are multiples of powers of two, which survive being written and read.
fn rows() -> Vec<Row> {
    let mut rows = Vec::new();
    for seed in 1..4 {
        let by_seed = 1.0 + f64::from(seed) / 8.0;
        rows.push(row("fused", "off:throughput:4", seed, 0, by_seed / 32.0));
        rows.push(row("fused", "off:throughput:4", seed, 1, by_seed / 64.0));
        rows.push(row("fused", "auto", seed, 1, by_seed / 256.0));
        rows.push(Row { direct_light: false, ..row("fused", "auto", seed, 1, 0.125) });
    }
    rows.push(Row { renderer: "mitsuba".to_string(), ..row("llvm_ad_rgb", "off:off", 1, 1, 0.25) });
    rows
}

#[test]
fn rows_survive_a_cut_and_name_what_is_wrong() {
    let all = rows();
    let text: String = all.iter().map(|row| serde_json::to_string(row).unwrap() + "\n").collect();
    assert_eq!(parse(&text, "rows").unwrap(), all);
    let cut = parse(&text[..text.len() - 20], "rows").unwrap();
    assert_eq!(cut, all[..all.len() - 1], "a line that was cut short is left out");
    let broken = text.replacen("\"scene\"", "\"scen\"", 2);
    assert!(parse(&broken, "rows").unwrap_err().starts_with("rows, line 1: "));
    // What a peer may leave out.
    let peer = r#"{"scene":"s","renderer":"m","engine":"e","variant":"off:off","direct_light":true,"max_bounces":64,
        "width":2,"height":2,"seed":1,"goal":"1 s","samples":5,"seconds":0.5,"relative_mse":null}"#;
    assert_eq!(parse(&peer.replace('\n', ""), "peer").unwrap()[0].relative_mse, None);
}

#[test]
fn csv_has_as_many_cells_as_names() {
    let text = csv(&rows());
    let mut lines = text.lines();
    let names = lines.next().unwrap().split(',').count();
    for line in lines {
        let outside_quotes: String = line.split('"').step_by(2).collect();
        assert_eq!(outside_quotes.matches(',').count() + 1, names, "{line}");
    }
}

#[test]
fn rows_become_curves_with_gains() {
    let mut all = rows();
    let speed = Row { relative_mse: None, epsilon: 0.0, ..row("scalar_rgb", "off:off", 1, 0, 0.0) };
    all.push(Row { renderer: "mitsuba".to_string(), ..speed });
    // Measured again: what it gave before does not count.
    all.insert(0, Row { relative_mse: Some(99.0), ..rows()[1].clone() });
    let scenes = summarize(&all);
    assert_eq!(scenes.len(), 1, "speed alone joins its scene");
    let scene = &scenes[0];
    let labels: Vec<&str> = scene.curves.iter().map(|curve| curve.label.as_str()).collect();
    let want = [
        "fused off:throughput:4",
        "fused auto",
        "fused auto, no direct light",
        "mitsuba llvm_ad_rgb off:off",
        "mitsuba scalar_rgb off:off",
    ];
    assert_eq!(labels, want);
    let plain = &scene.curves[0];
    assert_eq!((plain.points.len(), plain.last().seeds, plain.last().seconds), (2, 3, 2.0));
    let efficiency = plain.last().efficiency().unwrap();
    assert!((efficiency.mean - 1.0 / (1.25 / 64.0 * 2.0)).abs() < 1e-9 && efficiency.error > 0.0);
    let gain =
        scene.curves[1].last().efficiency().unwrap().mean / scene.best_plain(&scene.curves[1]).unwrap();
    assert!((gain - 4.0).abs() < 1e-9, "{gain}");
    assert_eq!(scene.best_plain(&scene.curves[2]), None, "plain with direct light is no baseline without");
    assert_eq!(scene.curves[4].last().efficiency(), None);
}

#[test]
fn axes_are_logarithmic_and_numbers_short() {
    let axis = Axis::covering([1.0, 100.0, f64::NAN, -3.0].into_iter(), 0.0, 100.0);
    let middle = axis.at(10.0);
    assert!((middle - 50.0).abs() < 1e-9 && axis.at(1.0) < middle && axis.at(1e9) == 100.0);
    let tens: Vec<f64> = axis.ticks().into_iter().filter(|t| t.1).map(|t| t.0).collect();
    assert_eq!(tens, [1.0, 10.0, 100.0]);
    let single = Axis::covering([3.0].into_iter(), 0.0, 1.0);
    assert!(single.high / single.low >= 3.9, "one value has room about it");
    let cases =
        [(0.5, "0.5"), (1234.5, "1234"), (2e-5, "2e-5"), (99_999.9, "1e5"), (0.0, "0"), (12.345, "12.3")];
    for (value, text) in cases {
        assert_eq!(number(value), text);
    }
    assert_eq!((digits(4e-5), digits(0.5)), ("4.00e-5".to_string(), "0.500".to_string()));
    assert_eq!(machine::date(20_779), "2026-11-22");
    assert_eq!(machine::date(11_016), "2000-02-29");
}

/// Whether a text is well-formed as XML, as far as that goes without a parser: tags nest, attributes are quoted, every `&`
/// begins an entity.
fn well_formed(text: &str) -> Result<(), String> {
    let mut open: Vec<String> = Vec::new();
    let mut rest = text.strip_prefix("<!DOCTYPE html>").ok_or("no doctype")?;
    while let Some(begin) = rest.find('<') {
        check_entities(&rest[..begin])?;
        let end = rest[begin..].find('>').ok_or("a tag has no end")? + begin;
        let tag = &rest[begin + 1..end];
        let name: String = tag.trim_start_matches('/').chars().take_while(|c| c.is_alphanumeric()).collect();
        if name.is_empty() || tag.contains('<') || tag.matches('"').count() % 2 != 0 {
            return Err(format!("no tag: <{tag}>"));
        }
        tag.split('"').skip(1).step_by(2).try_for_each(check_entities)?;
        let unquoted: String = tag.split('"').step_by(2).collect();
        if unquoted
            .split_whitespace()
            .any(|word| word.contains('=') && !word.trim_end_matches('/').ends_with('='))
        {
            return Err(format!("an attribute is not quoted: <{tag}>"));
        }
        if tag.starts_with('/') {
            let opened = open.pop().unwrap_or_default();
            if opened != name {
                return Err(format!("<{opened}> is closed by </{name}>"));
            }
        } else if !tag.ends_with('/') {
            open.push(name);
        }
        rest = &rest[end + 1..];
    }
    if open.is_empty() { Ok(()) } else { Err(format!("never closed: {open:?}")) }
}

fn check_entities(text: &str) -> Result<(), String> {
    let known = |after: &str| ["amp;", "lt;", "gt;", "quot;"].iter().any(|entity| after.starts_with(entity));
    match text.split('&').skip(1).find(|after| !known(after)) {
        Some(after) => Err(format!("a bare & before {:.20}", after)),
        None => Ok(()),
    }
}

#[test]
fn the_page_is_well_formed_and_needs_nothing_else() {
    let html = page::html("A <title> & more", &rows());
    well_formed(&html).unwrap();
    for foreign in ["http://", "https://", "<script", "@import", "<link", "url("] {
        assert!(!html.contains(foreign), "{foreign}");
    }
    assert_eq!(html.matches("<svg class=\"chart\"").count(), 2);
    assert!(html.contains(&escape("a <scene> & \"more\"")) && !html.contains("a <scene>"));
    assert!(html.contains("efficiency") && html.contains("prefers-color-scheme: dark"));
    // Controls: the same page with faults.
    for (from, to) in [("</svg>", ""), ("&amp;", "&"), ("class=\"n\"", "class=n"), ("<td>", "<td")] {
        assert!(well_formed(&html.replacen(from, to, 1)).is_err(), "{from} instead of {to} was not seen");
    }
}

#[test]
fn the_markdown_tables_are_whole() {
    let text = page::markdown("Speed against error", &rows());
    let lines: Vec<&str> = text.lines().filter(|line| line.starts_with('|')).collect();
    assert_eq!(lines.len(), 2 + 4 + 2 + 5);
    for table in [&lines[..6], &lines[6..]] {
        let bars = |line: &str| line.matches('|').count();
        assert!(table.iter().all(|line| bars(line) == bars(table[0])), "{text}");
    }
    assert!(
        lines[2].contains("fused auto") && lines[2].contains("4.00 ×"),
        "the most efficient first:\n{text}"
    );
}
