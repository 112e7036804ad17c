//! The folder of a robot's model, which holds the MJCF document and all files that it names.

use std::collections::BTreeMap;

/// Largest file of a model, bytes.
const LARGEST_FILE: usize = 64 << 20;

/// Files that a model may name, each as often as it does.
const MOST_READS: usize = 1000;

/// Source of a model's files. It remembers every file that was read.
pub(super) struct Folder<'a> {
    /// Path of the document.
    pub(super) path: String,
    source: &'a dyn Fn(&str) -> Result<Vec<u8>, String>,
    /// Contents of the files read so far, by path.
    pub(super) known: BTreeMap<String, Vec<u8>>,
    /// How often files were read; a document that includes itself in many ways would grow without bound.
    pub(super) reads: usize,
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
