//! A chart with two logarithmic axes as SVG text. Colours, light and dark, come from the page's style sheet by class, and every
//! mark says its numbers when pointed at.

use std::fmt::Write;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 48.0;

/// Kinds of colours that the style sheet has, `hue0` …; the class `peer` is one more.
pub const HUES: usize = 8;
/// Forms of marks.
pub const FORMS: usize = 6;

/// How a curve looks: a class of the style sheet, the form of its marks, whether its line is dashed.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    pub class: String,
    pub form: usize,
    pub dashed: bool,
}

/// A measured point; `spread` is one standard error of y.
#[derive(Clone, Debug)]
pub struct Mark {
    pub x: f64,
    pub y: f64,
    pub spread: f64,
    /// What it says when pointed at.
    pub title: String,
}

pub struct Line {
    pub label: String,
    pub look: Look,
    pub marks: Vec<Mark>,
}

pub struct Chart {
    /// Unique in its page.
    pub id: String,
    /// For readers who don't see it.
    pub title: String,
    pub x_name: String,
    pub y_name: String,
    pub lines: Vec<Line>,
    /// A horizontal line at this y, and what it is.
    pub floor: Option<(f64, String)>,
}

/// Text for SVG and HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A logarithmic axis: values from `low` to `high` to pixels from `begin` to `end`.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    pub low: f64,
    pub high: f64,
    begin: f64,
    end: f64,
}

impl Axis {
    /// Covers the positive ones of `values` with some room at both ends.
    pub fn covering(values: impl Iterator<Item = f64>, begin: f64, end: f64) -> Axis {
        let (mut low, mut high) = (f64::MAX, 0.0f64);
        for value in values.filter(|value| value.is_finite() && *value > 0.0) {
            (low, high) = (low.min(value), high.max(value));
        }
        if high == 0.0 {
            (low, high) = (0.1, 10.0);
        }
        // At least a factor of four is seen, so that little noise does not look like much.
        let room = (high / low).powf(0.06).max(2.0 / (high / low).sqrt()).max(1.15);
        Axis { low: low / room, high: high * room, begin, end }
    }

    /// Where a value lies; what is off the axis lies at its end.
    pub fn at(&self, value: f64) -> f64 {
        let share = (value.clamp(self.low, self.high) / self.low).ln() / (self.high / self.low).ln();
        self.begin + share * (self.end - self.begin)
    }

    /// Values to mark, and whether they are powers of ten.
    pub fn ticks(&self) -> Vec<(f64, bool)> {
        let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let digits = decades.flat_map(|decade| (1..10).map(move |digit| (digit, decade)));
        let values = digits.map(|(digit, decade)| (f64::from(digit) * 10f64.powi(decade), digit == 1));
        values.filter(|(value, _)| (self.low..=self.high).contains(value)).collect()
    }

    /// Whether a tick gets its number: powers of ten; 2 and 5 as well where there are few of them.
    fn is_labelled(&self, value: f64, decade: bool) -> bool {
        let digit = (value / 10f64.powi(value.log10().floor() as i32)).round();
        let decades = (self.high / self.low).log10();
        decade || (decades < 2.5 && (digit == 2.0 || digit == 5.0)) || (decades < 0.7 && digit == 3.0)
    }
}

/// A number to three digits.
pub fn digits(value: f64) -> String {
    let size = value.abs();
    if !value.is_finite() {
        "–".to_string()
    } else if size == 0.0 {
        "0".to_string()
    } else if !(0.001..99_999.5).contains(&size) {
        // Rounding may carry into another decade: the formatter knows.
        format!("{value:.2e}")
    } else {
        let decimals = (2 - size.log10().floor() as i32).max(0) as usize;
        format!("{value:.decimals$}")
    }
}

/// The same without needless zeros: 0.5 instead of 0.500.
pub fn number(value: f64) -> String {
    let text = digits(value);
    let (mantissa, exponent) = text.find('e').map_or((text.as_str(), ""), |at| text.split_at(at));
    let mantissa = match mantissa.contains('.') {
        true => mantissa.trim_end_matches('0').trim_end_matches('.'),
        false => mantissa,
    };
    format!("{mantissa}{exponent}")
}

impl Chart {
    pub fn svg(&self) -> String {
        let marks = || self.lines.iter().flat_map(|line| &line.marks);
        let x = Axis::covering(marks().map(|mark| mark.x), LEFT, WIDTH - RIGHT);
        let tops = marks().map(|mark| mark.y + if mark.spread.is_finite() { mark.spread } else { 0.0 });
        let y = Axis::covering(marks().map(|mark| mark.y).chain(tops), HEIGHT - BOTTOM, TOP);
        let mut svg = String::new();
        let (id, title) = (&self.id, escape(&self.title));
        let _ = write!(
            svg,
            "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-labelledby=\"{id}\">\
             <title id=\"{id}\">{title}</title>"
        );
        self.draw_grid(&mut svg, &x, &y);
        self.draw_floor(&mut svg, &y);
        for line in &self.lines {
            draw_line(&mut svg, line, &x, &y);
        }
        svg.push_str("</svg>\n");
        svg
    }

    fn draw_grid(&self, svg: &mut String, x: &Axis, y: &Axis) {
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for (value, decade) in x.ticks() {
            let (at, class) = (x.at(value), if decade { "decade" } else { "minor" });
            let _ = write!(svg, "<path class=\"{class}\" d=\"M{at:.1} {TOP}V{bottom}\"/>");
            if x.is_labelled(value, decade) {
                let below = bottom + 17.0;
                let text = number(value);
                let _ = write!(
                    svg,
                    "<text class=\"tick\" text-anchor=\"middle\" x=\"{at:.1}\" y=\"{below}\">{text}</text>"
                );
            }
        }
        for (value, decade) in y.ticks() {
            let (at, class) = (y.at(value), if decade { "decade" } else { "minor" });
            let _ = write!(svg, "<path class=\"{class}\" d=\"M{LEFT} {at:.1}H{right}\"/>");
            if y.is_labelled(value, decade) {
                let (beside, base, text) = (LEFT - 7.0, at + 4.0, number(value));
                let _ = write!(
                    svg,
                    "<text class=\"tick\" text-anchor=\"end\" x=\"{beside}\" y=\"{base:.1}\">{text}</text>"
                );
            }
        }
        draw_diagonals(svg, x, y);
        let (middle, below) = ((LEFT + right) / 2.0, HEIGHT - 8.0);
        let (x_name, y_name) = (escape(&self.x_name), escape(&self.y_name));
        let _ = write!(
            svg,
            "<text class=\"name\" text-anchor=\"middle\" x=\"{middle}\" y=\"{below}\">{x_name}</text>"
        );
        let height = (TOP + bottom) / 2.0;
        let _ = write!(
            svg,
            "<text class=\"name\" text-anchor=\"middle\" transform=\"translate(14 {height}) rotate(-90)\">{y_name}</text>"
        );
    }

    fn draw_floor(&self, svg: &mut String, y: &Axis) {
        let Some((value, title)) = &self.floor else { return };
        if (y.low..=y.high).contains(value) {
            let (at, right, title) = (y.at(*value), WIDTH - RIGHT, escape(title));
            let _ = write!(
                svg,
                "<path class=\"floor\" d=\"M{LEFT} {at:.1}H{right}\"><title>{title}</title></path>"
            );
        }
    }
}

/// Lines of equal x·y, one per decade: all points on one are equally efficient.
fn draw_diagonals(svg: &mut String, x: &Axis, y: &Axis) {
    let products = (x.low * y.low).log10().ceil() as i32..=(x.high * y.high).log10().floor() as i32;
    for product in products.map(|decade| 10f64.powi(decade)) {
        let from = x.low.max(product / y.high);
        let to = x.high.min(product / y.low);
        let [x1, y1, x2, y2] = [x.at(from), y.at(product / from), x.at(to), y.at(product / to)];
        let _ = write!(svg, "<path class=\"equal\" d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\"/>");
    }
}

fn draw_line(svg: &mut String, line: &Line, x: &Axis, y: &Axis) {
    let Look { class, form, dashed } = &line.look;
    let marks: Vec<&Mark> = line.marks.iter().filter(|mark| mark.x > 0.0 && mark.y > 0.0).collect();
    if marks.is_empty() {
        return;
    }
    let corners: Vec<String> = marks.iter().map(|m| format!("{:.1} {:.1}", x.at(m.x), y.at(m.y))).collect();
    let dash = if *dashed { " dashed" } else { "" };
    let _ =
        write!(svg, "<g class=\"curve {class}{dash}\"><path class=\"line\" d=\"M{}\"/>", corners.join("L"));
    for mark in marks {
        let (at_x, at_y) = (x.at(mark.x), y.at(mark.y));
        if mark.spread.is_finite() {
            let (top, bottom) = (y.at(mark.y + mark.spread), y.at((mark.y - mark.spread).max(y.low)));
            let _ = write!(svg, "<path class=\"spread\" d=\"M{at_x:.1} {top:.1}V{bottom:.1}\"/>");
        }
        let title = format!("{}\n{}", escape(&line.label), escape(&mark.title));
        let _ = write!(
            svg,
            "<path class=\"mark\" d=\"{}\"><title>{title}</title></path>",
            form_path(*form, at_x, at_y)
        );
    }
    svg.push_str("</g>");
}

/// The outline of a mark about a point.
fn form_path(form: usize, x: f64, y: f64) -> String {
    let corners: &[(f64, f64)] = match form % FORMS {
        0 => return format!("M{:.1} {y:.1}a4.2 4.2 0 1 0 8.4 0a4.2 4.2 0 1 0 -8.4 0z", x - 4.2),
        1 => &[(-3.8, -3.8), (3.8, -3.8), (3.8, 3.8), (-3.8, 3.8)],
        2 => &[(0.0, -5.2), (4.8, 3.6), (-4.8, 3.6)],
        3 => &[(0.0, -5.4), (5.4, 0.0), (0.0, 5.4), (-5.4, 0.0)],
        4 => &[(0.0, 5.2), (-4.8, -3.6), (4.8, -3.6)],
        _ => &[(-4.6, 0.0), (-2.3, -4.4), (2.3, -4.4), (4.6, 0.0), (2.3, 4.4), (-2.3, 4.4)],
    };
    let corners: Vec<String> =
        corners.iter().map(|(dx, dy)| format!("{:.1} {:.1}", x + dx, y + dy)).collect();
    format!("M{}z", corners.join("L"))
}

/// A piece of line with its mark, for a legend.
pub fn swatch(look: &Look) -> String {
    let (class, dash) = (&look.class, if look.dashed { " dashed" } else { "" });
    format!(
        "<svg class=\"swatch\" viewBox=\"0 0 34 14\" aria-hidden=\"true\"><g class=\"curve {class}{dash}\">\
         <path class=\"line\" d=\"M1 7H33\"/><path class=\"mark\" d=\"{}\"/></g></svg>",
        form_path(look.form, 17.0, 7.0)
    )
}
