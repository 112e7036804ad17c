//! A file of one JSON object per line, each of an iteration, which a resume cuts back to the
//! checkpoint from which it goes on.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::durable::{self, FileError};

/// A file of JSON lines, open for more.
#[derive(Debug)]
pub struct JsonLines {
    path: PathBuf,
    file: File,
}

impl JsonLines {
    /// Opens the file and drops every line past `iteration`, also half a line that a crash left.
    /// Returns the lines that stay, too.
    ///
    /// # Errors
    /// Names the file if it cannot be read or written.
    pub fn cut(path: &Path, iteration: u64) -> Result<(Self, Vec<Value>), FileError> {
        let text = match std::fs::read(path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Vec::new(),
            bytes => bytes.map_err(FileError::of("read", path))?,
        };
        let lines = text.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
        let mut kept = Vec::new();
        let mut content = Vec::new();
        for line in lines {
            if let Some(value) = line_up_to(iteration, line) {
                content.extend_from_slice(line);
                content.push(b'\n');
                kept.push(value);
            }
        }
        if content != text {
            durable::replace(path, &content)?;
        }
        let file = OpenOptions::new().create(true).append(true).open(path);
        let file = file.map_err(FileError::of("open", path))?;
        Ok((Self { path: path.to_path_buf(), file }, kept))
    }

    /// Adds one line.
    ///
    /// # Errors
    /// Names the file if it cannot be written.
    pub fn append(&mut self, value: &Value) -> Result<(), FileError> {
        let line = format!("{value}\n");
        self.file.write_all(line.as_bytes()).map_err(FileError::of("append to", &self.path))
    }

    /// Waits until the disk has all lines.
    ///
    /// # Errors
    /// Names the file if it cannot be flushed.
    pub fn sync(&self) -> Result<(), FileError> {
        self.file.sync_data().map_err(FileError::of("flush", &self.path))
    }
}

fn line_up_to(iteration: u64, line: &[u8]) -> Option<Value> {
    let value: Value = serde_json::from_slice(line).ok()?;
    let found = value.get("iteration")?.as_u64()?;
    (found <= iteration).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_cut_keeps_each_iteration_up_to_the_checkpoint_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let (mut lines, kept) = JsonLines::cut(&path, 0).unwrap();
        assert!(kept.is_empty());
        for iteration in 0..5 {
            lines.append(&json!({"iteration": iteration, "x": 0.5})).unwrap();
        }
        // The process died in the middle of a line.
        lines.file.write_all(b"{\"iteration\": 2, \"x\"").unwrap();
        drop(lines);
        let (mut lines, kept) = JsonLines::cut(&path, 2).unwrap();
        assert_eq!(kept.len(), 3);
        for iteration in 3..5 {
            lines.append(&json!({"iteration": iteration, "x": 0.5})).unwrap();
        }
        lines.sync().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let iterations = text.lines().map(|line| {
            serde_json::from_str::<Value>(line).unwrap()["iteration"].as_u64().unwrap()
        });
        assert_eq!(iterations.collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    }

    #[test]
    fn a_file_that_needs_no_cut_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        std::fs::write(&path, "{\"iteration\":1}\n").unwrap();
        let before = std::fs::metadata(&path).unwrap().modified().unwrap();
        JsonLines::cut(&path, 1).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().modified().unwrap(), before);
    }
}
