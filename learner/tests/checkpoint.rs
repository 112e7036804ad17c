//! Checkpoints survive crashes; damaged ones are never loaded.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use std::fs;
use std::path::{Path, PathBuf};

use learner::config::CheckpointConfig;
use learner::store::checkpoint::{
    self, Before, Checkpoint, CheckpointError, Loaded, Manifest, RunSettings, Saved, Step,
};
use policy::arrays::{Array, NamedArrays, hex};
use sha2::{Digest as _, Sha256};

fn checkpoint(iteration: u64) -> Checkpoint {
    let floats = |value: f32| Array::F32 { shape: vec![2, 2], data: vec![value, 0.5, -0.0, 1e-9] };
    let count = Array::I64 { shape: vec![1], data: vec![iteration as i64] };
    let arrays = NamedArrays::from([
        ("weights/agent_0.head".to_owned(), floats(iteration as f32)),
        ("weights/critic".to_owned(), floats(2.0)),
        ("optimizer/agent_0.head.m".to_owned(), floats(3.0)),
        ("environments/0000/state".to_owned(), Array::U8 { shape: vec![3], data: vec![1, 2, 3] }),
        ("counters/iteration".to_owned(), count),
    ]);
    Checkpoint { iteration, env_steps: iteration * 40, arrays, policy: b"a policy".to_vec() }
}

fn keep(keep_last: usize) -> CheckpointConfig {
    CheckpointConfig { every: 1, keep_last }
}

struct Run(tempfile::TempDir);

const SETTINGS: RunSettings<'static> = RunSettings { sha256: "c0ffee", toml: "a = 1\n" };

impl Run {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn with(iterations: &[u64]) -> Self {
        let run = Self::new();
        iterations.iter().for_each(|iteration| drop(run.save(*iteration, 10)));
        run
    }

    fn save(&self, iteration: u64, keep_last: usize) -> Saved {
        self.try_save(iteration, keep(keep_last), &mut |_, _| Ok(())).unwrap()
    }

    fn try_save(
        &self,
        iteration: u64,
        keep: CheckpointConfig,
        before: &mut Before<'_>,
    ) -> Result<Saved, CheckpointError> {
        checkpoint::save(self.0.path(), &checkpoint(iteration), SETTINGS, &keep, before)
    }

    fn load(&self) -> Loaded {
        checkpoint::load_newest(self.0.path()).unwrap()
    }

    fn folder(&self) -> PathBuf {
        checkpoint::folder(self.0.path())
    }

    fn path(&self, iteration: u64) -> PathBuf {
        self.folder().join(format!("iter_{iteration:08}"))
    }
}

fn files(place: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> =
        fs::read_dir(place).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

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
    let names: Vec<String> = files(&run.folder())
        .iter()
        .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
        .collect();
    assert_eq!(names, ["LATEST", "iter_00000004", "iter_00000005"]);
}

/// Saves iteration 2 on a disk that fails at step number `at`; a file is written in part before. Returns the failed
/// step, if there are so many.
fn failed_step(run: &Run, at: usize) -> Option<Step> {
    let (mut count, mut failed) = (0, None);
    let saved = run.try_save(2, keep(10), &mut |step, path| {
        count += 1;
        if count <= at {
            return Ok(());
        }
        if step == Step::WriteFile {
            fs::write(path, "partial")?;
        }
        failed = Some(step);
        Err(std::io::ErrorKind::StorageFull.into())
    });
    assert_eq!(saved.is_err(), failed.is_some());
    failed
}

#[test]
fn a_disk_error_at_any_step_keeps_the_previous_checkpoint_and_a_retry_succeeds() {
    let mut seen = Vec::new();
    for at in 0.. {
        let run = Run::with(&[1]);
        let Some(step) = failed_step(&run, at) else { break };
        seen.push(step);
        let loaded = run.load();
        // The new checkpoint counts once it has been renamed.
        let early =
            matches!(step, Step::MakeFolder | Step::WriteFile | Step::FlushFiles | Step::Rename);
        let newest = if early { 1 } else { 2 };
        assert_eq!((loaded.checkpoint, loaded.skipped), (checkpoint(newest), vec![]), "{step:?}");
        assert_eq!(checkpoint::load(&run.path(1)).unwrap().checkpoint, checkpoint(1));
        run.save(2, 10);
        assert_eq!(run.load().checkpoint, checkpoint(2), "{step:?}");
    }
    seen.dedup();
    assert_eq!(seen, Step::ALL);
}

#[test]
fn truncated_files_fall_back_to_the_previous_checkpoint() {
    for file in files(&Run::with(&[1, 2]).path(2)) {
        let size = fs::metadata(&file).map_or(100, |found| found.len());
        for length in [0, 1, size / 2, size.saturating_sub(1)] {
            let run = Run::with(&[1, 2]);
            let file = run.path(2).join(file.file_name().unwrap());
            let bytes = fs::read(&file).unwrap();
            fs::write(&file, &bytes[..bytes.len().min(length as usize).min(bytes.len() - 1)])
                .unwrap();
            falls_back(&run, &file);
        }
    }
}

#[test]
fn a_flipped_bit_in_any_byte_of_any_file_falls_back() {
    let run = Run::with(&[1, 2]);
    for file in files(&run.path(2)) {
        let bytes = fs::read(&file).unwrap();
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
}

#[test]
fn a_missing_file_and_two_swapped_files_fall_back() {
    let names = files(&Run::with(&[1, 2]).path(2));
    for file in &names {
        let run = Run::with(&[1, 2]);
        let file = run.path(2).join(file.file_name().unwrap());
        fs::remove_file(&file).unwrap();
        falls_back(&run, &file);
    }
    let run = Run::with(&[1, 2]);
    let [one, two] = ["optimizer", "weights"].map(|n| run.path(2).join(format!("{n}.safetensors")));
    let bytes = fs::read(&one).unwrap();
    fs::rename(&two, &one).unwrap();
    fs::write(&two, bytes).unwrap();
    falls_back(&run, &one);
}

#[cfg(unix)]
#[test]
fn symbolic_links_in_a_checkpoint_are_rejected() {
    let run = Run::with(&[1, 2]);
    let file = run.path(2).join("weights.safetensors");
    let elsewhere = run.0.path().join("elsewhere");
    fs::rename(&file, &elsewhere).unwrap();
    std::os::unix::fs::symlink(&elsewhere, &file).unwrap();
    falls_back(&run, &file);
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
fn a_crash_at_any_step_leaves_the_old_or_the_new_checkpoint() {
    let whole = Run::with(&[2]);
    let written = files(&whole.path(2));
    // Before the rename: the draft contains the first n files, the last of them truncated.
    for count in 0..=written.len() {
        let run = Run::with(&[1]);
        let draft = run.folder().join(".tmp-iter_00000002");
        fs::create_dir(&draft).unwrap();
        for (index, file) in written.iter().take(count).enumerate() {
            let bytes = fs::read(file).unwrap();
            let end = if index + 1 == count { bytes.len() / 2 } else { bytes.len() };
            fs::write(draft.join(file.file_name().unwrap()), &bytes[..end]).unwrap();
        }
        let loaded = run.load();
        assert_eq!((loaded.checkpoint, loaded.skipped), (checkpoint(1), vec![]));
        // The next attempt removes the draft.
        run.save(2, 10);
        assert_eq!(run.load().checkpoint, checkpoint(2));
        assert!(!draft.exists());
    }
    // After the rename, before LATEST is replaced: the new checkpoint counts.
    let run = Run::with(&[1, 2]);
    fs::write(run.folder().join("LATEST"), "iter_00000001\n").unwrap();
    assert_eq!(run.load().checkpoint, checkpoint(2));
    // While LATEST is being replaced.
    fs::write(run.folder().join(".tmp-LATEST"), "iter_0").unwrap();
    assert_eq!(run.load().checkpoint, checkpoint(2));
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
    let run = Run::new();
    let mut invalid = checkpoint(1);
    invalid.arrays.insert("extra/x".to_owned(), Array::U8 { shape: vec![0], data: vec![] });
    let saved = checkpoint::save(run.0.path(), &invalid, SETTINGS, &keep(1), &mut |_, _| Ok(()));
    let error = saved.unwrap_err().to_string();
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
