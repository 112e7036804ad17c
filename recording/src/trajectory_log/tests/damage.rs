//! Tests of truncated, corrupted and foreign files.

use std::collections::BTreeMap;
use std::fs::File;

use mcap::records::op;
use mcap::sans_io::linear_reader::LinearReaderOptions;
use serde_json::json;

use super::slot_log;
use crate::mcap_file::{McapFile, Schema};
use crate::trajectory_log::file::TOTALS_NAME;
use crate::trajectory_log::source::read_bytes;
use crate::trajectory_log::{LogError, read_shares, records};

/// A file with two channels, four chunks, an attachment and metadata, small enough to truncate at every byte.
fn small_file() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("small.mcap");
    let mut file = McapFile::in_chunks_of(200, File::create(&path).unwrap()).unwrap();
    let schema = json!({ "title": "test.Number", "type": "object" });
    let data = schema.to_string().into_bytes();
    let schema =
        Schema { name: "test.Number", encoding: "jsonschema", data: &data, messages: "json" };
    let mut channels =
        ["/one", "/two"].map(|topic| file.channel(topic, &schema, &BTreeMap::new()).unwrap());
    file.attach("note.txt", "text/plain", b"a note").unwrap();
    for number in 0..16_u32 {
        let text = json!({ "number": number, "filler": "x".repeat(20) }).to_string();
        file.write(&mut channels[number as usize % 2], text.as_bytes()).unwrap();
        file.advance(1000);
    }
    file.metadata("end", &[("numbers".to_owned(), "16".to_owned())].into()).unwrap();
    file.finish().unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn reading_rejects_truncated_and_changed_files_without_a_panic() {
    let file = small_file();
    let read = |bytes: &[u8]| records::read(bytes, |_| Ok(()));
    assert!(read(&file).is_ok());
    for length in 0..file.len() {
        assert!(read(&file[..length]).is_err(), "cut at {length}");
    }
    for place in 0..file.len() {
        let mut damaged = file.clone();
        damaged[place] ^= 0x20;
        assert!(read(&damaged).is_err(), "byte {place} is not covered by a checksum");
    }
}

#[test]
fn other_files_are_rejected_with_a_one_line_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other");
    for text in ["", "no MCAP at all", "\u{89}MCAP"] {
        std::fs::write(&path, text).unwrap();
        let line = read_bytes(&path).unwrap_err().to_string();
        assert!(line.contains("not an MCAP file") && !line.contains('\n'), "{line}");
    }
    let missing = read_bytes(&folder.path().join("missing")).unwrap_err().to_string();
    assert!(missing.contains("cannot read"), "{missing}");
    let foreign = read_shares(&small_file(), |_| Ok(())).unwrap_err().to_string();
    assert!(foreign.contains("not a trajectory log"), "{foreign}");
}

/// A log without its share number `left_out` and without the metadata `unnamed`.
fn copy_without(bytes: &[u8], left_out: usize, unnamed: &[&str]) -> Vec<u8> {
    let options = mcap::WriteOptions::new().compression(None);
    let mut copy = options.create(std::io::Cursor::new(Vec::new())).unwrap();
    let summary = mcap::Summary::read(bytes).unwrap().unwrap();
    for index in &summary.attachment_indexes {
        copy.attach(&mcap::read::attachment(bytes, index).unwrap()).unwrap();
    }
    for index in &summary.metadata_indexes {
        let metadata = mcap::read::metadata(bytes, index).unwrap();
        if !unnamed.contains(&metadata.name.as_str()) {
            copy.write_metadata(&metadata).unwrap();
        }
    }
    let mut begun = 0;
    for message in mcap::MessageStream::new(bytes).unwrap() {
        let message = message.unwrap();
        begun += usize::from(message.channel.topic == "/share");
        if begun != left_out {
            copy.write(&message).unwrap();
        }
    }
    copy.finish().unwrap();
    copy.into_inner().into_inner()
}

#[test]
fn shares_that_are_no_longer_in_a_log_are_counted_if_its_end_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = read_bytes(&slot_log(folder.path()).0).unwrap();
    for (left_out, unnamed, shares, missing) in
        [(0, &[][..], 3, Some(0)), (2, &[], 2, Some(1)), (2, &[TOTALS_NAME], 2, None)]
    {
        let copy = copy_without(&bytes, left_out, unnamed);
        let log = read_shares(&copy, |_| Ok(())).unwrap();
        assert_eq!((log.shares, log.missing_shares()), (shares, missing));
        assert_eq!(log.lost_shares(), unnamed.is_empty().then_some(0));
        assert_eq!(log.torn_steps, 0);
    }
}

#[test]
fn only_plain_files_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
    for path in [&pipe, std::path::Path::new("/dev/zero"), folder.path()] {
        let line = read_bytes(path).unwrap_err().to_string();
        assert!(line.ends_with(", not a plain file"), "{line}");
    }
}

#[test]
fn a_text_that_states_another_size_than_it_has_is_refused_before_it_is_read() {
    let bytes = small_file();
    let refused = |opcode, body: &[u8]| match records::parse(opcode, body) {
        Err(LogError::Damaged(why)) => why == "a text is longer than its record",
        _ => false,
    };
    let mut tried = 0;
    let options = LinearReaderOptions::default().with_emit_chunks(true);
    let scanned = records::scan(&bytes, options, &mut |opcode, data| {
        assert!(!refused(opcode, data), "opcode {opcode}");
        // Where the first text of each kind of record has its size.
        let at = match opcode {
            op::HEADER | op::METADATA => 0,
            op::SCHEMA => 2,
            op::CHANNEL => 4,
            op::METADATA_INDEX => 16,
            op::CHUNK_INDEX => 32,
            op::ATTACHMENT_INDEX => 40,
            _ => return Ok(()),
        };
        let mut body = data.to_vec();
        body[at..at + 4].copy_from_slice(&3_000_000_000_u32.to_le_bytes());
        assert!(refused(opcode, &body), "opcode {opcode}");
        tried += 1;
        Ok(())
    });
    scanned.unwrap();
    assert!(tried >= 7, "{tried} records were tried");
    // A map with one name, which states three gigabytes.
    let map = [&[0; 4][..], &4_u32.to_le_bytes(), &3_000_000_000_u32.to_le_bytes()].concat();
    assert!(refused(op::METADATA, &map));
}
