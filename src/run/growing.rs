//! The curves of a run, read from its metrics as they grow.

use std::io::{Read as _, Seek as _, SeekFrom};
use std::os::unix::fs::MetadataExt as _;
use std::path::PathBuf;

use learner::metrics::Curves;
use learner::plain_file;
use serde_json::{Map, Value};

use crate::run::run_path;

/// The curves of a run, as far as they have been read.
pub(crate) struct Growing {
    lines: Lines,
    curves: Curves,
    /// Lines that are no JSON objects.
    damaged: u64,
    /// Why the file could not be read at the last attempt.
    error: Option<String>,
}

impl Growing {
    /// From this file, which need not exist yet.
    pub(crate) fn of(metrics: PathBuf) -> Self {
        let (lines, curves) = (Lines::of(metrics), Curves::default());
        Self { lines, curves, damaged: 0, error: None }
    }

    /// The curves that have been read.
    pub(crate) fn get(&self) -> &Curves {
        &self.curves
    }

    /// What of the file cannot be read, if anything.
    pub(crate) fn trouble(&self) -> Option<String> {
        let damage = match self.damaged {
            0 => None,
            1 => Some("1 damaged line is skipped".to_owned()),
            lines => Some(format!("{lines} damaged lines are skipped")),
        };
        let name = run_path::file_name(&self.lines.path).unwrap_or_default();
        self.error.clone().or(damage).map(|why| format!("{name}: {why}"))
    }

    /// Reads what is new, and returns whether anything is. A file that cannot be read is tried again; each new reason is
    /// reported once.
    pub(crate) fn follow(&mut self) -> bool {
        match self.lines.more() {
            Ok(more) => {
                let mended = self.error.take().is_some();
                if more.from_the_start {
                    (self.curves, self.damaged) = (Curves::default(), 0);
                }
                self.damaged += more.damaged;
                more.lines.iter().for_each(|line| self.curves.add(line));
                mended || more.damaged > 0 || !more.lines.is_empty()
            }
            Err(error) => {
                let error = error.to_string();
                let is_new = self.error.as_ref() != Some(&error);
                if is_new {
                    tracing::warn!("{}: {error}", self.lines.path.display());
                }
                self.error = Some(error);
                is_new
            }
        }
    }
}

/// A file of JSON objects that grows, and may be cut back by a resume.
struct Lines {
    path: PathBuf,
    /// Which file stood at the path.
    inode: u64,
    /// Bytes of it that have been read.
    read: u64,
}

/// What has come since.
struct More {
    lines: Vec<Map<String, Value>>,
    /// Number of whole lines that are no JSON objects.
    damaged: u64,
    /// Whether they are all there are: the file is another one than before.
    from_the_start: bool,
}

impl Lines {
    fn of(path: PathBuf) -> Self {
        Self { path, inode: 0, read: 0 }
    }

    /// The whole lines that have not been read yet; none if there is no file.
    fn more(&mut self) -> std::io::Result<More> {
        let mut file = match plain_file::reader(&self.path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(More { lines: Vec::new(), damaged: 0, from_the_start: false });
            }
            opened => opened?,
        };
        let found = file.metadata()?;
        let from_the_start = found.ino() != self.inode || found.len() < self.read;
        if from_the_start {
            (self.inode, self.read) = (found.ino(), 0);
        }
        file.seek(SeekFrom::Start(self.read))?;
        let mut text = Vec::new();
        file.read_to_end(&mut text)?;
        let whole = text.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        self.read += whole as u64;
        let texts = text[..whole].split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
        let (mut lines, mut damaged) = (Vec::new(), 0);
        for text in texts {
            match serde_json::from_slice(text) {
                Ok(line) => lines.push(line),
                Err(_) => damaged += 1,
            }
        }
        Ok(More { lines, damaged, from_the_start })
    }
}

#[cfg(test)]
mod tests {
    use std::fs::OpenOptions;
    use std::io::Write as _;
    use std::path::Path;

    use super::*;

    fn append(path: &Path, text: &str) {
        let mut file = OpenOptions::new().create(true).append(true).open(path).unwrap();
        file.write_all(text.as_bytes()).unwrap();
    }

    fn more(lines: &mut Lines) -> (Vec<u64>, bool) {
        let More { lines, from_the_start, .. } = lines.more().unwrap();
        (lines.iter().map(|line| line["iteration"].as_u64().unwrap()).collect(), from_the_start)
    }

    #[test]
    fn each_line_is_read_once_and_only_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let mut lines = Lines::of(path.clone());
        assert_eq!(more(&mut lines), (vec![], false));
        append(&path, "{\"iteration\":1}\n{\"itera");
        assert_eq!(more(&mut lines), (vec![1], true));
        assert_eq!(more(&mut lines), (vec![], false));
        append(&path, "tion\":2}\n");
        assert_eq!(more(&mut lines), (vec![2], false));
    }

    #[test]
    fn damaged_lines_are_counted_and_skipped() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let mut growing = Growing::of(path.clone());
        append(&path, "{\"env_steps\":40,\"a\":1}\n\0\0\0\n{\"env_st\n");
        assert!(growing.follow());
        assert_eq!(growing.get().newest("a"), Some(1.0));
        let trouble = "metrics.jsonl: 2 damaged lines are skipped";
        assert_eq!(growing.trouble().as_deref(), Some(trouble));
        assert!(!growing.follow());
    }

    #[test]
    fn a_file_that_cannot_be_read_is_reported_once_until_it_can_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        std::fs::create_dir(&path).unwrap();
        let mut growing = Growing::of(path.clone());
        assert_eq!([growing.follow(), growing.follow()], [true, false]);
        assert!(growing.trouble().unwrap().contains("directory"), "{:?}", growing.trouble());
        std::fs::remove_dir(&path).unwrap();
        assert_eq!((growing.follow(), growing.trouble()), (true, None));
    }

    #[test]
    fn a_file_that_a_resume_has_cut_back_is_read_from_its_start() {
        let folder = tempfile::tempdir().unwrap();
        let (path, cut) = (folder.path().join("metrics.jsonl"), folder.path().join("cut"));
        let mut lines = Lines::of(path.clone());
        append(&path, "{\"iteration\":1}\n{\"iteration\":2}\n");
        assert_eq!(more(&mut lines), (vec![1, 2], true));
        // As long as before, so that its length would not tell.
        append(&cut, "{\"iteration\":1}\n{\"iteration\":3}\n");
        std::fs::rename(&cut, &path).unwrap();
        assert_eq!(more(&mut lines), (vec![1, 3], true));
    }
}
