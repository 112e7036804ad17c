//! What the files of a checkpoint hold, and how they are written.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

use policy::arrays::{Array, ArrayError, write_safetensors};

use super::manifest::{Described, FileEntry};
use super::{Checkpoint, CheckpointError, GROUPS, POLICY, SETTINGS, fields};
use crate::store::durable::{self, FileError};

/// What a file holds.
pub(super) enum Content<'a> {
    /// These bytes.
    Bytes(&'a [u8]),
    /// Arrays, as a safetensors file.
    Arrays(Vec<(&'a String, &'a Array)>),
}

/// What the files but the manifest hold, by name: the settings, the policies, and one file per group of arrays.
///
/// # Errors
/// Names an array of no group.
pub(super) fn contents<'a>(
    checkpoint: &'a Checkpoint,
    settings: &'a str,
) -> Result<BTreeMap<String, Content<'a>>, CheckpointError> {
    let mut groups: BTreeMap<&str, Vec<(&String, &Array)>> = BTreeMap::new();
    for (name, array) in &checkpoint.arrays {
        let group = name.split('/').next().unwrap_or_default();
        if !GROUPS.contains(&group) {
            let detail = format!("belongs to none of the groups {}", GROUPS.join(", "));
            return Err(fields::wrong(name, &detail));
        }
        groups.entry(group).or_default().push((name, array));
    }
    let groups = groups.into_iter();
    let groups =
        groups.map(|(group, arrays)| (format!("{group}.safetensors"), Content::Arrays(arrays)));
    let others = [
        (SETTINGS.to_owned(), Content::Bytes(settings.as_bytes())),
        (POLICY.to_owned(), Content::Bytes(&checkpoint.policy)),
    ];
    Ok(groups.chain(others).collect())
}

impl Content<'_> {
    /// Writes the file and describes it. Arrays are encoded one after the other, so that a replay buffer needs no second copy.
    ///
    /// # Errors
    /// Names the file that could not be written, or the array whose length does not match its shape.
    pub(super) fn write(self, path: &Path) -> Result<FileEntry, CheckpointError> {
        durable::write_by(path, |file| {
            let mut file = Described::new(file);
            let written = match self {
                Self::Bytes(bytes) => file.write_all(bytes).map_err(ArrayError::from),
                Self::Arrays(arrays) => write_safetensors(arrays, &BTreeMap::new(), &mut file),
            };
            match written {
                Ok(()) => Ok(file.entry()),
                Err(ArrayError::Write(why)) => Err(FileError::of("write", path)(why).into()),
                Err(other) => Err(other.into()),
            }
        })
    }
}
