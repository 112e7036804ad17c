//! Checkpoints survive crashes; damaged ones are never loaded.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "checkpoint/run.rs"]
mod run;

use std::fs;
use std::panic::AssertUnwindSafe;
use std::path::Path;

use learner::store::checkpoint::{self, CheckpointError, Manifest, Step};
use policy::arrays::{Array, hex};
use sha2::{Digest as _, Sha256};

use run::{Run, checkpoint, files, names};

/// Checks that the newest checkpoint is skipped with a reason that names `file`, and the previous one is loaded.
fn falls_back(run: &Run, file: &Path) {
    let loaded = run.load();
    assert_eq!(loaded.checkpoint, checkpoint(1), "{}", file.display());
    let (path, reason) = &loaded.skipped[0];
    assert_eq!(*path, run.path(2));
    let name = file.file_name().unwrap().to_str().unwrap();
    assert!(reason.contains(name), "{name}: {reason}");
    let error = checkpoint::load(path).unwrap_err().to_string();
    assert!(error.contains(reason), "{error}");
}

#[test]
fn a_checkpoint_survives_a_round_trip_with_its_hashes() {
    let run = Run::new();
    let saved = run.save(12, 3);
    let loaded = run.load();
    assert_eq!(loaded.checkpoint, checkpoint(12));
    assert_eq!(loaded.saved(), saved);
    assert!(loaded.skipped.is_empty());
    assert_eq!(saved.path, run.path(12));
    assert_eq!(loaded.manifest.weights_sha256, checkpoint(12).weights_sha256());
    assert_eq!(loaded.manifest.state_sha256, checkpoint(12).state_sha256());
    assert_eq!(loaded.manifest.config_sha256, "c0ffee");
    assert_eq!(fs::read_to_string(run.folder().join("LATEST")).unwrap(), "iter_00000012\n");
}

#[test]
fn the_state_hash_covers_all_but_the_evaluation_and_the_weights_hash_the_weights() {
    let base = checkpoint(1);
    let with = |name: &str| {
        let mut other = base.clone();
        other.arrays.insert(name.to_owned(), Array::U8 { shape: vec![1], data: vec![9] });
        (
            other.weights_sha256() == base.weights_sha256(),
            other.state_sha256() == base.state_sha256(),
        )
    };
    assert_eq!(with("weights/x"), (false, false));
    assert_eq!(with("density/x"), (true, false));
    assert_eq!(with("evaluation/policy"), (true, true));
}

#[test]
fn the_newest_checkpoints_are_kept_and_older_ones_removed() {
    let run = Run::new();
    (1..=5).for_each(|iteration| drop(run.save(iteration, 2)));
    assert_eq!(names(&run.folder()), ["LATEST", "iter_00000004", "iter_00000005"]);
}

#[test]
fn the_checkpoint_with_the_best_evaluation_stays_beside_the_newest() {
    let mut run = Run::new();
    run.1 = [(1, 3.0), (2, 7.0), (4, 5.0), (9, 100.0)].into();
    (1..=5).for_each(|iteration| drop(run.save(iteration, 2)));
    assert_eq!(names(&run.folder()), ["LATEST", "iter_00000002", "iter_00000004", "iter_00000005"]);
    run.2 = Some(4);
    (6..=7).for_each(|iteration| drop(run.save(iteration, 1)));
    assert_eq!(names(&run.folder()), ["LATEST", "iter_00000002", "iter_00000004", "iter_00000007"]);
    let best = |returns: &[(u64, f64)]| {
        checkpoint::best(run.0.path(), &returns.iter().copied().collect()).unwrap()
    };
    let path = |iteration: u64| Some(run.folder().join(format!("iter_{iteration:08}")));
    assert_eq!(best(&[(1, 3.0), (2, 7.0), (4, 5.0), (9, 100.0)]), path(2));
    assert_eq!(best(&[(4, 5.0), (7, 5.0)]), path(7));
    assert_eq!(best(&[(3, 1.0)]), None);
}

#[derive(Clone, Copy, Debug)]
enum Fault {
    DiskFull,
    Crash,
}

/// Saves iteration 2 until step number `at`, at which a file is written in part. Returns the failed step, if there are so
/// many.
fn failed_step(run: &Run, at: usize, fault: Fault) -> Option<Step> {
    let (mut count, mut failed) = (0, None);
    let mut before = |step: Step, path: &Path| -> std::io::Result<()> {
        count += 1;
        if count <= at {
            return Ok(());
        }
        match step {
            Step::WriteFile => fs::write(path, "partial")?,
            Step::NameLatest => fs::write(path.with_file_name(".tmp-LATEST"), "iter_0")?,
            _ => {}
        }
        failed = Some(step);
        match fault {
            Fault::DiskFull => Err(std::io::ErrorKind::StorageFull.into()),
            // Leaves the files as they are.
            Fault::Crash => std::panic::resume_unwind(Box::new(())),
        }
    };
    let save = AssertUnwindSafe(|| run.write(&checkpoint(2), 10, &mut before).is_ok());
    let saved = std::panic::catch_unwind(save).unwrap_or(false);
    assert_ne!(saved, failed.is_some());
    failed
}

#[test]
fn a_full_disk_or_a_crash_at_any_step_keeps_the_previous_checkpoint_and_a_retry_succeeds() {
    for fault in [Fault::DiskFull, Fault::Crash] {
        let mut seen = Vec::new();
        for at in 0.. {
            let run = Run::with(&[1]);
            let Some(step) = failed_step(&run, at, fault) else { break };
            seen.push(step);
            let loaded = run.load();
            // The new checkpoint counts once it has been renamed.
            let early = matches!(
                step,
                Step::MakeFolder | Step::WriteFile | Step::FlushFiles | Step::Rename
            );
            let newest = checkpoint(if early { 1 } else { 2 });
            assert_eq!((loaded.checkpoint, loaded.skipped), (newest, vec![]), "{fault:?} {step:?}");
            assert_eq!(checkpoint::load(&run.path(1)).unwrap().checkpoint, checkpoint(1));
            run.save(2, 10);
            assert_eq!(run.load().checkpoint, checkpoint(2), "{fault:?} {step:?}");
            let whole = ["LATEST", "iter_00000001", "iter_00000002"];
            assert_eq!(names(&run.folder()), whole, "{fault:?} {step:?}");
        }
        seen.dedup();
        let all = [
            Step::MakeFolder,
            Step::WriteFile,
            Step::FlushFiles,
            Step::Rename,
            Step::FlushName,
            Step::NameLatest,
            Step::RemoveOld,
        ];
        assert_eq!(seen, all);
    }
}

#[test]
fn a_missing_linked_truncated_or_altered_file_falls_back_to_the_previous_checkpoint() {
    let run = Run::with(&[1, 2]);
    let elsewhere = run.0.path().join("elsewhere");
    for file in files(&run.path(2)) {
        let bytes = fs::read(&file).unwrap();
        fs::rename(&file, &elsewhere).unwrap();
        falls_back(&run, &file);
        std::os::unix::fs::symlink(&elsewhere, &file).unwrap();
        falls_back(&run, &file);
        fs::remove_file(&file).unwrap();
        for length in [0, 1, bytes.len() / 2, bytes.len() - 1] {
            fs::write(&file, &bytes[..length]).unwrap();
            falls_back(&run, &file);
        }
        let stride = if bytes.len() > 400 { 7 } else { 1 };
        for index in (0..bytes.len()).step_by(stride) {
            let mut flipped = bytes.clone();
            flipped[index] ^= 1 << (index % 8);
            fs::write(&file, flipped).unwrap();
            falls_back(&run, &file);
        }
        fs::write(&file, bytes).unwrap();
    }
    assert_eq!(run.load().checkpoint, checkpoint(2));
    // Two files have each other's content.
    let [one, two] = ["optimizer", "weights"].map(|n| run.path(2).join(format!("{n}.safetensors")));
    fs::rename(&one, &elsewhere).unwrap();
    fs::rename(&two, &one).unwrap();
    fs::rename(&elsewhere, &two).unwrap();
    falls_back(&run, &one);
}

#[test]
fn a_checkpoint_in_the_wrong_folder_or_with_another_schema_is_rejected() {
    let run = Run::with(&[1, 2]);
    fs::rename(run.path(2), run.path(3)).unwrap();
    let loaded = run.load();
    assert_eq!(loaded.checkpoint, checkpoint(1));
    assert!(loaded.skipped[0].1.contains("its manifest is that of iter_00000002"));

    let file = run.path(1).join("manifest.json");
    let newer = fs::read_to_string(&file).unwrap().replace("\"schema\": 2", "\"schema\": 3");
    fs::write(&file, newer).unwrap();
    let error = checkpoint::load_newest(run.0.path()).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("iter_00000001: manifest.json has schema 3, this program reads 2"),
        "{text}"
    );
    assert!(matches!(error, CheckpointError::NoneUsable { skipped, .. } if skipped.len() == 2));
}

#[test]
fn a_checkpoint_with_another_state_than_its_manifest_records_is_rejected() {
    let run = Run::with(&[1, 2]);
    let mut manifest = run.load().manifest;
    manifest.state_sha256 = checkpoint(1).state_sha256();
    manifest.manifest_sha256 = String::new();
    let text =
        |manifest: &Manifest| format!("{}\n", serde_json::to_string_pretty(manifest).unwrap());
    manifest.manifest_sha256 = hex(&Sha256::digest(text(&manifest)));
    let file = run.path(2).join("manifest.json");
    fs::write(&file, text(&manifest)).unwrap();
    falls_back(&run, &file);
    assert!(run.load().skipped[0].1.starts_with("the SHA-256 of the state is "));
}

#[test]
fn a_run_without_checkpoints_is_an_error() {
    let error = checkpoint::load_newest(Run::new().0.path()).unwrap_err();
    assert!(matches!(error, CheckpointError::None { .. }), "{error}");
}

#[test]
fn a_damaged_checkpoint_is_replaced_when_its_iteration_is_repeated() {
    let run = Run::with(&[1, 3]);
    fs::write(run.path(3).join("weights.safetensors"), "damaged").unwrap();
    assert_eq!(run.load().checkpoint, checkpoint(1));
    run.save(2, 1);
    // The damaged checkpoint neither counts towards `keep_last` nor hides the valid one.
    assert_eq!(run.load().checkpoint, checkpoint(2));
    run.save(3, 1);
    assert_eq!((run.load().checkpoint, run.load().skipped), (checkpoint(3), vec![]));
}

#[test]
fn an_array_outside_all_groups_is_rejected_by_name() {
    let mut invalid = checkpoint(1);
    invalid.arrays.insert("extra/x".to_owned(), Array::U8 { shape: vec![0], data: vec![] });
    let error = Run::new().write(&invalid, 1, &mut |_, _| Ok(())).unwrap_err().to_string();
    assert!(error.contains("array extra/x belongs to none of the groups"), "{error}");
}

#[test]
fn a_reader_beside_a_learner_that_removes_old_checkpoints_always_finds_a_whole_one() {
    let run = Run::with(&[1]);
    let finished = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            (2..150).for_each(|iteration| drop(run.save(iteration, 1)));
            finished.store(true, std::sync::atomic::Ordering::Relaxed);
        });
        while !finished.load(std::sync::atomic::Ordering::Relaxed) {
            assert!(run.load().skipped.is_empty());
        }
    });
    assert_eq!(files(&run.folder()).len(), 2);
}

#[test]
fn a_checkpoint_is_recognised_by_its_place_and_as_a_copy_even_if_it_is_damaged() {
    let run = Run::with(&[1]);
    let copy = run.0.path().join("best");
    fs::create_dir(&copy).unwrap();
    assert!(!checkpoint::is_checkpoint(&copy) && !checkpoint::is_checkpoint(run.0.path()));
    files(&run.path(1)).iter().for_each(|file| {
        fs::copy(file, copy.join(file.file_name().unwrap())).unwrap();
    });
    assert_eq!(checkpoint::load(&copy).unwrap().checkpoint, checkpoint(1));
    fs::remove_file(copy.join("manifest.json")).unwrap();
    assert!(checkpoint::is_checkpoint(&copy));
    fs::remove_dir_all(run.path(1)).unwrap();
    fs::create_dir(run.path(1)).unwrap();
    assert!(checkpoint::is_checkpoint(&run.path(1)));
    // A run folder into which a policy was exported.
    fs::write(run.0.path().join("policy.safetensors"), "").unwrap();
    fs::write(run.0.path().join("config.toml"), "").unwrap();
    assert!(!checkpoint::is_checkpoint(run.0.path()));
}
