//! Parsers of option values. Each refusal says what would be accepted; clap adds which option it was.

use clap::ValueEnum;
use qtracer::guiding::MAX_MIXTURE;
use qtracer::scene::check_image_size;
use std::time::Duration;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    On,
    Off,
}

impl From<Switch> for bool {
    fn from(switch: Switch) -> bool {
        switch == Switch::On
    }
}

/// A whole number from 1 on.
pub fn count(text: &str) -> Result<u32, String> {
    match text.trim().parse::<u64>() {
        Ok(0) => Err("must be at least 1".to_string()),
        Ok(value) => u32::try_from(value).map_err(|_| format!("must be at most {}", u32::MAX)),
        Err(_) => Err("give a whole number from 1 on, such as 64".to_string()),
    }
}

/// `WIDTHxHEIGHT`.
pub fn size(text: &str) -> Result<(u32, u32), String> {
    let form = || "give WIDTHxHEIGHT in pixels, such as 640x480".to_string();
    let (width, height) = text.split_once(['x', 'X', '×']).ok_or_else(form)?;
    let side = |text: &str| text.trim().parse::<u64>().map_err(|_| form());
    check_image_size(side(width)?, side(height)?).map_err(|e| e.to_string())
}

/// A number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("give a number above 0, such as 0.01".to_string()),
    }
}

/// A number from 0 on.
pub fn not_negative(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        _ => Err("give a number from 0 on, such as 0.01".to_string()),
    }
}

/// A length above 0 that f32 can hold.
pub fn length(text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("give a length above 0, in scene units, such as 0.5".to_string()),
    }
}

/// A factor above 0 that f32 can hold.
pub fn factor(text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("give a number above 0, such as 2".to_string()),
    }
}

/// A share, 0 and 1 included.
pub fn share(text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(value) if (0.0..=1.0).contains(&value) => Ok(value),
        _ => Err("give a number from 0 to 1, such as 0.75".to_string()),
    }
}

/// A share of guided directions.
pub fn mixture(text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(value) if (0.0..=MAX_MIXTURE).contains(&value) => Ok(value),
        _ => Err(format!("give a number from 0 to {MAX_MIXTURE}, such as 0.5")),
    }
}

/// `4096`, `64K`, `256M`, `1.5G`, also `256MiB`: above 0.
pub fn bytes(text: &str) -> Result<u64, String> {
    let form = || "give a number of bytes above 0, such as 256M or 2G".to_string();
    let text = text.trim();
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let value: f64 = text[..digits].parse().map_err(|_| form())?;
    let unit = match text[digits..].trim().to_ascii_uppercase().as_str() {
        "" | "B" => 0,
        "K" | "KB" | "KIB" => 10,
        "M" | "MB" | "MIB" => 20,
        "G" | "GB" | "GIB" => 30,
        "T" | "TB" | "TIB" => 40,
        _ => return Err(form()),
    };
    match value * f64::powi(2.0, unit) {
        bytes if (1.0..=f64::powi(2.0, 60)).contains(&bytes) => Ok(bytes as u64),
        _ => Err(form()),
    }
}

/// A probability that is neither 0 nor 1.
pub fn probability(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(value) if value > 0.0 && value < 1.0 => Ok(value),
        _ => Err("give a number between 0 and 1, such as 0.01".to_string()),
    }
}

/// Powers of two that an 8-bit picture can still show.
pub fn stops(text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(value) if (-64.0..=64.0).contains(&value) => Ok(value),
        _ => Err("give stops from -64 to 64, such as -1.5".to_string()),
    }
}

/// Ten years: longer than any render, short enough for every clock.
const LONGEST_SECONDS: f64 = 315_576_000.0;

/// `90`, `90s`, `2m`, `1.5h`, `1m30s`: above 0.
pub fn duration(text: &str) -> Result<Duration, String> {
    let form = || "give a time above 0, such as 90s, 2m, 1m30s or 1.5h".to_string();
    let mut seconds = 0.0;
    let mut rest = text.trim();
    let mut largest_unit = f64::INFINITY;
    while !rest.is_empty() {
        let digits = rest.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(rest.len());
        let value: f64 = rest[..digits].parse().map_err(|_| form())?;
        let tail = &rest[digits..];
        let letters = tail.find(|c: char| !c.is_alphabetic()).unwrap_or(tail.len());
        let unit = unit_seconds(&tail[..letters]).ok_or_else(form)?;
        if unit >= largest_unit {
            return Err(form());
        }
        largest_unit = unit;
        seconds += value * unit;
        rest = tail[letters..].trim_start();
    }
    match seconds {
        s if s > LONGEST_SECONDS => Err("is longer than ten years; use --spp".to_string()),
        s if s > 0.0 => Ok(Duration::from_secs_f64(s)),
        _ => Err(form()),
    }
}

fn unit_seconds(unit: &str) -> Option<f64> {
    match unit {
        "ms" => Some(1e-3),
        "" | "s" => Some(1.0),
        "m" | "min" => Some(60.0),
        "h" => Some(3600.0),
        _ => None,
    }
}

/// A part of an adapter's name.
pub fn adapter(text: &str) -> Result<String, String> {
    match text.trim() {
        "" => Err("give a part of a GPU's name; `qtracer info` lists them".to_string()),
        name => Ok(name.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_read_in_all_the_forms_that_help_names() {
        let seconds = |text| duration(text).map(|d| d.as_secs_f64());
        for (text, expected) in [
            ("90", 90.0),
            ("90s", 90.0),
            ("2m", 120.0),
            ("1.5h", 5400.0),
            ("1m30s", 90.0),
            ("1h 1m 1s", 3661.0),
            ("250ms", 0.25),
        ] {
            assert_eq!(seconds(text), Ok(expected), "{text}");
        }
    }

    #[test]
    fn no_duration_is_zero_negative_endless_or_garbage() {
        for text in
            ["", "0", "0s", "-5", "nan", "inf", "1e3", "s", "5x", "1s1m", "1.2.3", "é", "5µ", "99999999999h"]
        {
            assert!(duration(text).is_err(), "{text}");
        }
    }

    #[test]
    fn bytes_are_counted_in_powers_of_1024() {
        for (text, expected) in [
            ("1", 1),
            ("4096", 4096),
            ("64k", 64 << 10),
            ("256M", 256 << 20),
            ("1.5 GiB", 3 << 29),
            ("2GB", 2 << 30),
        ] {
            assert_eq!(bytes(text), Ok(expected), "{text}");
        }
        for text in ["", "0", "0.1", "-1", "M", "1X", "1.2.3M", "nan", "inf", "1e9", "9999999T", "é"] {
            assert!(bytes(text).is_err(), "{text}");
        }
    }

    #[test]
    fn sizes_need_two_sides_that_fit_in_memory() {
        assert_eq!(size("640x480"), Ok((640, 480)));
        assert_eq!(size("16 × 9"), Ok((16, 9)));
        for text in ["", "640", "x", "0x10", "-1x5", "1000000x1000000", "1x99999999999999999999"] {
            assert!(size(text).is_err(), "{text}");
        }
        assert!(size("65536x65536").unwrap_err().contains("bytes"));
    }

    #[test]
    fn numbers_must_be_finite_and_in_range() {
        for text in ["nan", "inf", "-1", "", "x"] {
            assert!(positive(text).is_err() && not_negative(text).is_err(), "{text}");
            assert!(probability(text).is_err() && count(text).is_err(), "{text}");
        }
        for text in ["nan", "inf", "-1", "", "x", "1e99"] {
            assert!(length(text).is_err() && factor(text).is_err(), "{text}");
            assert!(share(text).is_err() && mixture(text).is_err(), "{text}");
        }
        assert!(length("0").is_err() && factor("0").is_err() && share("0").is_ok() && share("1").is_ok());
        assert!(share("1.01").is_err() && mixture("0.95").is_ok() && mixture("0.96").is_err());
        assert!(positive("0").is_err() && not_negative("0").is_ok() && probability("1").is_err());
        assert!(count("0").is_err() && count("4294967296").is_err() && count("1").is_ok());
        assert!(stops("nan").is_err() && stops("65").is_err() && stops("-2.5").is_ok());
    }
}
