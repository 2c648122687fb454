//! Where and when a row was measured, and of which code.

use qtracer::gpu::device::list_adapters;
use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

/// Commit of the working tree that the bench runs in, with a `+` where files differ from it; empty where git knows none.
pub fn commit() -> String {
    let git = |arguments: &[&str]| {
        let output =
            Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_string())
    };
    let Some(commit) = git(&["rev-parse", "--short=9", "HEAD"]) else { return String::new() };
    let changed =
        git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|text| !text.is_empty());
    if changed { format!("{commit}+") } else { commit }
}

/// Name and driver of what a renderer runs on: of the adapter, or of the processor.
pub fn device_and_driver(renderer_device: &str) -> (String, String) {
    match list_adapters().into_iter().find(|adapter| adapter.name == renderer_device) {
        Some(adapter) => (adapter.name, format!("{} {}", adapter.backend, adapter.driver)),
        None => (format!("{}, {} threads", processor(), threads()), String::new()),
    }
}

fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = text.lines().find_map(|line| line.strip_prefix("model name")?.split(": ").nth(1));
    model.map_or("CPU".to_string(), |model| model.split_whitespace().collect::<Vec<_>>().join(" "))
}

/// Today in UTC, as 2026-11-22.
pub fn today() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    date(seconds / 86_400)
}

/// The day that many days after 1 January 1970, by the rules of the Gregorian calendar.
pub fn date(mut days: u64) -> String {
    let leap = |year: u64| (year.is_multiple_of(4) && !year.is_multiple_of(100)) || year.is_multiple_of(400);
    let mut year = 1970;
    while days >= 365 + u64::from(leap(year)) {
        days -= 365 + u64::from(leap(year));
        year += 1;
    }
    let lengths = [31, 28 + u64::from(leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let mut month = 0;
    while days >= lengths[month] {
        days -= lengths[month];
        month += 1;
    }
    format!("{year}-{:02}-{:02}", month + 1, days + 1)
}
