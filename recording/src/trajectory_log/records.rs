//! Reads the records of an untrusted MCAP file. Any bytes result in records or an error, never in a panic.

use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::error::LogError;

/// Size of a record's opcode and length, bytes.
pub(super) const RECORD_HEAD: usize = 9;
/// Size of a chunk record without the compression's name and the data, bytes.
const CHUNK_HEAD: usize = 40;
/// Largest size of a record and of a decompressed chunk, bytes.
const MOST_BYTES: usize = 1 << 30;

/// Reads all records of a finished file, including those in chunks, and checks all checksums.
///
/// # Errors
/// If the end is missing, a checksum is wrong, a record is invalid, or `each` fails.
pub(super) fn read(
    bytes: &[u8],
    mut each: impl FnMut(Record<'_>) -> Result<(), LogError>,
) -> Result<(), LogError> {
    if bytes.len() < 2 * mcap::MAGIC.len() || !bytes.ends_with(mcap::MAGIC) {
        return Err(LogError::Unfinished);
    }
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

/// Reads the records of a chunk with this body, after checking its checksum.
fn unpack(
    body: &[u8],
    each: &mut impl FnMut(Record<'_>) -> Result<(), LogError>,
) -> Result<(), LogError> {
    if !is_chunk(body) {
        return Err(LogError::Damaged("the sizes in a chunk are inconsistent".to_owned()));
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

/// Passes `bytes` to a reader and each record to `each`.
pub(super) fn scan(
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

/// Parses a record.
pub(super) fn parse(opcode: u8, body: &[u8]) -> Result<Record<'_>, LogError> {
    if opcode == op::ATTACHMENT && !is_attachment(body) {
        return Err(LogError::Damaged("the sizes in an attachment are inconsistent".to_owned()));
    }
    if skip_parts(parts(opcode), body).is_none() {
        return Err(LogError::Damaged("a text is longer than its record".to_owned()));
    }
    Ok(mcap::parse_record(opcode, body)?)
}

/// A part of a record's body.
enum Part {
    /// Numbers of this size in all, bytes.
    Numbers(usize),
    /// A size and as many bytes.
    Text,
    /// A size in bytes and as many bytes of texts.
    Texts,
}

/// The parts of a record up to its last text.
fn parts(opcode: u8) -> &'static [Part] {
    use Part::{Numbers, Text, Texts};
    match opcode {
        op::HEADER => &[Text, Text],
        op::SCHEMA => &[Numbers(2), Text, Text, Text],
        op::CHANNEL => &[Numbers(4), Text, Text, Texts],
        op::CHUNK_INDEX => &[Numbers(32), Text, Numbers(8), Text],
        op::ATTACHMENT_INDEX => &[Numbers(40), Text, Text],
        op::METADATA => &[Text, Texts],
        op::METADATA_INDEX => &[Numbers(16), Text],
        _ => &[],
    }
}

/// What follows these parts; `None` if one is longer than `body`. The MCAP library allocates the stated size of a text
/// before it reads the text.
fn skip_parts<'a>(parts: &[Part], mut body: &'a [u8]) -> Option<&'a [u8]> {
    for part in parts {
        let size = match part {
            Part::Numbers(size) => *size,
            Part::Text | Part::Texts => {
                let (size, rest) = body.split_first_chunk()?;
                body = rest;
                u32::from_le_bytes(*size) as usize
            }
        };
        let (own, rest) = body.split_at_checked(size)?;
        if let Part::Texts = part {
            let mut texts = own;
            while !texts.is_empty() {
                texts = skip_parts(&[Part::Text], texts)?;
            }
        }
        body = rest;
    }
    Some(body)
}

/// Whether the sizes in a chunk's body are consistent and at most [`MOST_BYTES`] decompressed. The records of an
/// uncompressed chunk must fill it exactly.
fn is_chunk(body: &[u8]) -> bool {
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

/// Whether the sizes in an attachment's body are consistent.
fn is_attachment(body: &[u8]) -> bool {
    let head = [Part::Numbers(16), Part::Text, Part::Text];
    let Some(rest) = skip_parts(&head, body) else { return false };
    // The size of the data, the data and a checksum.
    rest.len().checked_sub(12).is_some_and(|size| number(rest, 0) == size as u64)
}

/// Reads a little-endian u64 at `at`, which must be within bounds.
fn number(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("the slice was cut to this length"))
}
