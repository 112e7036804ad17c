//! Places at which tests of crash recovery let a learner fail. They have an effect only with the feature `fail_points`,
//! which `cargo test` enables: `S2MIA_FAIL_AT=POINT@ITERATION` names one, and the number of finished iterations.

use std::io;
use std::time::Duration;

use crate::store::checkpoint::Step;

/// Delay after the start of the update; shorter than any update.
const UPDATE_DELAY: Duration = Duration::from_millis(3);

/// Points besides the steps of writing a checkpoint, which have their own names.
const POINTS: [&str; 4] = ["after-collect", "mid-update", "after-publish", "mid-checkpoint"];

/// Ends the program with the list of points if the variable names none of them.
pub(crate) fn demand_known() {
    let named = std::env::var("S2MIA_FAIL_AT").unwrap_or_default();
    assert!(
        !cfg!(feature = "fail_points") || named.is_empty() || is_known(&named),
        "S2MIA_FAIL_AT={named} is not POINT@ITERATION with one of the points {}",
        points().collect::<Vec<_>>().join(", ")
    );
}

fn is_known(named: &str) -> bool {
    let Some((point, iteration)) = named.split_once('@') else { return false };
    iteration.parse::<u64>().is_ok() && points().any(|known| known == point)
}

fn points() -> impl Iterator<Item = String> {
    let steps = Step::ALL.map(|step| format!("{step:?}"));
    POINTS.map(str::to_owned).into_iter().chain(steps)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misspelt_point_is_not_known() {
        for named in ["mid-update@2", "after-collect@0", "Rename@1"] {
            assert!(is_known(named), "{named}");
        }
        for named in ["mid-updates@2", "rename@1", "Rename", "Rename@", "Rename@x", "@1"] {
            assert!(!is_known(named), "{named}");
        }
    }
}
