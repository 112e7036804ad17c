//! Joins several logs of one run into one file, ordered by episode and step.

use std::path::Path;

use mcap::records::{ChunkIndex, Record, op};

use super::error::LogError;
use super::file::{LogFile, Origin};
use super::index::{Index, Part};
use super::records;
use super::shares::Assembler;
use super::source::{Draft, read_bytes, read_part};
use crate::share::LoggedShare;

/// Content of a joined file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Joined {
    /// Number of episodes.
    pub episodes: usize,
    /// Number of shares.
    pub shares: u64,
    /// Number of steps.
    pub steps: u64,
}

/// Writes every share of `index` once to the new file `out`: rollouts by environment and episode, then evaluations.
/// Only one share is in memory at a time. `on_share` gets the number of written shares and of all shares after each share.
///
/// # Errors
/// If two shares contradict each other, a file has changed since it was indexed, or `out` exists or cannot be written.
pub fn join(
    index: &Index,
    out: &Path,
    mut on_share: impl FnMut(u64, u64),
) -> Result<Joined, LogError> {
    if let Some(contradiction) = index.contradictions().into_iter().next() {
        return Err(LogError::Unfit(contradiction));
    }
    let (draft, target) = Draft::begin(out)?;
    let sources =
        index.files.iter().map(|path| Source::open(path)).collect::<Result<Vec<_>, _>>()?;
    let origin = Origin::of_log(&index.log)?.with("joined_files", sources.len().to_string());
    let mut file = LogFile::begin(target, &origin)?;
    let (shares, steps) = index.shares_and_steps();
    let parts = index.parts.values().flat_map(|parts| parts.values()).flatten();
    for (written, part) in (1..).zip(parts) {
        let mut share = sources[part.file].share(part)?;
        index.rewards.fill(&mut share)?;
        file.write(&share)?;
        on_share(written, shares);
    }
    file.finish(index.lost())?;
    draft.publish()?;
    Ok(Joined { episodes: index.episodes(), shares, steps })
}

/// A log from which single shares are read.
struct Source<'a> {
    path: &'a Path,
    chunks: Vec<ChunkIndex>,
    /// Assembler with the file's channels.
    assembler: Assembler,
}

impl<'a> Source<'a> {
    fn open(path: &'a Path) -> Result<Self, LogError> {
        let (mut chunks, mut assembler) = (Vec::new(), Assembler::default());
        records::read(&read_bytes(path)?, |record| {
            match record {
                Record::ChunkIndex(chunk) => chunks.push(chunk),
                Record::Schema { .. } | Record::Channel(_) => {
                    assembler.take(record)?;
                }
                _ => {}
            }
            Ok(())
        })?;
        chunks.sort_by_key(|chunk| chunk.chunk_start_offset);
        Ok(Self { path, chunks, assembler })
    }

    fn share(&self, part: &Part) -> Result<LoggedShare, LogError> {
        let (begin, end) = part.nanos;
        let mut assembler = self.assembler.clone();
        let mut found = None;
        let holds = |c: &&ChunkIndex| c.message_start_time <= end && c.message_end_time >= begin;
        for chunk in self.chunks.iter().filter(holds) {
            let bytes = read_part(self.path, chunk.chunk_start_offset, chunk.chunk_length)?;
            let body = bytes.get(records::RECORD_HEAD..).unwrap_or_default();
            debug_assert_eq!(bytes.first(), Some(&op::CHUNK));
            records::unpack(body, &mut |record| {
                if let Record::Message { header, .. } = &record
                    && (begin..=end).contains(&header.log_time)
                    && let Some((share, _)) = assembler.take(record)?
                {
                    found.get_or_insert(share);
                }
                Ok(())
            })?;
        }
        found.ok_or_else(|| LogError::Damaged("it changed while it was being read".to_owned()))
    }
}
