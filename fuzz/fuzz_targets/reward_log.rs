//! Reward logs, beside a trajectory log that they may belong to.
#![no_main]

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use recording::trajectory_log::{Index, join};
use tempfile::TempDir;

/// A folder with a trajectory log.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = TempDir::new().expect("a writable temporary folder");
    fs::write(folder.path().join("log.mcap"), fuzz::recording()).expect("a writable folder");
    folder
});

fuzz_target!(|data: &[u8]| {
    let folder = FOLDER.path();
    let rewards = folder.join(proto::reward_log_name(1));
    fs::write(&rewards, data).expect("a writable folder");
    let mut index = Index::default();
    index.add(&folder.join("log.mcap")).expect("a log of the program");
    if index.add(&rewards).is_err() {
        return;
    }
    let (paid, all) = index.paid();
    assert!(paid <= all);
    let _told = (index.remarks().len(), index.damaged().len());
    joined(&index, &folder.join("joined.mcap"));
});

/// What is joined can be read as the parts could.
fn joined(index: &Index, out: &Path) {
    if join(index, out, |_, _| {}).is_err() {
        return;
    }
    let mut again = Index::default();
    again.add(out).expect("a log of the program");
    assert_eq!(again.shares_and_steps(), index.shares_and_steps());
    assert_eq!(again.paid(), index.paid());
    fs::remove_file(out).expect("a writable folder");
}
