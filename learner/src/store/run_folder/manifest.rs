//! The manifest of a run folder: a JSON object that holds its own hash, so that any change is noticed.

use std::path::Path;

use proto::Digest;
use serde_json::Value;

use super::RunFolderError;
use crate::store::durable::{self, FileError};
use crate::store::plain_file;

/// Manifest field: hash of the manifest with this field empty.
const MANIFEST_SHA256: &str = "manifest_sha256";

/// Writes a manifest with its own hash.
pub(super) fn write(path: &Path, mut manifest: Value) -> Result<(), RunFolderError> {
    manifest[MANIFEST_SHA256] = Value::String(String::new());
    let sha256 = Digest::of(format!("{manifest:#}").as_bytes()).to_string();
    manifest[MANIFEST_SHA256] = Value::String(sha256);
    Ok(durable::replace(path, format!("{manifest:#}\n").as_bytes())?)
}

/// Reads a manifest; refuses one that has changed since it was written.
pub(super) fn read(path: &Path) -> Result<Value, RunFolderError> {
    let damaged = |detail: String| RunFolderError::Damaged { path: path.to_path_buf(), detail };
    let bytes = plain_file::read(path).map_err(FileError::of("read", path))?;
    let mut manifest: Value =
        serde_json::from_slice(&bytes).map_err(|error| damaged(error.to_string()))?;
    let object = manifest.as_object_mut().ok_or_else(|| damaged("it is no object".to_owned()))?;
    let empty = Value::String(String::new());
    let recorded = object.insert(MANIFEST_SHA256.to_owned(), empty);
    let found = Digest::of(format!("{manifest:#}").as_bytes()).to_string();
    match recorded {
        Some(Value::String(recorded)) if recorded == found => {
            manifest[MANIFEST_SHA256] = Value::String(recorded);
            Ok(manifest)
        }
        _ => Err(damaged("its content does not have its SHA-256".to_owned())),
    }
}
