//! Tests of truncated, corrupted and foreign files.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::LinearReaderOptions;
use serde_json::json;

use super::slot_log;
use crate::mcap_file::McapFile;
use crate::mcap_file::Schema;
use crate::trajectory_log::recover::{Loss, copy};
use crate::trajectory_log::source::read_bytes;
use crate::trajectory_log::{LogError, Recovered, read_shares, records, recover, survey};

/// Channel id, sequence number and data of a message.
type Message = (u16, u32, Vec<u8>);

/// A file with two channels, four chunks, an attachment and metadata, small enough to truncate at every byte.
fn small_file() -> Vec<u8> {
    let mut file = McapFile::in_chunks_of(200, Cursor::new(Vec::new())).unwrap();
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
    file.into_finished().unwrap().into_inner()
}

fn messages(bytes: &[u8]) -> Vec<Message> {
    let mut found = Vec::new();
    records::read(bytes, |record| {
        if let Record::Message { header, data } = record {
            found.push((header.channel_id, header.sequence, data.to_vec()));
        }
        Ok(())
    })
    .unwrap();
    found
}

/// Recovers `bytes` and reads the result.
fn saved(bytes: &[u8]) -> (Recovered, Vec<Message>) {
    let (recovered, target) = copy(bytes, Cursor::new(Vec::new())).unwrap();
    let messages = messages(&target.into_inner());
    assert_eq!(messages.len() as u64, recovered.messages);
    (recovered, messages)
}

/// Whether the messages of `part` are a subsequence of `whole`.
fn is_part(part: &[Message], whole: &[Message]) -> bool {
    let mut rest = whole.iter();
    part.iter().all(|message| rest.any(|other| other.2 == message.2))
}

#[test]
fn an_intact_file_is_recovered_without_loss() {
    let file = small_file();
    let (recovered, found) = saved(&file);
    assert_eq!((found.len(), recovered.losses), (16, Vec::new()));
    assert_eq!(found, messages(&file));
}

#[test]
fn a_truncated_file_keeps_its_first_messages_and_reports_the_loss() {
    let file = small_file();
    let all = messages(&file);
    let mut most = 0;
    for length in mcap::MAGIC.len()..file.len() {
        let (recovered, found) = saved(&file[..length]);
        assert!(found.len() >= most, "more bytes, fewer messages at {length}");
        assert_eq!(found[..], all[..found.len()], "cut at {length}");
        let ends_early = recovered.losses.contains(&Loss::End);
        assert!(ends_early || found.len() == all.len(), "cut at {length}: {recovered:?}");
        most = found.len();
    }
    assert_eq!(most, all.len());
}

#[test]
fn a_changed_byte_may_lose_messages_but_never_changes_one() {
    let file = small_file();
    let all = messages(&file);
    for place in mcap::MAGIC.len()..file.len() {
        for pattern in [0x01, 0x80, 0xff] {
            let mut damaged = file.clone();
            damaged[place] ^= pattern;
            let (recovered, found) = saved(&damaged);
            assert!(is_part(&found, &all), "byte {place}: a message was changed");
            let silent = recovered.losses.is_empty();
            assert!(!silent || found.len() == all.len(), "byte {place}: an unreported loss");
        }
    }
}

#[test]
fn one_changed_byte_loses_one_chunk() {
    let file = small_file();
    let all = messages(&file);
    // A byte in the data of the second chunk, which is found by the name of its compression.
    let second = file.windows(4).enumerate().filter(|(_, name)| *name == b"zstd").nth(1).unwrap().0;
    let mut damaged = file.clone();
    damaged[second + 30] ^= 0x10;
    let (recovered, found) = saved(&damaged);
    assert!(matches!(recovered.losses[..], [Loss::Bytes { .. }]), "{:?}", recovered.losses);
    let kept = all.len() - found.len();
    assert!((1..=6).contains(&kept), "{kept} messages lost");
}

#[test]
fn trailing_zeros_are_a_loss_and_not_messages() {
    let file = small_file();
    let all = messages(&file);
    for length in (mcap::MAGIC.len()..file.len()).step_by(7) {
        let mut zeroed = file.clone();
        zeroed[length..].fill(0);
        let (recovered, found) = saved(&zeroed);
        assert_eq!(found[..], all[..found.len()], "zeros from {length}");
        assert!(!recovered.losses.is_empty() || found.len() == all.len());
    }
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
fn a_truncated_log_keeps_its_complete_shares() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = read_bytes(&slot_log(folder.path()).0).unwrap();
    let refused = read_shares(&bytes[..bytes.len() - 1], |_, _| Ok(())).unwrap_err().to_string();
    assert!(refused.contains("s2mia log recover"), "{refused}");
    for length in (0..bytes.len()).rev().step_by(997) {
        let out = folder.path().join(format!("{length}.mcap"));
        match recover(&bytes[..length], &out) {
            Err(error) => assert!(matches!(error, LogError::NotMcap), "{error}"),
            Ok(recovered) => {
                let saved = read_bytes(&out).unwrap();
                assert!(survey(&saved).is_ok());
                let mut whole = 0;
                let log = read_shares(&saved, |_, _| {
                    whole += 1;
                    Ok(())
                });
                assert!(whole == 3 || !recovered.losses.is_empty(), "cut at {length}");
                assert!(log.is_ok() || whole == 0, "cut at {length}");
            }
        }
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
    assert!(
        read_bytes(&folder.path().join("missing")).unwrap_err().to_string().contains("cannot read")
    );
    let foreign = read_shares(&small_file(), |_, _| Ok(())).unwrap_err().to_string();
    assert!(foreign.contains("not a trajectory log"), "{foreign}");
    let out = folder.path().join("out.mcap");
    assert!(matches!(recover(b"text", &out), Err(LogError::NotMcap)));
    assert!(!out.exists());
}

#[test]
fn recovery_never_overwrites_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = slot_log(folder.path()).0;
    let before = read_bytes(&path).unwrap();
    assert!(matches!(recover(&before, &path), Err(LogError::Taken)));
    assert_eq!(read_bytes(&path).unwrap(), before);
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
