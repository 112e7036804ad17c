//! Files of a robot's model: an MJCF document and the files that it names, all inside one folder.

use std::collections::BTreeMap;

use crate::error::SimError;

/// Largest file of a model, bytes.
const LARGEST_FILE: usize = 64 << 20;

/// Files that a model may name, each as often as it does.
const MOST_READS: usize = 1000;

/// A robot's model: an MJCF document, the files that it includes, and its meshes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelFiles {
    /// Path of the document among `files`.
    pub document: String,
    /// Contents of the document and of all files that it needs, by their paths relative to the model's folder, with `/`
    /// between their parts.
    pub files: BTreeMap<String, Vec<u8>>,
}

impl ModelFiles {
    /// Collects the files that a document needs. `read` returns the content of a file, or the reason why it cannot be
    /// read. Its paths are relative to the model's folder and never leave it.
    ///
    /// # Errors
    /// If a file cannot be read or the model cannot be built.
    pub fn collect(
        document: &str,
        read: impl Fn(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Self, SimError> {
        let refused = |reason| SimError::Model { robot: document.to_owned(), reason };
        let mut folder = Folder::new(document, &read).map_err(refused)?;
        let text = folder.document().map_err(refused)?;
        super::model::read(&text, &mut folder).map_err(refused)?;
        Ok(Self { document: folder.path.clone(), files: folder.known })
    }

    /// Reads a model as one document. A document that needs no other file is returned unchanged. Otherwise the files that
    /// it includes become part of it, colliding meshes become the corners of their convex hulls, and masses that come
    /// from meshes become `inertial` elements; what has no effect on the motion is left out. `read` is that of
    /// [`Self::collect`].
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
        super::model::read(&text, &mut folder).map_err(refused)?;
        if folder.known.len() == 1 {
            return Ok(text);
        }
        folder.reads = 0;
        super::model::flat(&text, &mut folder).map_err(refused)
    }
}

/// Source of a model's files. It remembers every file that was read.
pub(super) struct Folder<'a> {
    /// Path of the document.
    path: String,
    source: &'a dyn Fn(&str) -> Result<Vec<u8>, String>,
    known: BTreeMap<String, Vec<u8>>,
    /// How often files were read; a document that includes itself in many ways would grow without bound.
    reads: usize,
}

impl<'a> Folder<'a> {
    pub(super) fn new(
        document: &str,
        source: &'a dyn Fn(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Self, String> {
        check_relative(document)?;
        Ok(Self { path: resolved(document)?, source, known: BTreeMap::new(), reads: 0 })
    }

    /// Text of the document.
    pub(super) fn document(&mut self) -> Result<String, String> {
        let path = self.path.clone();
        String::from_utf8(self.content(&path)?).map_err(|_| format!("{path} is not UTF-8 text"))
    }

    /// Path and content of a file that the document names, in the folder `subfolder` next to the document.
    pub(super) fn read(
        &mut self,
        subfolder: &str,
        name: &str,
    ) -> Result<(String, Vec<u8>), String> {
        [subfolder, name].into_iter().try_for_each(check_relative)?;
        let own = self.path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let parts = [own, subfolder, name].into_iter().filter(|part| !part.is_empty());
        let path = resolved(&parts.collect::<Vec<_>>().join("/"))?;
        let bytes = self.content(&path)?;
        Ok((path, bytes))
    }

    fn content(&mut self, path: &str) -> Result<Vec<u8>, String> {
        self.reads += 1;
        if self.reads > MOST_READS {
            return Err(format!("the model names more than {MOST_READS} files"));
        }
        if let Some(bytes) = self.known.get(path) {
            return Ok(bytes.clone());
        }
        let bytes = (self.source)(path)?;
        if bytes.len() > LARGEST_FILE {
            return Err(format!("{path} has more than {LARGEST_FILE} bytes"));
        }
        self.known.insert(path.to_owned(), bytes.clone());
        Ok(bytes)
    }
}

fn check_relative(path: &str) -> Result<(), String> {
    match path.starts_with(['/', '\\']) || path.contains(':') {
        true => Err(format!("`{path}` is an absolute path; name files by relative paths")),
        false => Ok(()),
    }
}

/// A path without `.` and `..`.
fn resolved(path: &str) -> Result<String, String> {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split(['/', '\\']) {
        match part {
            "" | "." => {}
            ".." if parts.pop().is_none() => {
                return Err(format!("`{path}` leaves the model's folder"));
            }
            ".." => {}
            part => parts.push(part),
        }
    }
    if parts.is_empty() { Err(format!("`{path}` names no file")) } else { Ok(parts.join("/")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_stays_inside_the_folder() {
        assert_eq!(resolved("a/./b/../c.stl").unwrap(), "a/c.stl");
        assert!(resolved("a/../../c.stl").unwrap_err().contains("leaves the model's folder"));
        let source = |path: &str| Ok(path.as_bytes().to_vec());
        let mut folder = Folder::new("robots/arm.xml", &source).unwrap();
        assert_eq!(folder.read("../meshes", "hand.stl").unwrap().0, "meshes/hand.stl");
        assert!(folder.read("", "/etc/hand.stl").unwrap_err().contains("absolute path"));
        assert!(folder.read("../..", "hand.stl").is_err());
        let refusal = |document| Folder::new(document, &source).err().unwrap();
        assert!(refusal("/robots/arm.xml").contains("absolute path"));
        assert!(refusal("../arm.xml").contains("leaves the model's folder"));
    }
}
