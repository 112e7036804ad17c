//! Where things stand in a run folder, and how a new one is named.

use std::io;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::errors::Usage;

/// The resolved configuration.
pub(crate) fn config_file(folder: &Path) -> PathBuf {
    folder.join("config.toml")
}

/// The settings of the run in `folder`; refuses a folder without any.
pub(crate) fn config_file_of_run(folder: &Path) -> Result<PathBuf, Usage> {
    let file = config_file(folder);
    let lacking = || format!("{} is no run folder: it has no config.toml", folder.display());
    if file.is_file() { Ok(file) } else { Err(Usage::new(lacking())) }
}

/// One JSON object per iteration or evaluation.
pub(crate) fn metrics_file(folder: &Path) -> PathBuf {
    folder.join("metrics.jsonl")
}

/// Versions, hashes and fingerprints.
pub(crate) fn manifest_file(folder: &Path) -> PathBuf {
    folder.join("manifest.json")
}

/// Actors' logs and recordings.
pub(crate) fn logs(folder: &Path) -> PathBuf {
    folder.join("logs")
}

/// The files of a folder whose names `belong`, in the order of their names.
pub(crate) fn files(folder: &Path, belong: fn(&str) -> bool) -> io::Result<Vec<PathBuf>> {
    let paths = folder.read_dir()?.filter_map(|entry| Some(entry.ok()?.path()));
    let mut paths: Vec<_> = paths.filter(|path| file_name(path).is_some_and(belong)).collect();
    paths.sort();
    Ok(paths)
}

/// The name of a file, if it is text.
pub(crate) fn file_name(path: &Path) -> Option<&str> {
    path.file_name().and_then(|name| name.to_str())
}

/// Last part of the path.
pub(crate) fn name(folder: &Path) -> String {
    let resolved = folder.canonicalize().unwrap_or_else(|_| folder.to_path_buf());
    resolved.file_name().unwrap_or(folder.as_os_str()).to_string_lossy().into_owned()
}

/// `runs/<task>-<algorithm>-seed<seed>-<UTC time>`; a task's name may come from outside, so only letters, digits, dots
/// and underscores of it are taken.
pub(crate) fn default_folder(task: &str, algorithm: &str, seed: u64, now: SystemTime) -> PathBuf {
    let secs = now.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let plain = |c: char| if c.is_ascii_alphanumeric() || "._".contains(c) { c } else { '-' };
    let task = task.chars().map(plain).collect::<String>();
    PathBuf::from(format!("runs/{task}-{algorithm}-seed{seed}-{}", utc(secs)))
}

/// `20260131-235959` for seconds since 1970-01-01 00:00 UTC.
fn utc(secs: u64) -> String {
    let (year, month, day) = civil_date(secs / 86_400);
    let (hour, minute, second) = (secs / 3600 % 24, secs / 60 % 60, secs % 60);
    format!("{year:04}{month:02}{day:02}-{hour:02}{minute:02}{second:02}")
}

/// Gregorian date of a day counted from 1970-01-01. Years are taken to begin on 1 March, so that the leap
/// day is the last of its year, and grouped in eras of 400 years, which have 146,097 days.
fn civil_date(days: u64) -> (u64, u64, u64) {
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let march_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * march_month + 2) / 5 + 1;
    let month = if march_month < 10 { march_month + 3 } else { march_month - 9 };
    (era * 400 + year_of_era + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn dates_of_known_seconds() {
        // date -u -d @SECONDS +%Y%m%d-%H%M%S
        assert_eq!(utc(0), "19700101-000000");
        assert_eq!(utc(951_827_696), "20000229-123456");
        assert_eq!(utc(1_767_225_599), "20251231-235959");
    }

    #[test]
    fn a_new_run_is_named_for_what_it_is() {
        let now = UNIX_EPOCH + Duration::from_secs(951_827_696);
        assert_eq!(
            default_folder("halfcheetah-6x1", "happo", 7, now),
            PathBuf::from("runs/halfcheetah-6x1-happo-seed7-20000229-123456")
        );
        assert_eq!(
            default_folder("../My task", "happo", 7, now),
            PathBuf::from("runs/..-My-task-happo-seed7-20000229-123456")
        );
    }
}
