//! A checkpoint's manifest: what the checkpoint is, and every file with its size and hash.

use std::collections::BTreeMap;
use std::io::{self, Write};

use policy::arrays::hex;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::{Checkpoint, Saved};

/// Layout of checkpoints that this program writes and reads.
pub const SCHEMA: u32 = 2;

/// No manifest is bigger.
pub(super) const MAX_BYTES: u64 = 1 << 20;

/// What a checkpoint is, and its files. It holds no time and no place: equal states give equal bytes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Layout of the checkpoint.
    pub schema: u32,
    /// Hash of the run's semantic settings.
    pub config_sha256: String,
    /// Finished iterations.
    pub iteration: u64,
    /// Environment steps of all finished iterations.
    pub env_steps: u64,
    /// Hash of the weights.
    pub weights_sha256: String,
    /// Hash of all state that training depends on.
    pub state_sha256: String,
    /// Every other file of the directory.
    pub files: BTreeMap<String, FileEntry>,
    /// Hash of this manifest with this field empty.
    pub manifest_sha256: String,
}

/// One file of a checkpoint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileEntry {
    /// Bytes.
    pub size: u64,
    /// Hash of the bytes.
    pub sha256: String,
}

impl Manifest {
    /// Describes a checkpoint with the hashes in `saved` and these files.
    pub(super) fn of(
        (checkpoint, saved): (&Checkpoint, &Saved),
        config_sha256: &str,
        files: BTreeMap<String, FileEntry>,
    ) -> Self {
        let mut manifest = Self {
            schema: SCHEMA,
            config_sha256: config_sha256.to_owned(),
            iteration: checkpoint.iteration,
            env_steps: checkpoint.env_steps,
            weights_sha256: saved.weights_sha256.clone(),
            state_sha256: saved.state_sha256.clone(),
            files,
            manifest_sha256: String::new(),
        };
        manifest.manifest_sha256 = manifest.own_sha256();
        manifest
    }

    /// The content of the manifest's file.
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = serde_json::to_vec_pretty(self).expect("text keys and plain values");
        bytes.push(b'\n');
        bytes
    }

    /// Reads a manifest; refuses one in which any byte has changed.
    pub(super) fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let unreadable =
            |error: serde_json::Error| format!("manifest.json cannot be read: {error}");
        let value: serde_json::Value = serde_json::from_slice(bytes).map_err(unreadable)?;
        let schema = value.get("schema").and_then(serde_json::Value::as_u64);
        if schema != Some(u64::from(SCHEMA)) {
            let found = schema.map_or("none".to_owned(), |schema| schema.to_string());
            return Err(format!(
                "manifest.json has schema {found}, this program reads {SCHEMA}: it was made by another version; train again"
            ));
        }
        let manifest: Self = serde_json::from_value(value).map_err(unreadable)?;
        if manifest.own_sha256() != manifest.manifest_sha256 || manifest.to_bytes() != bytes {
            return Err("manifest.json does not have its own hash".to_owned());
        }
        match manifest.files.keys().find(|name| !is_plain_name(name)) {
            Some(name) => Err(format!("manifest.json names the file {name:?}")),
            None => Ok(manifest),
        }
    }

    /// Compares the hashes of the content with the recorded ones.
    pub(super) fn verify(&self, checkpoint: &Checkpoint) -> Result<(), String> {
        for (what, recorded, found) in [
            ("weights", &self.weights_sha256, checkpoint.weights_sha256()),
            ("state", &self.state_sha256, checkpoint.state_sha256()),
        ] {
            if *recorded != found {
                return Err(format!(
                    "the SHA-256 of the {what} is {found}, manifest.json says {recorded}"
                ));
            }
        }
        Ok(())
    }

    fn own_sha256(&self) -> String {
        let bare = Self { manifest_sha256: String::new(), ..self.clone() };
        hex(&Sha256::digest(bare.to_bytes()))
    }
}

impl FileEntry {
    /// Compares the hash of a file's bytes with the recorded one.
    pub(super) fn verify(&self, name: &str, bytes: &[u8]) -> Result<(), String> {
        let found = hex(&Sha256::digest(bytes));
        if found == self.sha256 {
            return Ok(());
        }
        Err(format!("{name} has SHA-256 {found}, manifest.json says {}", self.sha256))
    }
}

/// Describes the file that is written through it.
pub(super) struct Described<W> {
    to: W,
    size: u64,
    hash: Sha256,
}

impl<W> Described<W> {
    pub(super) fn new(to: W) -> Self {
        Self { to, size: 0, hash: Sha256::new() }
    }

    pub(super) fn entry(self) -> FileEntry {
        FileEntry { size: self.size, sha256: hex(&self.hash.finalize()) }
    }
}

impl<W: Write> Write for Described<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.to.write(bytes)?;
        self.hash.update(&bytes[..count]);
        self.size += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}

/// A name that cannot lead out of the directory.
fn is_plain_name(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_lowercase() || c == '_' || c == '.';
    !name.starts_with('.') && name.chars().all(plain)
}
