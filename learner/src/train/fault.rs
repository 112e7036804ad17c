//! Fault injection for tests: aborts the process, or reports a full disk, at a named point of an iteration.

use std::io;
use std::str::FromStr;
use std::time::Duration;

use crate::checkpoint::Step;

/// The point of an iteration at which the fault occurs. The process aborts, except at [`Point::Disk`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    /// All slots are complete; the update has not begun.
    AfterCollect,
    /// During the update.
    MidUpdate,
    /// The new weights are published but not written.
    AfterPublish,
    /// A checkpoint is written but not yet renamed.
    MidCheckpoint,
    /// One step of writing the checkpoint fails with a full disk; the process continues.
    Disk(Step),
}

/// Names on the command line.
const NAMES: [(&str, Point); 11] = [
    ("after-collect", Point::AfterCollect),
    ("mid-update", Point::MidUpdate),
    ("after-publish", Point::AfterPublish),
    ("mid-checkpoint", Point::MidCheckpoint),
    ("disk-make-folder", Point::Disk(Step::MakeFolder)),
    ("disk-write-file", Point::Disk(Step::WriteFile)),
    ("disk-flush-files", Point::Disk(Step::FlushFiles)),
    ("disk-rename", Point::Disk(Step::Rename)),
    ("disk-flush-name", Point::Disk(Step::FlushName)),
    ("disk-name-latest", Point::Disk(Step::NameLatest)),
    ("disk-remove-old", Point::Disk(Step::RemoveOld)),
];

/// Delay after the start of the update; shorter than any update.
const UPDATE_DELAY: Duration = Duration::from_millis(3);

/// A fault at a point of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The point.
    pub point: Point,
    /// Finished iterations when it occurs.
    pub iteration: u64,
}

impl FromStr for Fault {
    type Err = String;

    /// Parses `POINT@ITERATION`, for example `after-publish@3`.
    fn from_str(text: &str) -> Result<Self, String> {
        let names = NAMES.map(|(name, _)| name).join(", ");
        let form = || format!("expected POINT@ITERATION with one of {names}");
        let (name, iteration) = text.split_once('@').ok_or_else(form)?;
        let known = NAMES.iter().find(|known| known.0 == name).ok_or_else(form)?;
        let iteration = iteration.parse().map_err(|_| form())?;
        Ok(Self { point: known.1, iteration })
    }
}

/// Aborts the process if `fault` is for this point and iteration.
pub(crate) fn at(fault: Option<Fault>, point: Point, iteration: u64) {
    if fault == Some(Fault { point, iteration }) {
        match point {
            Point::MidUpdate => abort_soon(),
            Point::AfterCollect | Point::AfterPublish | Point::MidCheckpoint => {
                std::process::abort()
            }
            Point::Disk(_) => {}
        }
    }
}

/// Fails with a full disk if `fault` is for this step and iteration.
pub(crate) fn on_disk(fault: Option<Fault>, step: Step, iteration: u64) -> io::Result<()> {
    match fault == Some(Fault { point: Point::Disk(step), iteration }) {
        true => Err(io::ErrorKind::StorageFull.into()),
        false => Ok(()),
    }
}

fn abort_soon() {
    let thread = std::thread::Builder::new().name("fault".to_owned());
    let started = thread.spawn(|| {
        std::thread::sleep(UPDATE_DELAY);
        std::process::abort();
    });
    if started.is_err() {
        std::process::abort();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_parsed_from_its_point_and_iteration() {
        let fault = Fault { point: Point::AfterPublish, iteration: 3 };
        assert_eq!("after-publish@3".parse(), Ok(fault));
        for wrong in ["after-publish", "unknown@3", "mid-update@x"] {
            assert!(wrong.parse::<Fault>().unwrap_err().contains("POINT@ITERATION"), "{wrong}");
        }
    }
}
