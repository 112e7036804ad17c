//! Waiting for conditions in other processes.

use std::path::Path;
use std::time::{Duration, Instant};

/// Asks again and again for half a minute; then fails with what is missing still.
pub(crate) fn eventually<T>(mut ask: impl FnMut() -> Result<T, String>) -> T {
    let patience = Instant::now() + Duration::from_secs(30);
    loop {
        match ask() {
            Ok(answer) => return answer,
            Err(missing) => assert!(Instant::now() < patience, "{missing}, after half a minute"),
        }
        std::thread::yield_now();
    }
}

/// Waits until the run's metrics hold a line: the run is under way.
pub(crate) fn under_way(folder: &Path) {
    eventually(|| {
        let metrics = std::fs::metadata(folder.join("metrics.jsonl"));
        let begun = metrics.is_ok_and(|file| file.len() > 0);
        begun.then_some(()).ok_or_else(|| "no iteration".to_owned())
    });
}
