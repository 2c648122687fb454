//! The report: a page that needs nothing but itself, and its tables in Markdown.

use super::chart::{Chart, FORMS, HUES, Line, Look, Mark, digits, escape, number, swatch};
use super::rows::Row;
use super::summary::{Curve, Estimate, Point, SceneSummary, summarize};
use std::collections::BTreeSet;
use std::fmt::Write;

const STYLE: &str = include_str!("page.css");

/// A page of plots and tables, complete in itself.
pub fn html(title: &str, rows: &[Row]) -> String {
    let scenes = summarize(rows);
    let looks = Looks::of(&scenes);
    let mut page = String::new();
    let heading = escape(title);
    let _ = write!(
        page,
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
         <meta name=\"color-scheme\" content=\"light dark\"/>\n<title>{heading}</title>\n<style>\n{STYLE}</style>\n\
         </head>\n<body>\n<header>\n<h1>{heading}</h1>\n{}</header>\n<main>\n",
        provenance(rows)
    );
    page.push_str(&overview(&scenes));
    for (at, scene) in scenes.iter().enumerate() {
        page.push_str(&section(at, scene, &looks));
    }
    page.push_str(HOW_TO_READ);
    page.push_str("</main>\n</body>\n</html>\n");
    page
}

/// The tables as Markdown.
pub fn markdown(title: &str, rows: &[Row]) -> String {
    let scenes = summarize(rows);
    let mut text = format!("# {title}\n\n");
    for line in machines(rows) {
        let _ = writeln!(text, "- {line}");
    }
    for scene in &scenes {
        let _ = write!(text, "\n## {}\n\n{}\n\n", scene.name, about(scene));
        let names = COLUMNS.map(|(name, _)| name);
        let _ = writeln!(text, "| {} |\n|{}", names.join(" | "), "---|".repeat(names.len()));
        for curve in ranked(scene) {
            let _ = writeln!(text, "| {} |", cells(scene, curve).join(" | "));
        }
        let _ =
            write!(text, "\nAll check points:\n\n| {} |\n|{}\n", POINT_COLUMNS.join(" | "), "---|".repeat(6));
        for cells in all_points(scene) {
            let _ = writeln!(text, "| {} |", cells.join(" | "));
        }
    }
    text
}

const HOW_TO_READ: &str = "<section id=\"reading\">\n<h2>How to read this</h2>\n\
<p>Every curve is one way to render: <b>engine</b> <b>guide</b>:<b>roulette</b>:<b>scale</b>. Colour tells the guide and \
roulette, the form of the marks the engine, a dashed line that lights are not sampled directly; grey is another renderer. A \
mark is the mean over the seeds at one check point, the upright line through it one standard error of that mean; point at it \
for its numbers.</p>\n\
<p>Both axes are logarithmic, so Monte Carlo error falls along the slanted grey lines: <b>all points on one of them are equally \
efficient</b>, and a curve that lies one line lower reaches the same error in a tenth of the time. A curve that is steeper \
than they are is still learning.</p>\n\
<p><b>relMSE</b> is the mean over pixels and channels of (image − reference)² / (reference² + ε), minus what the reference's own \
noise makes of it. That noise is the dotted line: far below it, errors are differences of nearly equal numbers. \
<b>Trimmed</b> leaves out the worst 0.1 % of the pixels, which single bright paths otherwise rule. <b>Efficiency</b> is \
1/(relMSE · seconds), at the last check point. <b>Gain</b> is against the best plain qtracer curve (no guide, nothing learnt) \
on the same device with the same direct light. <b>Time</b> runs from the first sample, learning included; \
reading the scene and compiling kernels are not in it.</p>\n</section>\n";

/// Names of a table's columns, and whether they hold numbers.
const COLUMNS: [(&str, bool); 9] = [
    ("renderer and variant", false),
    ("seeds", true),
    ("samples/pixel", true),
    ("seconds", true),
    ("Msamples/s", true),
    ("relMSE", true),
    ("trimmed", true),
    ("efficiency", true),
    ("gain", true),
];

/// The cells of a curve's last check point.
fn cells(scene: &SceneSummary, curve: &Curve) -> [String; 9] {
    let point = curve.last();
    let gain = || Some(point.efficiency()?.mean / scene.best_plain(curve)?);
    [
        curve.label.clone(),
        point.seeds.to_string(),
        format!("{:.0}", point.samples),
        digits(point.seconds),
        digits(point.megasamples_per_second),
        with_error(point.error),
        with_error(point.trimmed),
        with_error(point.efficiency()),
        gain().map_or("–".to_string(), |gain| format!("{gain:.2} ×")),
    ]
}

const POINT_COLUMNS: [&str; 6] =
    ["renderer and variant", "samples/pixel", "seconds", "relMSE", "trimmed", "efficiency"];

/// A row for each mark of the plots, for those who can't point at one.
fn all_points(scene: &SceneSummary) -> Vec<[String; 6]> {
    let cells = |curve: &Curve, point: &Point| {
        [
            curve.label.clone(),
            format!("{:.0}", point.samples),
            digits(point.seconds),
            with_error(point.error),
            with_error(point.trimmed),
            with_error(point.efficiency()),
        ]
    };
    let all =
        ranked(scene).into_iter().flat_map(|curve| curve.points.iter().map(move |point| (curve, point)));
    all.map(|(curve, point)| cells(curve, point)).collect()
}

fn with_error(estimate: Option<Estimate>) -> String {
    match estimate {
        None => "–".to_string(),
        Some(Estimate { mean, error }) if error.is_finite() => {
            format!("{} ± {}", digits(mean), two_digits(error))
        }
        Some(Estimate { mean, .. }) => digits(mean),
    }
}

/// An error rounded to two digits, as is the custom.
fn two_digits(error: f64) -> String {
    if error == 0.0 {
        return "0".to_string();
    }
    let unit = 10f64.powi(error.abs().log10().floor() as i32 - 1);
    number((error / unit).round() * unit)
}

/// Curves by efficiency, the best first; those without come last.
fn ranked(scene: &SceneSummary) -> Vec<&Curve> {
    let efficiency = |curve: &Curve| curve.last().efficiency().map_or(0.0, |e| e.mean);
    let mut curves: Vec<&Curve> = scene.curves.iter().collect();
    curves.sort_by(|a, b| efficiency(b).total_cmp(&efficiency(a)));
    curves
}

/// Devices, drivers, commits and days of the rows, a line for each.
fn machines(rows: &[Row]) -> BTreeSet<String> {
    let line = |row: &Row| {
        let driver = if row.driver.is_empty() { String::new() } else { format!(", {}", row.driver) };
        format!("{}: {}{driver}; {}; {}", row.renderer, row.device, version(row), known(&row.date))
    };
    rows.iter().map(line).collect()
}

/// A peer's rows have its name and version for a commit.
fn version(row: &Row) -> String {
    if row.renderer == "qtracer" {
        format!("commit {}", known(&row.commit))
    } else {
        known(&row.commit).to_string()
    }
}

fn known(text: &str) -> &str {
    if text.is_empty() { "unknown" } else { text }
}

fn provenance(rows: &[Row]) -> String {
    let lines: Vec<String> = machines(rows).iter().map(|line| format!("<li>{}</li>", escape(line))).collect();
    format!("<ul class=\"machines\">{}</ul>\n", lines.join(""))
}

fn about(scene: &SceneSummary) -> String {
    let truths: Vec<&str> = scene.truths.iter().map(String::as_str).collect();
    let size = format!("{} × {} pixels", scene.width, scene.height);
    if truths.is_empty() {
        return format!("{size}; speed alone was measured.");
    }
    let noise = match scene.truth_noise {
        0.0 => "which sees no error that all seeds have in common".to_string(),
        noise => format!("whose own noise is a relMSE of {}, already taken off", number(noise)),
    };
    format!("{size}; errors against {}, {noise}; ε = {}.", truths.join(" and "), number(scene.epsilon))
}

/// What each scene says in one line: the best, the best plain, the best peer.
fn overview(scenes: &[SceneSummary]) -> String {
    let mut html = String::from(
        "<section id=\"overview\">\n<h2>At a glance</h2>\n<div class=\"wide\"><table>\n<thead><tr><th>scene</th>\
         <th>most efficient</th><th class=\"n\">efficiency</th><th class=\"n\">× best plain</th>\
         <th class=\"n\">× best peer</th></tr></thead>\n<tbody>\n",
    );
    for (at, scene) in scenes.iter().enumerate() {
        let all = ranked(scene);
        let efficiency = |curve: &Curve| curve.last().efficiency();
        let best = all.iter().find(|curve| !curve.is_peer() && efficiency(curve).is_some());
        let peer = all.iter().filter(|curve| curve.is_peer()).find_map(|curve| efficiency(curve));
        let Some((best, value)) = best.and_then(|curve| Some((curve, efficiency(curve)?))) else { continue };
        let times = |other: Option<f64>| {
            other.map_or("–".to_string(), |other| format!("{:.2}", value.mean / other))
        };
        let _ = writeln!(
            html,
            "<tr><td><a href=\"#scene{at}\">{}</a></td><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td>\
             <td class=\"n\">{}</td></tr>",
            escape(&scene.name),
            escape(&best.label),
            with_error(Some(value)),
            times(scene.best_plain(best)),
            times(peer.map(|peer| peer.mean)),
        );
    }
    html.push_str("</tbody>\n</table></div>\n<p>Efficiency is 1/(relMSE · seconds); <a href=\"#reading\">how to read this</a>.</p>\n</section>\n");
    html
}

fn section(at: usize, scene: &SceneSummary, looks: &Looks) -> String {
    let mut html = format!(
        "<section id=\"scene{at}\">\n<h2>{}</h2>\n<p>{}</p>\n",
        escape(&scene.name),
        escape(&about(scene))
    );
    if scene.curves.iter().any(|curve| curve.points.iter().any(|point| point.error.is_some())) {
        let by = |x: fn(&Point) -> f64, name: &str, key: &str| {
            chart(scene, looks, format!("{key}{at}"), name, x).svg()
        };
        let _ = write!(
            html,
            "<div class=\"plots\">\n<figure><figcaption>Error over time</figcaption>{}</figure>\n\
             <figure><figcaption>Error over samples</figcaption>{}</figure>\n</div>\n",
            by(|point| point.seconds, "seconds", "time"),
            by(|point| point.samples, "samples per pixel", "samples"),
        );
    }
    html.push_str(&table(scene, looks));
    html.push_str(&details(scene));
    html.push_str("</section>\n");
    html
}

fn chart(scene: &SceneSummary, looks: &Looks, id: String, x_name: &str, x: fn(&Point) -> f64) -> Chart {
    let mark = |point: &Point| {
        let error = point.error?;
        let title = format!(
            "{:.0} samples per pixel, {} s\nrelMSE {}\ntrimmed {}\nefficiency {}",
            point.samples,
            number(point.seconds),
            with_error(Some(error)),
            with_error(point.trimmed),
            with_error(point.efficiency()),
        );
        Some(Mark { x: x(point), y: error.mean, spread: error.error, title })
    };
    let line = |curve: &Curve| Line {
        label: curve.label.clone(),
        look: looks.look(curve),
        marks: curve.points.iter().filter_map(mark).collect(),
    };
    let floor = (scene.truth_noise > 0.0)
        .then(|| (scene.truth_noise, format!("the reference's own noise, {}", number(scene.truth_noise))));
    Chart {
        id,
        title: format!(
            "{}: relMSE over {x_name}, logarithmic axes; the table below has the numbers",
            scene.name
        ),
        x_name: x_name.to_string(),
        y_name: "relMSE".to_string(),
        lines: scene.curves.iter().map(line).collect(),
        floor,
    }
}

/// The legend and the numbers in one: a swatch begins each row, a bar shows its efficiency.
fn table(scene: &SceneSummary, looks: &Looks) -> String {
    let heads = COLUMNS.map(|(name, is_number)| match is_number {
        true => format!("<th class=\"n\">{name}</th>"),
        false => format!("<th>{name}</th>"),
    });
    let mut html = format!(
        "<div class=\"wide\"><table>\n<thead><tr><th></th>{}</tr></thead>\n<tbody>\n",
        heads.concat()
    );
    let curves = ranked(scene);
    let efficiency = |curve: &Curve| curve.last().efficiency().map_or(0.0, |e| e.mean);
    let most = curves.iter().map(|curve| efficiency(curve)).fold(0.0, f64::max);
    for curve in curves {
        let _ = write!(html, "<tr><td>{}</td>", swatch(&looks.look(curve)));
        for (cell, (name, is_number)) in cells(scene, curve).iter().zip(COLUMNS) {
            let cell = escape(cell);
            let share = 100.0 * efficiency(curve) / most;
            let _ = match (name, is_number) {
                ("efficiency", _) if share > 0.0 => {
                    write!(html, "<td class=\"n bar\" style=\"background-size:{share:.0}% 100%\">{cell}</td>")
                }
                (_, true) => write!(html, "<td class=\"n\">{cell}</td>"),
                (_, false) => write!(html, "<td class=\"label\">{cell}</td>"),
            };
        }
        html.push_str("</tr>\n");
    }
    html.push_str("</tbody>\n</table></div>\n");
    html
}

/// All check points, folded away.
fn details(scene: &SceneSummary) -> String {
    let class = |at: usize| if at == 0 { "" } else { " class=\"n\"" };
    let row = |cells: &[String], tag: &str| {
        let cells = cells
            .iter()
            .enumerate()
            .map(|(at, cell)| format!("<{tag}{}>{}</{tag}>", class(at), escape(cell)));
        format!("<tr>{}</tr>\n", cells.collect::<String>())
    };
    let body: String = all_points(scene).iter().map(|cells| row(cells, "td")).collect();
    format!(
        "<details><summary>All check points as numbers</summary>\n<div class=\"wide\"><table>\n<thead>{}</thead>\n\
         <tbody>\n{body}</tbody>\n</table></div></details>\n",
        row(&POINT_COLUMNS.map(str::to_string), "th"),
    )
}

/// How curves look, the same in all scenes: colours by variant, marks by engine, peers grey.
struct Looks {
    variants: Vec<String>,
    engines: Vec<String>,
    peers: Vec<String>,
}

impl Looks {
    fn of(scenes: &[SceneSummary]) -> Looks {
        let curves = || scenes.iter().flat_map(|scene| &scene.curves);
        let in_order = |names: Vec<String>| {
            let mut seen = Vec::new();
            names.into_iter().for_each(|name| {
                if !seen.contains(&name) {
                    seen.push(name)
                }
            });
            seen
        };
        let own = || curves().filter(|curve| !curve.is_peer());
        Looks {
            variants: in_order(own().map(|curve| curve.variant.clone()).collect()),
            engines: in_order(own().map(|curve| format!("{} {}", engine(curve), curve.device)).collect()),
            peers: in_order(curves().filter(|curve| curve.is_peer()).map(peer).collect()),
        }
    }

    fn look(&self, curve: &Curve) -> Look {
        let place =
            |names: &[String], name: String| names.iter().position(|other| *other == name).unwrap_or(0);
        let dashed = !curve.direct_light;
        if curve.is_peer() {
            return Look {
                class: "peer".to_string(),
                form: (place(&self.peers, peer(curve)) + 1) % FORMS,
                dashed,
            };
        }
        let class = format!("hue{}", place(&self.variants, curve.variant.clone()) % HUES);
        Look {
            class,
            form: place(&self.engines, format!("{} {}", engine(curve), curve.device)) % FORMS,
            dashed,
        }
    }
}

/// `auto` took one engine here and another there: it is one way all the same.
fn engine(curve: &Curve) -> &str {
    curve.engine.split(' ').next().unwrap_or_default()
}

fn peer(curve: &Curve) -> String {
    format!("{} {} {}", curve.renderer, curve.engine, curve.variant)
}
