//! Files of one JSON object per line, each of an iteration, which a resume cuts back to its checkpoint: written by a
//! learner, and read while they grow.

mod sorted;

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{ErrorKind, Read as _, Seek as _, SeekFrom, Write as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::store::durable::{self, FileError};
use crate::store::json_lines::sorted::SortedLines;
use crate::store::plain_file;

/// Most bytes that are buffered while the disk cannot be written; above it, `append` fails.
const MOST_WAITING: usize = 16 << 20;

/// A file of JSON lines, open for more. What the disk does not take waits, whole, for the next line.
#[derive(Debug)]
pub struct JsonLines {
    path: PathBuf,
    file: File,
    /// Written to the file in order, half a line too if the disk fills up in the middle of it.
    waiting: Vec<u8>,
}

impl JsonLines {
    /// Opens the file and drops every line past `iteration`, also half a line that a crash left.
    /// Returns the lines that stay, too, and warns of iterations up to `iteration` that have none.
    /// Damaged lines are moved to a file beside it, as are all lines of a run that begins again: its checkpoints may
    /// be elsewhere.
    ///
    /// # Errors
    /// Names the file if it cannot be read or written.
    pub fn cut(path: &Path, iteration: u64) -> Result<(Self, Vec<Value>), FileError> {
        let text = plain_file::read_if_present(path).map_err(FileError::of("read", path))?;
        let SortedLines { content, kept, damaged, earlier } = SortedLines::of(&text, iteration);
        move_away(path, &damaged, "damaged")?;
        move_away(path, &earlier, "earlier")?;
        if content != text {
            durable::replace(path, &content)?;
        }
        let file = opened(path)?;
        let lost = gaps(&iterations(&kept), iteration);
        if !lost.is_empty() {
            tracing::warn!("{} has no lines of iterations {}", path.display(), lost.join(", "));
        }
        Ok((Self { path: path.to_path_buf(), file, waiting: Vec::new() }, kept))
    }

    /// Adds one line. If the file cannot be written, that is logged, and the line waits.
    ///
    /// # Errors
    /// Names the file if 16 MiB wait already.
    pub fn append(&mut self, value: &Value) -> Result<(), FileError> {
        self.waiting.extend_from_slice(format!("{value}\n").as_bytes());
        match self.write_waiting() {
            Err(error) if self.waiting.len() <= MOST_WAITING => {
                let then = "the line waits; training continues";
                tracing::error!(waiting_bytes = self.waiting.len(), "{error}; {then}");
                Ok(())
            }
            written => written,
        }
    }

    fn write_waiting(&mut self) -> Result<(), FileError> {
        if !durable::leads_to(&self.path, &self.file) {
            let path = self.path.display();
            tracing::error!(
                "{path} was removed or replaced; the run continues in the file that has this name now"
            );
            self.file = opened(&self.path)?;
        }
        while !self.waiting.is_empty() {
            let written = match self.file.write(&self.waiting) {
                Ok(0) => Err(ErrorKind::WriteZero.into()),
                Err(error) if error.kind() == ErrorKind::Interrupted => Ok(0),
                written => written,
            };
            let written = written.map_err(FileError::of("append to", &self.path))?;
            self.waiting.drain(..written);
        }
        Ok(())
    }

    /// Waits until the disk has all lines.
    ///
    /// # Errors
    /// Names the file if it cannot be flushed, or if lines wait that still cannot be written.
    pub fn sync(&mut self) -> Result<(), FileError> {
        self.write_waiting()?;
        self.file.sync_data().map_err(FileError::of("flush", &self.path))
    }
}

/// Moves whole lines of a file that are no JSON objects into one beside it. Then half a line at the end is dropped.
///
/// # Errors
/// Names the file if it cannot be read or written.
pub(crate) fn move_damaged(path: &Path) -> Result<(), FileError> {
    let text = plain_file::read_if_present(path).map_err(FileError::of("read", path))?;
    let lines = text[..durable::whole_lines(&text)].split_inclusive(|byte| *byte == b'\n');
    let (whole, damaged): (Vec<&[u8]>, Vec<&[u8]>) =
        lines.partition(|line| matches!(serde_json::from_slice(line), Ok(Value::Object(_))));
    if damaged.is_empty() {
        return Ok(());
    }
    let damaged: Vec<_> = damaged.iter().map(|line| line.trim_ascii_end()).collect();
    move_away(path, &damaged, "damaged")?;
    durable::replace(path, &whole.concat())
}

/// Moves these lines of a file into one beside it, and warns of them as lines of this `kind`.
fn move_away(path: &Path, lines: &[&[u8]], kind: &str) -> Result<(), FileError> {
    if lines.is_empty() {
        return Ok(());
    }
    let ended = lines.iter().flat_map(|line| [line, b"\n".as_slice()]);
    let kept = durable::keep_damaged(path, &ended.collect::<Vec<_>>().concat())?;
    let (shown, kept) = (path.display(), kept.display());
    match lines.len() {
        1 => tracing::warn!("{shown} has 1 {kind} line, which is moved to {kept}"),
        count => tracing::warn!("{shown} has {count} {kind} lines, which are moved to {kept}"),
    }
    Ok(())
}

/// Reads a file of JSON objects that grows, and that a resume may cut back. Each whole line is read once.
#[derive(Clone, Debug)]
pub struct JsonLinesReader {
    path: PathBuf,
    /// Which file was at the path.
    inode: u64,
    /// Bytes of it that have been read.
    read: u64,
}

/// The lines of a file since the last look.
#[derive(Clone, Debug, Default)]
pub struct NewLines {
    /// The JSON objects.
    pub lines: Vec<Value>,
    /// Number of whole lines that are no JSON objects.
    pub damaged: u64,
    /// The first of them, counted from 1 among all new lines.
    pub first_damaged: Option<usize>,
    /// Whether these are all lines, because the file is another one than before.
    pub from_the_start: bool,
}

impl JsonLinesReader {
    /// A reader of this file, which need not exist yet.
    #[must_use]
    pub fn of(path: PathBuf) -> Self {
        Self { path, inode: 0, read: 0 }
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The whole lines that have not been read yet; none if there is no file.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn more(&mut self) -> std::io::Result<NewLines> {
        let mut file = match plain_file::reader(&self.path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(NewLines::default()),
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
        let whole = durable::whole_lines(&text);
        self.read += whole as u64;
        Ok(NewLines { from_the_start, ..objects(&text[..whole]) })
    }
}

/// The JSON objects in the last `bytes` of a file; none if there is no file.
///
/// # Errors
/// The file cannot be read.
pub fn last_lines(path: &Path, bytes: u64) -> std::io::Result<Vec<Value>> {
    let mut reader = JsonLinesReader::of(path.to_path_buf());
    if let Ok(found) = path.metadata() {
        (reader.inode, reader.read) = (found.ino(), found.len().saturating_sub(bytes));
    }
    Ok(reader.more()?.lines)
}

fn objects(text: &[u8]) -> NewLines {
    let mut new = NewLines::default();
    for (line, number) in text.split(|byte| *byte == b'\n').zip(1..) {
        match serde_json::from_slice::<Value>(line) {
            _ if line.is_empty() => {}
            Ok(line) if line.is_object() => new.lines.push(line),
            _ => {
                new.damaged += 1;
                new.first_damaged.get_or_insert(number);
            }
        }
    }
    new
}

/// Opens a file to append to; the name of a new file is flushed to disk.
fn opened(path: &Path) -> Result<File, FileError> {
    let is_new = !path.exists();
    let file = plain_file::append(path).map_err(FileError::of("open", path))?;
    if is_new {
        durable::sync_name(path)?;
    }
    Ok(file)
}

/// The iterations that have a line; a line without a kind is one of an iteration.
fn iterations(lines: &[Value]) -> BTreeSet<u64> {
    let of_iteration = |line: &&Value| line.get("kind").is_none_or(|kind| kind == "iteration");
    lines.iter().filter(of_iteration).filter_map(|line| line["iteration"].as_u64()).collect()
}

/// Iterations up to `last` that are not `present`, as ranges for people.
fn gaps(present: &BTreeSet<u64>, last: u64) -> Vec<String> {
    let mut ranges: Vec<(u64, u64)> = Vec::new();
    for iteration in (1..=last).filter(|iteration| !present.contains(iteration)) {
        match ranges.last_mut() {
            Some((_, end)) if *end + 1 == iteration => *end = iteration,
            _ => ranges.push((iteration, iteration)),
        }
    }
    let shown = |(first, last): (u64, u64)| {
        if first == last { first.to_string() } else { format!("{first} to {last}") }
    };
    ranges.into_iter().map(shown).collect()
}

/// A line and its iteration; `None` if the line is damaged.
fn of_iteration(line: &[u8]) -> Option<(u64, Value)> {
    let value: Value = serde_json::from_slice(line).ok()?;
    Some((value.get("iteration")?.as_u64()?, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// A file in a new folder that is not written yet.
    fn metrics() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        (folder, path)
    }

    fn append(path: &Path, text: &str) {
        plain_file::append(path).unwrap().write_all(text.as_bytes()).unwrap();
    }

    fn more(reader: &mut JsonLinesReader) -> (Vec<u64>, bool) {
        let new = reader.more().unwrap();
        let iterations = new.lines.iter().map(|line| line["iteration"].as_u64().unwrap());
        (iterations.collect(), new.from_the_start)
    }

    #[test]
    fn each_line_is_read_once_and_only_when_it_is_whole() {
        let (_folder, path) = metrics();
        let mut reader = JsonLinesReader::of(path.clone());
        assert_eq!(more(&mut reader), (vec![], false));
        append(&path, "{\"iteration\":1}\n{\"itera");
        assert_eq!(more(&mut reader), (vec![1], true));
        assert_eq!(more(&mut reader), (vec![], false));
        append(&path, "tion\":2}\n");
        assert_eq!(more(&mut reader), (vec![2], false));
        assert_eq!(last_lines(&path, 20).unwrap(), [json!({"iteration": 2})]);
        assert_eq!(last_lines(&path, 9999).unwrap().len(), 2);
    }

    #[test]
    fn a_file_that_a_resume_has_cut_back_is_read_from_its_start() {
        let (folder, path) = metrics();
        let cut = folder.path().join("cut");
        let mut reader = JsonLinesReader::of(path.clone());
        append(&path, "{\"iteration\":1}\n{\"iteration\":2}\n");
        assert_eq!(more(&mut reader), (vec![1, 2], true));
        // As long as before, so that its length shows no change.
        append(&cut, "{\"iteration\":1}\n{\"iteration\":3}\n");
        std::fs::rename(&cut, &path).unwrap();
        assert_eq!(more(&mut reader), (vec![1, 3], true));
    }

    #[test]
    fn a_cut_keeps_each_iteration_up_to_the_checkpoint_once() {
        let (_folder, path) = metrics();
        let (mut lines, kept) = JsonLines::cut(&path, 0).unwrap();
        assert!(kept.is_empty());
        (0..5).for_each(|k| lines.append(&json!({"iteration": k, "x": 0.5})).unwrap());
        // The process died in the middle of a line.
        lines.file.write_all(b"{\"iteration\": 2, \"x\"").unwrap();
        drop(lines);
        let (mut lines, kept) = JsonLines::cut(&path, 2).unwrap();
        assert_eq!(kept.len(), 3);
        (3..5).for_each(|k| lines.append(&json!({"iteration": k, "x": 0.5})).unwrap());
        lines.sync().unwrap();
        assert_eq!(more(&mut JsonLinesReader::of(path.clone())), (vec![0, 1, 2, 3, 4], true));
        // A file that needs no cut is left alone.
        let before = std::fs::metadata(&path).unwrap().modified().unwrap();
        JsonLines::cut(&path, 4).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().modified().unwrap(), before);
    }

    #[test]
    fn a_run_that_begins_again_keeps_the_lines_that_it_had() {
        let (_folder, path) = metrics();
        let text = "{\"iteration\":1}\n{\"iteration\":2}\n";
        append(&path, text);
        let (_lines, kept) = JsonLines::cut(&path, 0).unwrap();
        assert!(kept.is_empty());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "");
        let moved = path.with_extension("jsonl.damaged");
        assert_eq!(std::fs::read_to_string(moved).unwrap(), text);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn lines_that_a_full_disk_refuses_are_written_once_when_there_is_room() {
        let (_folder, path) = metrics();
        let (mut lines, _) = JsonLines::cut(&path, 0).unwrap();
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let disk = std::mem::replace(&mut lines.file, full);
        lines.path = "/dev/full".into();
        lines.append(&json!({"iteration": 1})).unwrap();
        lines.append(&json!({"iteration": 2})).unwrap();
        let refused = lines.sync().unwrap_err().to_string();
        assert!(refused.contains("cannot append to"), "{refused}");
        (lines.file, lines.path) = (disk, path.clone());
        lines.append(&json!({"iteration": 3})).unwrap();
        lines.sync().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text, "{\"iteration\":1}\n{\"iteration\":2}\n{\"iteration\":3}\n");
    }

    #[test]
    fn iterations_without_a_line_are_named_as_ranges() {
        let present = BTreeSet::from([1, 2, 7, 9]);
        assert_eq!(gaps(&present, 10), ["3 to 6", "8", "10"]);
        assert!(gaps(&present, 2).is_empty());
    }

    #[test]
    fn a_file_that_is_removed_meanwhile_gets_all_later_lines_under_its_name() {
        let (_folder, path) = metrics();
        let (mut lines, _) = JsonLines::cut(&path, 0).unwrap();
        lines.append(&json!({"iteration": 1})).unwrap();
        std::fs::remove_file(&path).unwrap();
        lines.append(&json!({"iteration": 2})).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "{\"iteration\":2}\n");
    }
}
