//! Checkpoints: one directory holds one consistent cut of a run, and a manifest that names every
//! file with its size and hash.
//!
//! A checkpoint is written as a draft, flushed, and renamed, so that a crash at any step leaves the previous
//! one untouched. Loading verifies every file and returns the newest valid checkpoint, and the newer ones that
//! are damaged.

mod content;
pub(crate) mod fields;
mod kept;
mod manifest;
mod step;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use policy::arrays::{ArrayError, NamedArrays, from_safetensors, hex, sha256};

use crate::store::durable::{self, DRAFT, FileError};
use crate::store::plain_file;

use content::contents;
use kept::{is_gone, iterations, prune};
use step::about_to;

pub(crate) use kept::{FOLDER, named_latest};
pub use kept::{Keep, all, best, is_checkpoint, place};
pub use manifest::{FileEntry, Manifest, SCHEMA};
pub use step::{Before, Step};

/// The file that describes a checkpoint; written last.
const MANIFEST: &str = "manifest.json";
/// The policies' bytes as actors get them.
const POLICY: &str = "policy.safetensors";
/// Names the newest checkpoint, for people and scripts. Loading looks at the directories themselves, unless they change.
const LATEST: &str = "LATEST";
/// The run's settings, so that a checkpoint by itself is enough to resume.
pub const SETTINGS: &str = "config.toml";
/// The groups of arrays, one file each.
const GROUPS: [&str; 10] = [
    "counters",
    "density",
    "environments",
    "evaluation",
    "memory",
    "normalizer",
    "observation",
    "optimizer",
    "replay",
    "weights",
];

/// One consistent cut of a run: everything that the next iteration depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Finished iterations.
    pub iteration: u64,
    /// Environment steps of all finished iterations.
    pub env_steps: u64,
    /// All state, by `group/name`; the groups are those of `GROUPS`.
    pub arrays: NamedArrays,
    /// The policies as actors get them: a `policy::PolicySnapshot`.
    pub policy: Vec<u8>,
}

/// The settings of the run that a checkpoint belongs to.
#[derive(Clone, Copy, Debug)]
pub struct RunSettings<'a> {
    /// Hash of the semantic settings, hexadecimal.
    pub sha256: &'a str,
    /// All settings.
    pub toml: &'a str,
}

/// A valid checkpoint that was read.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// Its content.
    pub checkpoint: Checkpoint,
    /// Its manifest.
    pub manifest: Manifest,
    /// Its directory.
    pub path: PathBuf,
    /// Newer checkpoints that are damaged, each with the reason.
    pub skipped: Vec<(PathBuf, String)>,
}

/// A checkpoint on disk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Saved {
    /// Its directory.
    pub path: PathBuf,
    /// Its iteration.
    pub iteration: u64,
    /// Hash of the weights, hexadecimal.
    pub weights_sha256: String,
    /// Hash of the whole state, hexadecimal.
    pub state_sha256: String,
}

/// Why a checkpoint could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// A file or folder could not be written or read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The arrays could not be turned into a file.
    #[error(transparent)]
    Encode(#[from] ArrayError),
    /// There is none.
    #[error("{folder} holds no checkpoint")]
    None {
        /// The folder of checkpoints.
        folder: PathBuf,
    },
    /// All are damaged.
    #[error("no checkpoint in {folder} can be used; {}", reasons(.skipped))]
    NoneUsable {
        /// The folder of checkpoints.
        folder: PathBuf,
        /// All of them, each with the reason.
        skipped: Vec<(PathBuf, String)>,
    },
    /// A checkpoint is damaged or an array of it does not fit, in words.
    #[error("{0}")]
    Other(String),
}

impl Checkpoint {
    /// SHA-256 of the arrays under `weights/`, hexadecimal.
    #[must_use]
    pub fn weights_sha256(&self) -> String {
        weights_sha256(&self.arrays)
    }

    /// SHA-256 of all state that training depends on, hexadecimal: every array but those under
    /// `evaluation/`, which touch no training and follow an operational setting.
    #[must_use]
    pub fn state_sha256(&self) -> String {
        hash_of(&self.arrays, |name| !name.starts_with("evaluation/"))
    }

    fn saved(&self, path: PathBuf) -> Saved {
        Saved {
            path,
            iteration: self.iteration,
            weights_sha256: self.weights_sha256(),
            state_sha256: self.state_sha256(),
        }
    }
}

impl Loaded {
    /// Its place and its hashes.
    #[must_use]
    pub fn saved(&self) -> Saved {
        self.checkpoint.saved(self.path.clone())
    }
}

/// SHA-256 of the arrays under `weights/`, hexadecimal.
#[must_use]
pub fn weights_sha256(arrays: &NamedArrays) -> String {
    hash_of(arrays, |name| name.starts_with("weights/"))
}

/// The folder of checkpoints in a run folder.
#[must_use]
pub fn folder(run_folder: &Path) -> PathBuf {
    run_folder.join(FOLDER)
}

/// Writes a checkpoint and removes those that need not stay. A checkpoint of the same iteration with the
/// same state is left as it is; one that differs or is damaged is replaced.
///
/// # Errors
/// Names the file that could not be written. The checkpoints before it are untouched.
pub fn save(
    run_folder: &Path,
    checkpoint: &Checkpoint,
    settings: RunSettings<'_>,
    keep: &Keep<'_>,
    before: &mut Before<'_>,
) -> Result<Saved, CheckpointError> {
    let folder = folder(run_folder);
    let place = folder.join(name(checkpoint.iteration));
    let saved = checkpoint.saved(place.clone());
    durable::make_folder(&folder)?;
    if !is_written(&place, &saved, settings.sha256) {
        let draft = folder.join(format!("{DRAFT}{}", name(checkpoint.iteration)));
        write_draft(&draft, (checkpoint, &saved), settings, before).inspect_err(|_| {
            // Half a checkpoint must not keep the space that metrics and the next one need.
            let _gone = durable::remove_folder(&draft);
        })?;
        about_to(before, Step::Rename, &place)?;
        durable::remove_folder(&place)?;
        std::fs::rename(&draft, &place).map_err(FileError::of("rename", &draft))?;
        about_to(before, Step::FlushName, &folder)?;
        durable::sync_folder(&folder)?;
    }
    about_to(before, Step::NameLatest, &folder.join(LATEST))?;
    let newest = format!("{}\n", name(checkpoint.iteration));
    durable::replace(&folder.join(LATEST), newest.as_bytes())?;
    about_to(before, Step::RemoveOld, &folder)?;
    prune(&folder, checkpoint.iteration, keep)?;
    Ok(saved)
}

/// Loads one checkpoint and verifies every byte of it.
///
/// # Errors
/// Says what is missing, damaged or of another schema.
pub fn load(path: &Path) -> Result<Loaded, CheckpointError> {
    let (checkpoint, manifest) = read(path).map_err(|detail| {
        CheckpointError::Other(format!("checkpoint {} cannot be used: {detail}", path.display()))
    })?;
    Ok(Loaded { checkpoint, manifest, path: path.to_path_buf(), skipped: Vec::new() })
}

/// Loads the newest valid checkpoint of a run.
///
/// # Errors
/// There is none, or all are damaged.
pub fn load_newest(run_folder: &Path) -> Result<Loaded, CheckpointError> {
    let folder = folder(run_folder);
    loop {
        if let Some(loaded) = newest_listed(&folder)? {
            return Ok(loaded);
        }
    }
}

/// The newest whole checkpoint of a list that is made once; `None` if a learner has removed one since, so that the list
/// is outdated, and the one in `LATEST` is gone, too.
fn newest_listed(folder: &Path) -> Result<Option<Loaded>, CheckpointError> {
    let mut skipped = Vec::new();
    for iteration in iterations(folder)?.into_iter().rev() {
        let path = folder.join(name(iteration));
        match read(&path) {
            Ok((checkpoint, manifest)) => {
                return Ok(Some(Loaded { checkpoint, manifest, path, skipped }));
            }
            // A learner may remove checkpoints faster than they are listed.
            Err(_) if is_gone(&path) => {
                let latest = named_latest(folder);
                return Ok(latest.and_then(|latest| load(&folder.join(name(latest))).ok()));
            }
            Err(detail) => skipped.push((path, detail)),
        }
    }
    let folder = folder.to_path_buf();
    if skipped.is_empty() {
        Err(CheckpointError::None { folder })
    } else {
        Err(CheckpointError::NoneUsable { folder, skipped })
    }
}

/// Whether a newer program wrote the checkpoint in this folder.
pub(crate) fn is_of_newer_program(path: &Path) -> bool {
    let bytes = plain_file::read(&path.join(MANIFEST)).unwrap_or_default();
    let manifest: serde_json::Value = serde_json::from_slice(&bytes).unwrap_or_default();
    manifest["schema"].as_u64().is_some_and(|schema| schema > u64::from(manifest::SCHEMA))
}

/// The iteration of the newest checkpoint of a run, whole or not; `None` if there is none.
///
/// # Errors
/// The folder of checkpoints cannot be read.
pub fn newest_iteration(run_folder: &Path) -> Result<Option<u64>, CheckpointError> {
    Ok(all(run_folder)?.last().copied())
}

fn hash_of(arrays: &NamedArrays, counts: impl Fn(&str) -> bool) -> String {
    hex(&sha256(arrays.iter().filter(|(name, _)| counts(name))))
}

/// Bytes of a checkpoint's files, as far as they can be looked at.
pub(crate) fn size(path: &Path) -> u64 {
    let files = std::fs::read_dir(path).into_iter().flatten().flatten();
    files.filter_map(|file| file.metadata().ok()).map(|file| file.len()).sum()
}

/// `iter_00000120`
fn name(iteration: u64) -> String {
    format!("iter_{iteration:08}")
}

/// Whether `path` holds exactly this state already.
fn is_written(path: &Path, saved: &Saved, config_sha256: &str) -> bool {
    let same = |manifest: &Manifest| {
        manifest.state_sha256 == saved.state_sha256 && manifest.config_sha256 == config_sha256
    };
    path.exists() && read(path).is_ok_and(|(_, manifest)| same(&manifest))
}

/// Writes all files into the folder `draft`, the manifest last.
fn write_draft(
    draft: &Path,
    (checkpoint, saved): (&Checkpoint, &Saved),
    settings: RunSettings<'_>,
    before: &mut Before<'_>,
) -> Result<(), CheckpointError> {
    about_to(before, Step::MakeFolder, draft)?;
    durable::remove_folder(draft)?;
    durable::make_folder(draft)?;
    let mut entries = BTreeMap::new();
    for (name, content) in contents(checkpoint, settings.toml)? {
        let path = draft.join(&name);
        about_to(before, Step::WriteFile, &path)?;
        entries.insert(name, content.write(&path)?);
    }
    let manifest = Manifest::of((checkpoint, saved), settings.sha256, entries).to_bytes();
    let path = draft.join(MANIFEST);
    about_to(before, Step::WriteFile, &path)?;
    durable::write(&path, &manifest)?;
    about_to(before, Step::FlushFiles, draft)?;
    durable::sync_folder(draft)?;
    Ok(())
}

/// Reads and verifies a checkpoint; otherwise what is wrong with it.
fn read(path: &Path) -> Result<(Checkpoint, Manifest), String> {
    let manifest = Manifest::from_bytes(&read_file(path, MANIFEST, None)?)?;
    let own = name(manifest.iteration);
    // A copy may have any name but that of another iteration.
    if path.file_name().is_some_and(|found| *found != *own && kept::is_name(found)) {
        return Err(format!("its manifest is that of {own}"));
    }
    let mut arrays = NamedArrays::new();
    let mut policy = None;
    for (name, entry) in &manifest.files {
        let bytes = read_file(path, name, Some(entry.size))?;
        entry.verify(name, &bytes)?;
        if name == POLICY {
            policy = Some(bytes);
            continue;
        }
        if name == SETTINGS {
            continue;
        }
        let (group, _) = from_safetensors(&bytes).map_err(|error| format!("{name}: {error}"))?;
        arrays.extend(group);
    }
    let policy = policy.ok_or_else(|| format!("{MANIFEST} names no {POLICY}"))?;
    let (iteration, env_steps) = (manifest.iteration, manifest.env_steps);
    let checkpoint = Checkpoint { iteration, env_steps, arrays, policy };
    manifest.verify(&checkpoint)?;
    Ok((checkpoint, manifest))
}

/// A plain file of the expected size; nothing bigger is ever read.
fn read_file(folder: &Path, name: &str, size: Option<u64>) -> Result<Vec<u8>, String> {
    let path = folder.join(name);
    let found = std::fs::symlink_metadata(&path).map_err(|error| format!("{name}: {error}"))?;
    if !found.is_file() {
        return Err(format!("{name} is not a plain file"));
    }
    let limit = size.unwrap_or(manifest::MAX_BYTES);
    if found.len() > limit || size.is_some_and(|size| found.len() != size) {
        return Err(format!("{name} has {} bytes, expected {limit}", found.len()));
    }
    plain_file::read(&path).map_err(|error| format!("{name}: {error}"))
}

fn reasons(skipped: &[(PathBuf, String)]) -> String {
    let reason = |(path, why): &(PathBuf, String)| {
        format!("{}: {why}", path.file_name().unwrap_or_default().to_string_lossy())
    };
    skipped.iter().map(reason).collect::<Vec<_>>().join("; ")
}
