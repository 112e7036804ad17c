//! Waiting for conditions in other processes.

use std::path::Path;
use std::time::{Duration, Instant};

/// Time between two polls; the other processes need the processor.
pub(crate) const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Polls `check` for up to 30 s; then panics with its error.
pub(crate) fn eventually<T>(mut check: impl FnMut() -> Result<T, String>) -> T {
    let deadline = Instant::now() + Duration::from_secs(30);
    loop {
        match check() {
            Ok(answer) => return answer,
            Err(error) => assert!(Instant::now() < deadline, "{error}, after 30 s"),
        }
        std::thread::sleep(POLL_INTERVAL);
    }
}

/// Waits for the first line of the run's metrics.
pub(crate) fn has_begun(folder: &Path) {
    eventually(|| {
        let metrics = std::fs::metadata(folder.join("metrics.jsonl"));
        let begun = metrics.is_ok_and(|file| file.len() > 0);
        begun.then_some(()).ok_or_else(|| "no iteration".to_owned())
    });
}
