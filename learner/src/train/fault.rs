//! Faults on demand, at a named point of an iteration: a process that ends itself without any farewell, or a
//! disk that is full, so that tests and soak runs can hit a learner where it hurts most.

use std::io;
use std::str::FromStr;
use std::time::Duration;

use crate::checkpoint::Step;

/// Where in an iteration something goes wrong: the process dies, except at [`Point::Disk`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    /// Every slot is in, nothing has been learnt from it.
    AfterCollect,
    /// In the middle of the update.
    MidUpdate,
    /// The new weights are out, nothing has been written of them.
    AfterPublish,
    /// A checkpoint is written beside its place and not yet renamed.
    MidCheckpoint,
    /// The disk refuses one step of the checkpoint; nobody dies.
    Disk(Step),
}

/// Names as they are given on the command line.
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

/// How far into an update its middle is: far less than any update takes.
const INTO_THE_UPDATE: Duration = Duration::from_millis(3);

/// One fault: at a point, in an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Where.
    pub point: Point,
    /// Finished iterations before it.
    pub iteration: u64,
}

impl FromStr for Fault {
    type Err = String;

    /// `POINT@ITERATION`, such as `after-publish@3`.
    fn from_str(text: &str) -> Result<Self, String> {
        let names = NAMES.map(|(name, _)| name).join(", ");
        let form = || format!("expected POINT@ITERATION with one of {names}");
        let (name, iteration) = text.split_once('@').ok_or_else(form)?;
        let known = NAMES.iter().find(|known| known.0 == name).ok_or_else(form)?;
        let iteration = iteration.parse().map_err(|_| form())?;
        Ok(Self { point: known.1, iteration })
    }
}

/// Dies here if this is the moment of `fault`.
pub(crate) fn at(fault: Option<Fault>, point: Point, iteration: u64) {
    if fault == Some(Fault { point, iteration }) {
        match point {
            Point::MidUpdate => die_soon(),
            Point::AfterCollect | Point::AfterPublish | Point::MidCheckpoint => {
                std::process::abort()
            }
            Point::Disk(_) => {}
        }
    }
}

/// The answer of a full disk, if `fault` has it refuse this step.
pub(crate) fn on_disk(fault: Option<Fault>, step: Step, iteration: u64) -> io::Result<()> {
    match fault == Some(Fault { point: Point::Disk(step), iteration }) {
        true => Err(io::ErrorKind::StorageFull.into()),
        false => Ok(()),
    }
}

fn die_soon() {
    let thread = std::thread::Builder::new().name("fault".to_owned());
    let started = thread.spawn(|| {
        std::thread::sleep(INTO_THE_UPDATE);
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
    fn a_fault_is_named_by_its_point_and_its_iteration() {
        let fault = Fault { point: Point::AfterPublish, iteration: 3 };
        assert_eq!("after-publish@3".parse(), Ok(fault));
        for wrong in ["after-publish", "after-lunch@3", "mid-update@soon"] {
            assert!(wrong.parse::<Fault>().unwrap_err().contains("POINT@ITERATION"), "{wrong}");
        }
    }
}
