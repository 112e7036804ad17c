//! The folder of a robot's model, which holds the MJCF document and all files that it names.

use std::collections::BTreeMap;

/// Largest file of a model, bytes.
const LARGEST_FILE: usize = 64 << 20;
/// Start of a file that Git LFS has not fetched.
const LFS_POINTER: &[u8] = b"version https://git-lfs";
/// Largest MJCF file, bytes: a parsed file takes many times its size.
const LARGEST_DOCUMENT: usize = 4 << 20;
/// Most bytes of all files, each counted as often as it is named.
const MOST_BYTES: usize = 256 << 20;
/// Most elements of a document and of all files that it includes.
const MOST_ELEMENTS: usize = 20_000;

/// Files that a model may name, each as often as it does.
const MOST_READS: usize = 1000;

/// Source of a model's files. It remembers every file that was read.
pub(super) struct Folder<'a> {
    /// Path of the document.
    pub(super) path: String,
    source: &'a dyn Fn(&str) -> Result<Vec<u8>, String>,
    /// Contents of the files read so far, by path.
    pub(super) known: BTreeMap<String, Vec<u8>>,
    /// What was read so far; a document that includes a file in many ways would grow without bound.
    total: Total,
}

#[derive(Default)]
struct Total {
    files: usize,
    bytes: usize,
    elements: usize,
    copied: usize,
}

impl<'a> Folder<'a> {
    pub(super) fn new(
        document: &str,
        source: &'a dyn Fn(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Self, String> {
        check_relative(document)?;
        Ok(Self {
            path: resolved(document)?,
            source,
            known: BTreeMap::new(),
            total: Total::default(),
        })
    }

    /// Starts counting again, for another pass over the same document.
    pub(super) fn recount(&mut self) {
        self.total = Total::default();
    }

    /// Counts an element of the document or of an included file.
    pub(super) fn count_element(&mut self) -> Result<(), String> {
        self.total.elements += 1;
        if self.total.elements <= MOST_ELEMENTS {
            Ok(())
        } else {
            Err(format!("the model has more than {MOST_ELEMENTS} elements; remove some"))
        }
    }

    /// Counts the bytes of an element's copy before it is made: together, copies may be as large as a document.
    pub(super) fn count_copy(&mut self, bytes: usize) -> Result<(), String> {
        self.count_element()?;
        self.total.copied += bytes;
        if self.total.copied <= LARGEST_DOCUMENT {
            Ok(())
        } else {
            Err(format!(
                "the copies of `replicate` have more than {LARGEST_DOCUMENT} bytes; make fewer"
            ))
        }
    }

    /// Text of the document.
    pub(super) fn document(&mut self) -> Result<String, String> {
        let path = self.path.clone();
        self.content(&path).and_then(|bytes| text(&path, bytes))
    }

    /// Path and text of a document that an element of the file `stated_in` names; `None` for the document itself.
    pub(super) fn read_document(
        &mut self,
        name: &str,
        stated_in: Option<&str>,
    ) -> Result<(String, String), String> {
        let (path, bytes) = self.read("", name, stated_in)?;
        text(&path, bytes).map(|text| (path, text))
    }

    /// Path and content of a file that an element of the file `stated_in` names, in the folder `subfolder` next to the document.
    /// As in MuJoCo, an included file may have files next to itself, in no subfolder.
    pub(super) fn read(
        &mut self,
        subfolder: &str,
        name: &str,
        stated_in: Option<&str>,
    ) -> Result<(String, Vec<u8>), String> {
        [subfolder, name].into_iter().try_for_each(check_relative)?;
        let own = folder_of(&self.path).to_owned();
        let found = self.read_from([&own, subfolder, name]);
        match (found, stated_in.map(folder_of)) {
            (Err(reason), Some(beside)) => self.read_from([beside, "", name]).map_err(|other| {
                if other == reason {
                    return reason;
                }
                format!("{reason}, and beside the file that names it: {other}")
            }),
            (found, _) => found,
        }
    }

    fn read_from(&mut self, parts: [&str; 3]) -> Result<(String, Vec<u8>), String> {
        let parts = parts.into_iter().filter(|part| !part.is_empty());
        let path = resolved(&parts.collect::<Vec<_>>().join("/"))?;
        let bytes = self.content(&path)?;
        Ok((path, bytes))
    }

    fn content(&mut self, path: &str) -> Result<Vec<u8>, String> {
        self.total.files += 1;
        if self.total.files > MOST_READS {
            return Err(format!("the model names more than {MOST_READS} files"));
        }
        let bytes = match self.known.get(path) {
            Some(bytes) => bytes.clone(),
            None => (self.source)(path)?,
        };
        if bytes.starts_with(LFS_POINTER) {
            return Err(format!(
                "{path} is a pointer of Git LFS, not the file; run `git lfs pull`"
            ));
        }
        if bytes.len() > LARGEST_FILE {
            return Err(format!("{path} has more than {LARGEST_FILE} bytes"));
        }
        self.total.bytes += bytes.len();
        if self.total.bytes > MOST_BYTES {
            return Err(format!("the files of the model have more than {MOST_BYTES} bytes"));
        }
        if !self.known.contains_key(path) {
            self.known.insert(path.to_owned(), bytes.clone());
        }
        Ok(bytes)
    }
}

fn folder_of(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}

/// Text of an MJCF file.
fn text(path: &str, bytes: Vec<u8>) -> Result<String, String> {
    if bytes.len() > LARGEST_DOCUMENT {
        return Err(format!("{path} has {} bytes, at most {LARGEST_DOCUMENT}", bytes.len()));
    }
    String::from_utf8(bytes).map_err(|_| format!("{path} is not UTF-8 text; save it as UTF-8"))
}

fn check_relative(path: &str) -> Result<(), String> {
    if path.starts_with(['/', '\\']) || path.contains(':') {
        Err(format!("`{path}` is an absolute path; name files by relative paths"))
    } else {
        Ok(())
    }
}

/// A path without `.` and `..`.
fn resolved(path: &str) -> Result<String, String> {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split(['/', '\\']) {
        match part {
            "" | "." => {}
            ".." if parts.pop().is_none() => {
                return Err(format!(
                    "`{path}` leaves the model's folder; put the task file into a folder that holds both"
                ));
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

    /// MuJoCo 4.0.0 finds them in the same places: the folder of meshes next to the document counts first.
    #[test]
    fn a_file_is_beside_the_document_or_the_file_that_names_it() {
        let source = |path: &str| match path {
            "a.xml" | "b/a.xml" | "b/c.xml" | "m/b.stl" | "b/b.stl" => Ok(path.as_bytes().to_vec()),
            _ => Err(format!("{path} does not exist")),
        };
        let mut folder = Folder::new("robot.xml", &source).unwrap();
        let mut read = |subfolder, name| folder.read(subfolder, name, Some("b/include.xml"));
        assert_eq!(read("", "a.xml").unwrap().0, "a.xml");
        assert_eq!(read("", "c.xml").unwrap().0, "b/c.xml");
        assert_eq!(read("", "../m/b.stl").unwrap().0, "m/b.stl");
        let both =
            "d.xml does not exist, and beside the file that names it: b/d.xml does not exist";
        assert_eq!(read("", "d.xml").unwrap_err(), both);
        assert_eq!(read("m", "b.stl").unwrap().0, "m/b.stl");
        assert_eq!(read("m", "c.xml").unwrap().0, "b/c.xml");
        assert_eq!(read("m", "a.xml").unwrap().0, "b/a.xml");
        assert_eq!(read("b", "d.xml").unwrap_err(), "b/d.xml does not exist");
        assert_eq!(folder.read("m", "a.xml", None).unwrap_err(), "m/a.xml does not exist");
    }

    #[test]
    fn a_file_that_git_lfs_has_not_fetched_is_named_with_what_to_do() {
        let source = |_: &str| Ok(b"version https://git-lfs.github.com/spec/v1\noid".to_vec());
        let mut folder = Folder::new("robot.xml", &source).unwrap();
        let refused = "is a pointer of Git LFS, not the file; run `git lfs pull`";
        assert_eq!(folder.read("", "a.stl", None).unwrap_err(), format!("a.stl {refused}"));
        assert_eq!(folder.document().unwrap_err(), format!("robot.xml {refused}"));
    }

    #[test]
    fn a_path_stays_inside_the_folder() {
        assert_eq!(resolved("a/./b/../c.stl").unwrap(), "a/c.stl");
        assert!(resolved("a/../../c.stl").unwrap_err().contains("leaves the model's folder"));
        let source = |path: &str| Ok(path.as_bytes().to_vec());
        let mut folder = Folder::new("robots/arm.xml", &source).unwrap();
        assert_eq!(folder.read("../meshes", "hand.stl", None).unwrap().0, "meshes/hand.stl");
        assert!(folder.read("", "/etc/hand.stl", None).unwrap_err().contains("absolute path"));
        assert!(folder.read("../..", "hand.stl", None).is_err());
        let refusal = |document| Folder::new(document, &source).err().unwrap();
        assert!(refusal("/robots/arm.xml").contains("absolute path"));
        assert!(refusal("../arm.xml").contains("leaves the model's folder"));
    }
}
