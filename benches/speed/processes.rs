//! Processor time and memory of other processes, from Linux; NaN on other systems.

use std::fs;

/// Clock ticks per second, the same on every Linux.
const TICKS: f64 = 100.0;

/// User and system processor time of all threads of a process, seconds.
pub(crate) fn processor_secs(process: u32) -> f64 {
    let text = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    // The second field is the program's name in brackets, which may contain spaces.
    let fields = text.rsplit(')').next().unwrap_or_default().split_whitespace();
    let ticks: Vec<f64> = fields.skip(11).take(2).filter_map(|field| field.parse().ok()).collect();
    if ticks.len() == 2 { (ticks[0] + ticks[1]) / TICKS } else { f64::NAN }
}

/// Peak memory of a process so far, MB.
pub(crate) fn peak_megabytes(process: u32) -> f64 {
    status(process, "VmHWM:").map_or(f64::NAN, |kilobytes| kilobytes * 1024.0 / 1e6)
}

/// Running child processes of `parent`.
pub(crate) fn children(parent: u32) -> Vec<u32> {
    let Ok(entries) = fs::read_dir("/proc") else { return Vec::new() };
    let numbers = entries.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    numbers.filter(|&process| status(process, "PPid:") == Some(f64::from(parent))).collect()
}

/// One number of a process's status.
fn status(process: u32, field: &str) -> Option<f64> {
    let text = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(field))?;
    line.split_whitespace().next()?.parse().ok()
}
