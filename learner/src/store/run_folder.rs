//! The folder of a run: which process may write to it, and what it says about the run.

mod manifest;
mod place;
mod token;

use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Write as _};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::Value;

use crate::store::durable::{self, FileError};
use crate::store::{checkpoint, json_lines, plain_file};

/// The resolved configuration.
pub const CONFIG: &str = "config.toml";
/// Versions, hashes and the fingerprint.
pub const MANIFEST: &str = "manifest.json";
/// Logs and recordings of actors.
pub const LOGS: &str = "logs";
/// The metrics, one line per iteration and one per evaluation.
pub const METRICS: &str = "metrics.jsonl";
/// Where the weights of each iteration come from.
pub const PROVENANCE: &str = "provenance.jsonl";
/// Folder of the event files of TensorBoard.
pub(crate) const TENSORBOARD: &str = "tensorboard";
/// One line for each start of the learner: what `manifest.json` says of the first.
pub const STARTS: &str = "starts.jsonl";
/// The policies from which training began, if not from random ones.
pub const START_POLICIES: &str = "start_policies.safetensors";
const LOCK: &str = "learner.lock";
/// Where the learner of the latest start listened.
const ADDRESS: &str = "address";
/// Attempts to lock a folder, and the pause after one.
const LOCK_ATTEMPTS: u32 = 50;
const LOCK_PAUSE: Duration = Duration::from_millis(20);
/// Manifest field: whether a result of an actor without a fingerprint counts, which may not be repeatable.
pub const FOREIGN_ACTORS: &str = "foreign_actors";

/// A run folder that this process alone may write to, until it is dropped.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    /// The operating system frees both locks with the process, however that ends. The folder's own lock holds even if
    /// the lock file is deleted; not every file system has it.
    locks: (File, Option<File>),
}

/// Why a folder cannot be used for a run.
#[derive(Debug, thiserror::Error)]
pub enum RunFolderError {
    /// A file or folder could not be written or read.
    #[error(transparent)]
    File(#[from] FileError),
    /// It is not where it was when it was claimed.
    #[error(
        "{path} was renamed, deleted or replaced while this run wrote to it; a resume of the folder, \
         where it is now, continues from its newest checkpoint"
    )]
    Lost {
        /// Where it was.
        path: PathBuf,
    },
    /// A small file of the folder does not hold what it should.
    #[error("{path} is damaged: {detail}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
    /// It holds a run already or none, another learner works on it, it is no place for a run, or the run has other settings.
    #[error("{0}")]
    Other(String),
}

impl RunFolderError {
    /// Whether the file is gone or its content is damaged, so that it is written again.
    fn is_of_lost_file(&self) -> bool {
        match self {
            Self::File(error) => error.source.kind() == ErrorKind::NotFound,
            error => matches!(error, Self::Damaged { .. }),
        }
    }

    fn in_use(path: &Path) -> Self {
        let process = plain_file::read_to_string(&path.join(LOCK)).unwrap_or_default();
        // Without the lock file, the folder's own lock shows that it is in use, but not by which process.
        let process = match process.trim() {
            "" => String::new(),
            process => format!(" (process {process})"),
        };
        Self::Other(format!("{} is in use by another learner{process}", path.display()))
    }
}

impl RunFolder {
    /// Claims a folder for a new run.
    ///
    /// # Errors
    /// The folder holds a run or is inside one, is in use, or cannot be written.
    pub fn claim_new(path: &Path) -> Result<Self, RunFolderError> {
        Self::demand_outside_runs(path)?;
        durable::make_folder(path)?;
        let folder = Self::lock(path)?;
        // A process that was killed may have made the folder without waiting for the disk.
        durable::sync_name(path)?;
        if Self::holds_run(path) {
            let why = "holds a run already; resume it, or choose another folder";
            return Err(RunFolderError::Other(format!("{} {why}", path.display())));
        }
        Ok(folder)
    }

    /// Claims the folder of a run that was started before with the same semantic settings.
    ///
    /// # Errors
    /// The folder holds no run or another one, is in use, or cannot be written.
    pub(crate) fn claim_existing(path: &Path, config_sha256: &str) -> Result<Self, RunFolderError> {
        if !Self::holds_run(path) {
            let why = format!("holds no run to resume: it has no {MANIFEST}");
            return Err(RunFolderError::Other(format!("{} {why}", path.display())));
        }
        let folder = Self::lock(path)?;
        folder.check_manifest(config_sha256)?;
        Ok(folder)
    }

    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A file of the folder.
    #[must_use]
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Writes the settings, a line in `starts.jsonl` and, at the run's first start, the manifest. The manifest makes
    /// the folder a run, so a crash before it leaves a folder that a new run may use.
    ///
    /// # Errors
    /// Names the file that could not be written.
    pub fn begin(&self, config_toml: &str, start: &Value) -> Result<(), RunFolderError> {
        durable::replace(&self.file(CONFIG), config_toml.as_bytes())?;
        json_lines::move_damaged(&self.file(STARTS))?;
        durable::append_line(&self.file(STARTS), &start.to_string())?;
        match self.manifest() {
            Ok(_) => Ok(()),
            Err(why) if !why.is_of_lost_file() => Err(why),
            Err(why) => {
                if let Ok(damaged) = plain_file::read(&self.file(MANIFEST)) {
                    durable::keep_damaged(&self.file(MANIFEST), &damaged)?;
                }
                let mut manifest = start.clone();
                let is_new = !checkpoint::folder(&self.path).is_dir();
                let known = matches!(why, RunFolderError::File(_)) && is_new;
                // Of a manifest that is damaged or lost nothing is known.
                manifest[FOREIGN_ACTORS] = if known { Value::Bool(false) } else { Value::Null };
                manifest::write(&self.file(MANIFEST), manifest)
            }
        }
    }

    /// The manifest of the run in `path`; `None` if it is missing or damaged.
    #[must_use]
    pub fn recorded(path: &Path) -> Option<Value> {
        manifest::read(&path.join(MANIFEST)).ok()
    }

    /// Writes down where this start of the learner listens.
    ///
    /// # Errors
    /// Names the file if it cannot be written.
    pub fn note_address(&self, address: SocketAddr) -> Result<(), RunFolderError> {
        Ok(durable::replace(&self.file(ADDRESS), format!("{address}\n").as_bytes())?)
    }

    /// Records in the manifest that an actor without a fingerprint took part.
    ///
    /// # Errors
    /// Names the manifest if it cannot be read or written.
    pub(crate) fn note_foreign_actors(&self) -> Result<(), RunFolderError> {
        let mut manifest = self.manifest()?;
        if manifest[FOREIGN_ACTORS] == Value::Bool(true) {
            return Ok(());
        }
        manifest[FOREIGN_ACTORS] = Value::Bool(true);
        manifest::write(&self.file(MANIFEST), manifest)
    }

    /// Where the learner that works on the folder at `path` listens; `None` if there is none.
    ///
    /// # Errors
    /// Names a file that cannot be read or is damaged, and a learner that does not listen yet.
    pub fn listening(path: &Path) -> Result<Option<SocketAddr>, RunFolderError> {
        if !Self::is_locked(path)? {
            return Ok(None);
        }
        let place = path.join(ADDRESS);
        match plain_file::read_to_string(&place) {
            Err(error) if error.kind() == ErrorKind::NotFound => {
                Err(RunFolderError::Other(format!(
                    "the learner of {} is starting and does not listen yet; repeat the command in a moment, or name its URL",
                    path.display()
                )))
            }
            address => {
                let address = address.map_err(FileError::of("read", &place))?;
                match address.trim().parse::<SocketAddr>() {
                    Ok(address) => Ok(Some(address)),
                    Err(_) => {
                        let detail = "it holds no address; name the URL of the learner".to_owned();
                        Err(RunFolderError::Damaged { path: place, detail })
                    }
                }
            }
        }
    }

    /// Refuses a folder that a learner uses. Claims nothing: it only reports early what a claim would report.
    ///
    /// # Errors
    /// Names the folder and the learner's process, or a file that cannot be read.
    pub fn demand_free(path: &Path) -> Result<(), RunFolderError> {
        place::demand_plain(path)?;
        Self::demand_unused(path)
    }

    /// Refuses a folder that a learner uses, for commands that only read it, which may hold links.
    ///
    /// # Errors
    /// As [`Self::demand_free`].
    pub fn demand_unused(path: &Path) -> Result<(), RunFolderError> {
        if Self::is_locked(path)? {
            return Err(RunFolderError::in_use(path));
        }
        Ok(())
    }

    /// Refuses the folder of a run that this user cannot write. Claims nothing, as [`Self::demand_free`].
    ///
    /// # Errors
    /// Names the folder and the reason.
    pub fn demand_writable(path: &Path) -> Result<(), FileError> {
        let lock = path.join(LOCK);
        let opened = plain_file::open(File::options().append(true), &lock);
        match opened.map_err(FileError::of("write", path)) {
            Err(error) if error.source.kind() != ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }

    /// Whether a learner works on the folder at `path`.
    ///
    /// # Errors
    /// Names a file that cannot be read.
    pub fn is_locked(path: &Path) -> Result<bool, RunFolderError> {
        if File::open(path)
            .is_ok_and(|folder| matches!(folder.try_lock_shared(), Err(TryLockError::WouldBlock)))
        {
            return Ok(true);
        }
        let lock = path.join(LOCK);
        if lock.symlink_metadata().is_err() {
            return Ok(false);
        }
        let open = plain_file::reader(&lock).map_err(FileError::of("open", &lock))?;
        match open.try_lock_shared() {
            Ok(()) => Ok(false),
            Err(TryLockError::WouldBlock) => Ok(true),
            Err(TryLockError::Error(error)) => Err(place::not_lockable(&lock, &error)),
        }
    }

    fn lock(path: &Path) -> Result<Self, RunFolderError> {
        let folder = File::open(path).ok();
        let locked = folder.as_ref().map(|folder| patiently(|| folder.try_lock()));
        if matches!(locked, Some(Err(TryLockError::WouldBlock))) {
            return Err(RunFolderError::in_use(path));
        }
        place::demand_plain(path)?;
        let place = path.join(LOCK);
        let mut lock = plain_file::append(&place).map_err(FileError::of("open", &place))?;
        match patiently(|| lock.try_lock()) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(RunFolderError::in_use(path)),
            Err(TryLockError::Error(error)) => return Err(place::not_lockable(&place, &error)),
        }
        lock.set_len(0)
            .and_then(|()| writeln!(lock, "{}", std::process::id()))
            .map_err(FileError::of("write", &place))?;
        // Another program may listen by now where an earlier start did.
        let address = path.join(ADDRESS);
        if durable::exists(&address) {
            durable::remove_file(&address)?;
        }
        Ok(Self { path: path.to_path_buf(), locks: (lock, folder) })
    }

    fn check_manifest(&self, expected: &str) -> Result<(), RunFolderError> {
        let manifest = match self.manifest() {
            Ok(manifest) => manifest,
            Err(why) if !why.is_of_lost_file() => return Err(why),
            Err(why) => {
                // The checkpoint has the hash of its settings, too.
                tracing::warn!(
                    "{why}; the manifest is written again, and a damaged one is kept beside it"
                );
                return Ok(());
            }
        };
        let found = manifest["config_sha256"].as_str().unwrap_or_default();
        demand_config(&self.file(MANIFEST), found, expected)
    }

    /// The manifest, which is always an object.
    fn manifest(&self) -> Result<Value, RunFolderError> {
        manifest::read(&self.file(MANIFEST))
    }
}

/// Tries to lock for a second: a command that looks whether the folder is locked holds a lock itself for a moment.
fn patiently(lock: impl Fn() -> Result<(), TryLockError>) -> Result<(), TryLockError> {
    for _ in 0..LOCK_ATTEMPTS {
        match lock() {
            Err(TryLockError::WouldBlock) => std::thread::sleep(LOCK_PAUSE),
            done => return done,
        }
    }
    lock()
}

/// Refuses `path` of a run whose semantic settings have the hash `found`, if this run's have another, `expected`.
pub(crate) fn demand_config(
    path: &Path,
    found: &str,
    expected: &str,
) -> Result<(), RunFolderError> {
    if found == expected {
        return Ok(());
    }
    Err(RunFolderError::Other(format!(
        "{} belongs to a run with config {found}, this one has {expected}: a resume may change nothing that touches \
         results, and raise run.iterations",
        path.display()
    )))
}

#[cfg(test)]
mod tests;
