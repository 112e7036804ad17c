//! A run folder with small checkpoints, also for fuzzing.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use learner::store::checkpoint::{
    self, Before, Checkpoint, CheckpointError, Keep, Loaded, RunSettings, Saved,
};
use policy::arrays::{Array, NamedArrays};

pub(crate) fn checkpoint(iteration: u64) -> Checkpoint {
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

/// A run folder, the returns of the run's evaluations, and the iteration of an outstanding one.
pub(crate) struct Run(
    pub(crate) tempfile::TempDir,
    pub(crate) BTreeMap<u64, f64>,
    pub(crate) Option<u64>,
);

impl Run {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap(), BTreeMap::new(), None)
    }

    pub(crate) fn with(iterations: &[u64]) -> Self {
        let run = Self::new();
        iterations.iter().for_each(|iteration| drop(run.save(*iteration, 10)));
        run
    }

    pub(crate) fn save(&self, iteration: u64, keep_last: usize) -> Saved {
        self.write(&checkpoint(iteration), keep_last, &mut |_, _| Ok(())).unwrap()
    }

    /// Saves a checkpoint; `before` may let a step fail.
    pub(crate) fn write(
        &self,
        checkpoint: &Checkpoint,
        keep_last: usize,
        before: &mut Before<'_>,
    ) -> Result<Saved, CheckpointError> {
        let settings = RunSettings { sha256: "c0ffee", toml: "a = 1\n" };
        let keep = Keep { newest: keep_last, returns: &self.1, outstanding: self.2 };
        checkpoint::save(self.0.path(), checkpoint, settings, &keep, before)
    }

    pub(crate) fn load(&self) -> Loaded {
        checkpoint::load_newest(self.0.path()).unwrap()
    }

    pub(crate) fn folder(&self) -> PathBuf {
        checkpoint::folder(self.0.path())
    }

    pub(crate) fn path(&self, iteration: u64) -> PathBuf {
        self.folder().join(format!("iter_{iteration:08}"))
    }
}

pub(crate) fn files(place: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> =
        fs::read_dir(place).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

pub(crate) fn names(place: &Path) -> Vec<String> {
    let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
    files(place).iter().map(name).collect()
}
