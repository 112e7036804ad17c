//! Places at which tests of crash recovery let a learner fail. They have an effect only with the feature `fail_points`,
//! which `cargo test` enables: `S2MIA_FAIL_AT=POINT@ITERATION` names one, and the number of finished iterations.

use std::io;
use std::time::Duration;

use crate::store::checkpoint::Step;

/// Delay after the start of the update; shorter than any update.
const UPDATE_DELAY: Duration = Duration::from_millis(3);

fn is_named(point: &str, iteration: u64) -> bool {
    let named = || std::env::var("S2MIA_FAIL_AT");
    cfg!(feature = "fail_points") && named().is_ok_and(|at| at == format!("{point}@{iteration}"))
}

/// Aborts the process.
pub(crate) fn abort_at(point: &str, iteration: u64) {
    if is_named(point, iteration) {
        std::process::abort();
    }
}

/// Aborts the process during the update that begins now.
pub(crate) fn abort_soon_at(point: &str, iteration: u64) {
    if is_named(point, iteration) {
        let thread = std::thread::Builder::new().name("fail-point".to_owned());
        let started = thread.spawn(|| {
            std::thread::sleep(UPDATE_DELAY);
            std::process::abort();
        });
        started.expect("a test can start a thread");
    }
}

/// Fails with a full disk at a step of writing the checkpoint.
pub(crate) fn fail_at(step: Step, iteration: u64) -> io::Result<()> {
    if is_named(&format!("{step:?}"), iteration) {
        Err(io::ErrorKind::StorageFull.into())
    } else {
        Ok(())
    }
}
