//! Trajectory logs: arbitrary bytes, and logs with whole checksums whose messages were changed.
#![no_main]

use std::io::Cursor;
use std::sync::LazyLock;

use arbitrary::{Arbitrary, Unstructured};
use libfuzzer_sys::fuzz_target;
use mcap::{Attachment, Message, MessageStream, Summary, Writer};
use recording::trajectory_log::replay;

static LOG: LazyLock<Vec<u8>> = LazyLock::new(fuzz::recording);

fuzz_target!(|data: &[u8]| {
    let Some((kind, bytes)) = data.split_first() else { return };
    match kind % 2 {
        0 => read(bytes),
        // Too few bytes for a list of changes are no case.
        _ => read(&changed(&LOG, &mut Unstructured::new(bytes)).unwrap_or_default()),
    }
});

fn read(bytes: &[u8]) {
    let _replayed = replay(bytes, |done, all| assert!(done <= all));
}

/// A change of a log that its checksums do not show.
#[derive(Arbitrary, Debug)]
enum Change {
    Byte { message: u16, at: u16, value: u8 },
    Cut { message: u16, at: u16 },
    Gone(u16),
    Twice(u16),
    Swapped(u16, u16),
    OtherChannel { message: u16, like: u16 },
    Attachment { index: u8, at: u16, value: u8 },
}

fn changed(log: &[u8], unstructured: &mut Unstructured<'_>) -> arbitrary::Result<Vec<u8>> {
    let messages = MessageStream::new(log).expect("a log of the program");
    let mut messages: Vec<Message<'_>> =
        messages.map(|message| message.expect("as before")).collect();
    let mut attachments = attachments(log);
    for change in Vec::<Change>::arbitrary(unstructured)? {
        apply(&mut messages, &mut attachments, change);
        if messages.is_empty() {
            break;
        }
    }
    Ok(written(log, &messages, &attachments))
}

fn apply(messages: &mut Vec<Message<'_>>, attachments: &mut [Attachment<'_>], change: Change) {
    let count = messages.len();
    let place = |index: u16| usize::from(index) % count;
    match change {
        Change::Byte { message, at, value } => {
            set(messages[place(message)].data.to_mut(), at, value);
        }
        Change::Cut { message, at } => {
            messages[place(message)].data.to_mut().truncate(at.into());
        }
        Change::Gone(message) => drop(messages.remove(place(message))),
        Change::Twice(message) => messages.insert(place(message), messages[place(message)].clone()),
        Change::Swapped(one, other) => messages.swap(place(one), place(other)),
        Change::OtherChannel { message, like } => {
            messages[place(message)].channel = messages[place(like)].channel.clone();
        }
        Change::Attachment { index, at, value } => {
            let index = usize::from(index).checked_rem(attachments.len());
            index.into_iter().for_each(|index| set(attachments[index].data.to_mut(), at, value));
        }
    }
}

fn set(bytes: &mut [u8], at: u16, value: u8) {
    if let Some(at) = usize::from(at).checked_rem(bytes.len()) {
        bytes[at] = value;
    }
}

fn summary(log: &[u8]) -> Summary {
    Summary::read(log).expect("a log of the program").expect("a finished log has a summary")
}

fn attachments(log: &[u8]) -> Vec<Attachment<'_>> {
    let indexes = summary(log).attachment_indexes;
    let read = |index| mcap::read::attachment(log, index).expect("a log of the program");
    indexes.iter().map(read).collect()
}

/// A finished log with these messages and attachments, and the metadata of `log`.
fn written(log: &[u8], messages: &[Message<'_>], attachments: &[Attachment<'_>]) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    let mut writer = Writer::new(&mut out).expect("a log in memory");
    for index in &summary(log).metadata_indexes {
        let metadata = mcap::read::metadata(log, index).expect("a log of the program");
        writer.write_metadata(&metadata).expect("as it was written before");
    }
    for attachment in attachments {
        writer.attach(attachment).expect("as it was written before");
    }
    for message in messages {
        writer.write(message).expect("as it was written before");
    }
    writer.finish().expect("a log in memory");
    drop(writer);
    out.into_inner()
}
