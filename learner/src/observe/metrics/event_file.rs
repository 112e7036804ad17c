//! Metrics as a TensorBoard event file: TFRecord records, each a protocol buffer `Event` with the figures of one line
//! as scalars over environment steps. The few fields needed are encoded by hand.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::Value;

use super::tags::scalars;
use crate::store::durable::{self, FileError};

/// Prefix by which TensorBoard recognises event files.
const NAME: &str = "events.out.tfevents.";

/// The event file of a run, open for appending.
#[derive(Debug)]
pub(super) struct EventFile {
    path: PathBuf,
    file: File,
    /// Reconstructed time of the last line: seconds since 1970, advanced by the duration of each iteration.
    time_secs: f64,
}

/// Duration of the line's iteration; 0 for an evaluation, which overlaps with iterations.
fn spent_secs(line: &Value) -> f64 {
    ["rollout_secs", "update_secs"].iter().filter_map(|name| line[*name].as_f64()).sum()
}

impl EventFile {
    /// Writes a new event file with all lines; the last line gets the time `now`. Older files remain, because an open
    /// TensorBoard does not notice that a file which it reads is gone: the start of a session at step 0, with which the
    /// new file begins, replaces what they show.
    ///
    /// # Errors
    /// A file or the folder cannot be written.
    pub(super) fn make(folder: &Path, lines: &[Value], now: SystemTime) -> Result<Self, FileError> {
        let now_secs = now.duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
        let mut time_secs = now_secs - lines.iter().map(spent_secs).sum::<f64>();
        let mut bytes = record(&version_event(time_secs));
        bytes.extend(record(&start_event(time_secs)));
        for line in lines {
            time_secs += spent_secs(line);
            bytes.extend(record(&scalar_event(time_secs, line)));
        }
        durable::make_folder(folder)?;
        let number = (now_secs as u64).max(newest(folder)?.map_or(0, |newest| newest + 1));
        let path = folder.join(format!("{NAME}{number:010}.s2mia"));
        durable::write(&path, &bytes)?;
        let file = OpenOptions::new().append(true).open(&path);
        let file = file.map_err(FileError::of("open", &path))?;
        Ok(Self { path, file, time_secs })
    }

    /// Adds one line.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn add(&mut self, line: &Value) -> Result<(), FileError> {
        self.time_secs += spent_secs(line);
        let bytes = record(&scalar_event(self.time_secs, line));
        self.file.write_all(&bytes).map_err(FileError::of("append to", &self.path))
    }
}

/// The largest number of an event file in the folder: its time. TensorBoard reads files in the order of their names.
fn newest(folder: &Path) -> Result<Option<u64>, FileError> {
    let mut newest = None;
    for entry in std::fs::read_dir(folder).map_err(FileError::of("read", folder))? {
        let name = entry.map_err(FileError::of("read", folder))?.file_name();
        let name = name.to_string_lossy();
        let number = name.strip_prefix(NAME).and_then(|rest| rest.split('.').next()?.parse().ok());
        newest = newest.max(number);
    }
    Ok(newest)
}

/// The first event of every file: `Event { wall_time, file_version }`.
fn version_event(wall_secs: f64) -> Vec<u8> {
    let mut event = wall_time(wall_secs);
    put_bytes(&mut event, 3, b"brain.Event:2");
    event
}

/// `Event { wall_time, session_log: { status: START } }`: readers drop every point from its step on, which is 0.
fn start_event(wall_secs: f64) -> Vec<u8> {
    let mut event = wall_time(wall_secs);
    put_bytes(&mut event, 7, &[key(1, VARINT), 1]);
    event
}

/// `Event { wall_time, step, summary: { value: [{ tag, simple_value }, ...] } }`
fn scalar_event(wall_secs: f64, line: &Value) -> Vec<u8> {
    let mut summary = Vec::new();
    for (tag, value) in scalars(line) {
        let mut scalar = Vec::new();
        put_bytes(&mut scalar, 1, tag.as_bytes());
        scalar.push(key(2, FOUR_BYTES));
        scalar.extend((value as f32).to_le_bytes());
        put_bytes(&mut summary, 1, &scalar);
    }
    let mut event = wall_time(wall_secs);
    event.push(key(2, VARINT));
    put_varint(&mut event, line["env_steps"].as_u64().unwrap_or(0));
    put_bytes(&mut event, 5, &summary);
    event
}

fn wall_time(secs: f64) -> Vec<u8> {
    let mut field = vec![key(1, EIGHT_BYTES)];
    field.extend(secs.to_le_bytes());
    field
}

/// Wire types of protocol buffers.
const VARINT: u8 = 0;
const EIGHT_BYTES: u8 = 1;
const LENGTH_AND_BYTES: u8 = 2;
const FOUR_BYTES: u8 = 5;

fn key(field: u8, wire_type: u8) -> u8 {
    field << 3 | wire_type
}

fn put_bytes(message: &mut Vec<u8>, field: u8, bytes: &[u8]) {
    message.push(key(field, LENGTH_AND_BYTES));
    put_varint(message, bytes.len() as u64);
    message.extend(bytes);
}

/// Appends a varint: seven bits per byte, the lowest first; the top bit means that more bytes follow.
fn put_varint(message: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        message.push(number as u8 | 0x80);
        number >>= 7;
    }
    message.push(number as u8);
}

/// A TFRecord record: length (8 bytes, little-endian), its masked checksum (4), data, their masked checksum (4).
fn record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    let mut record = length.to_vec();
    record.extend(masked(crc32c(&length)).to_le_bytes());
    record.extend(data);
    record.extend(masked(crc32c(data)).to_le_bytes());
    record
}

/// TFRecord's mask of a checksum: rotation to the right by 15 bits, plus a constant.
fn masked(checksum: u32) -> u32 {
    checksum.rotate_right(15).wrapping_add(0xA282_EAD8)
}

/// CRC-32C (Castagnoli): polynomial `0x1EDC6F41`, reflected, initial value and final XOR all ones.
fn crc32c(data: &[u8]) -> u32 {
    !data.iter().fold(!0, |sum, byte| TABLE[usize::from(sum as u8 ^ byte)] ^ (sum >> 8))
}

/// CRC-32C of every byte.
const TABLE: [u32; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut sum = byte as u32;
        let mut bit = 0;
        while bit < 8 {
            sum = if sum & 1 == 1 { (sum >> 1) ^ 0x82F6_3B78 } else { sum >> 1 };
            bit += 1;
        }
        table[byte] = sum;
        byte += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::time::Duration;

    #[test]
    fn every_start_writes_a_later_file_that_begins_a_session_and_ends_at_the_current_time() {
        let folder = tempfile::tempdir().unwrap();
        let line = |iteration: u64| {
            json!({"kind": "iteration", "iteration": iteration, "env_steps": 40 * iteration,
                   "rollout_secs": 2.0, "update_secs": 1.0})
        };
        let at = |secs| UNIX_EPOCH + Duration::from_secs(secs);
        let mut first = EventFile::make(folder.path(), &[], at(1000)).unwrap();
        first.add(&line(1)).unwrap();
        assert_eq!(first.time_secs, 1003.0);
        let second = EventFile::make(folder.path(), &[line(1), line(2)], at(2000)).unwrap();
        assert_eq!(second.time_secs, 2000.0);
        // In the same second, and by a clock that was set back.
        EventFile::make(folder.path(), &[line(1)], at(2000)).unwrap();
        EventFile::make(folder.path(), &[line(1)], at(3)).unwrap();
        let mut names: Vec<String> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        let expected = [1000, 2000, 2001, 2002];
        assert_eq!(names, expected.map(|secs| format!("events.out.tfevents.{secs:010}.s2mia")));
        let bytes = std::fs::read(folder.path().join(&names[3])).unwrap();
        let start = [record(&version_event(0.0)), record(&start_event(0.0))].concat();
        assert_eq!(bytes[..start.len()], start);
    }
}
