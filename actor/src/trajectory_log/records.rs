//! The records of an MCAP file, read without trust: whatever the bytes are, the answer is records or an error.

use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::LogError;

/// Opcode and length of a record.
pub(super) const RECORD_HEAD: usize = 9;
/// Of a chunk's record without its compression's name and its data.
const CHUNK_HEAD: usize = 40;
/// No record is larger, and no chunk once it is unpacked.
const MOST_BYTES: usize = 1 << 30;
/// Without the two names.
const ATTACHMENT_HEAD: usize = 36;

/// All records of a finished file, chunks unpacked, every checksum checked.
///
/// # Errors
/// If the end is missing, a checksum does not fit, a record cannot be read, or `each` refuses one.
pub(super) fn read(
    bytes: &[u8],
    each: impl FnMut(Record<'_>) -> Result<(), LogError>,
) -> Result<(), LogError> {
    if bytes.len() < 2 * mcap::MAGIC.len() || !bytes.ends_with(mcap::MAGIC) {
        return Err(LogError::Unfinished);
    }
    read_data(bytes, each)
}

/// As [`read`], of a file whose end may be missing: what is there of it is read before the error.
pub(super) fn read_data(
    bytes: &[u8],
    mut each: impl FnMut(Record<'_>) -> Result<(), LogError>,
) -> Result<(), LogError> {
    let options = LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_validate_data_section_crc(true)
        .with_validate_summary_section_crc(true)
        .with_check_finishes_after_end_magic(true);
    scan(bytes, options, &mut |opcode, body| match opcode {
        op::CHUNK => unpack(body, &mut each),
        _ => each(parse(opcode, body)?),
    })
}

/// The records of a chunk whose body this is, after its checksum was found right.
pub(super) fn unpack(
    body: &[u8],
    each: &mut impl FnMut(Record<'_>) -> Result<(), LogError>,
) -> Result<(), LogError> {
    if !is_chunk(body) {
        return Err(LogError::Damaged("a chunk contradicts its own sizes".to_owned()));
    }
    let mut record = vec![op::CHUNK];
    record.extend_from_slice(&(body.len() as u64).to_le_bytes());
    record.extend_from_slice(body);
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true);
    scan(&record, options, &mut |opcode, body| each(parse(opcode, body)?))
}

/// Feeds `bytes` to a reader.
fn scan(
    mut bytes: &[u8],
    options: LinearReaderOptions,
    each: &mut impl FnMut(u8, &[u8]) -> Result<(), LogError>,
) -> Result<(), LogError> {
    let mut reader = LinearReader::new_with_options(options.with_record_length_limit(MOST_BYTES));
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(wanted) => {
                let (now, later) = bytes.split_at(wanted.min(bytes.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                bytes = later;
            }
            LinearReadEvent::Record { opcode, data } => each(opcode, data)?,
        }
    }
    Ok(())
}

/// One record.
pub(super) fn parse(opcode: u8, body: &[u8]) -> Result<Record<'_>, LogError> {
    if opcode == op::ATTACHMENT && !is_attachment(body) {
        return Err(LogError::Damaged("an attachment contradicts its own sizes".to_owned()));
    }
    Ok(mcap::parse_record(opcode, body)?)
}

/// Whether the sizes in a chunk's body fit each other, with at most [`MOST_BYTES`] unpacked. Of a chunk that is not
/// compressed the records fit it, too.
pub(super) fn is_chunk(body: &[u8]) -> bool {
    if body.len() < CHUNK_HEAD {
        return false;
    }
    let unpacked = number(body, 16);
    let name = u64::from(u32::from_le_bytes([body[28], body[29], body[30], body[31]]));
    if name > 4 || body.len() < CHUNK_HEAD + name as usize || unpacked > MOST_BYTES as u64 {
        return false;
    }
    let data = &body[CHUNK_HEAD + name as usize..];
    match &body[32..32 + name as usize] {
        b"" => number(body, 32) == data.len() as u64 && unpacked == data.len() as u64 && fits(data),
        b"lz4" | b"zstd" => number(body, 32 + name as usize) == data.len() as u64,
        _ => false,
    }
}

/// Whether records fill these bytes exactly.
fn fits(mut bytes: &[u8]) -> bool {
    while bytes.len() >= RECORD_HEAD {
        let length = number(bytes, 1);
        if length > (bytes.len() - RECORD_HEAD) as u64 {
            return false;
        }
        bytes = &bytes[RECORD_HEAD + length as usize..];
    }
    bytes.is_empty()
}

/// Whether the sizes in an attachment's body fit each other.
fn is_attachment(body: &[u8]) -> bool {
    let mut at = 16;
    for _ in 0..2 {
        let Some(length) = body.get(at..at + 4) else { return false };
        at += 4 + u32::from_le_bytes([length[0], length[1], length[2], length[3]]) as usize;
    }
    let names = at - 24;
    let Some(rest) = body.len().checked_sub(ATTACHMENT_HEAD + names) else { return false };
    number(body, at) == rest as u64
}

/// Eight bytes that are there.
pub(super) fn number(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("the slice was cut to this length"))
}
