//! Reads a model that names other files as one document.

use super::folder::Folder;
use super::model;
use crate::error::SimError;

/// Reads a model as one document. A document that needs no other file is returned unchanged. Otherwise the files that
/// it includes become part of it, colliding meshes become the corners of their convex hulls, and masses that come
/// from meshes become `inertial` elements; what has no effect on the motion is left out. `read` returns the content of
/// a file, or the reason why it cannot be read. Its paths are relative to the model's folder and never leave it.
///
/// # Errors
/// If a file cannot be read or the model cannot be built.
pub fn one_document(
    document: &str,
    read: impl Fn(&str) -> Result<Vec<u8>, String>,
) -> Result<String, SimError> {
    let refused = |reason| SimError::Model { robot: document.to_owned(), reason };
    let mut folder = Folder::new(document, &read).map_err(refused)?;
    let text = folder.document().map_err(refused)?;
    model::read(&text, &mut folder).map_err(refused)?;
    if folder.known.len() == 1 {
        return Ok(text);
    }
    folder.recount();
    model::flat(&text, &mut folder).map_err(refused)
}
