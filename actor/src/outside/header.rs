//! Header of an encoded state of an external environment, and the history of an episode that is replayed.

use sim::{SimError, StateError};

/// Size of the header, bytes.
pub(super) const HEADER_BYTES: usize = 16;

/// Size of an episode's key, bytes.
pub(super) const KEY_BYTES: usize = 32;

/// Header of an encoded state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateHeader {
    /// Index of the episode in its environment.
    pub episode: u64,
    /// Steps taken in the episode.
    pub step: u32,
    /// Steps after which the episode is truncated.
    pub limit: u32,
}

/// The key and the actions, `[step, A]`, of an episode with joint actions of `width` numbers.
pub(super) fn history(
    header: &StateHeader,
    past: &[u8],
    width: usize,
) -> Result<([u8; KEY_BYTES], Vec<f32>), SimError> {
    let (found, expected) = (past.len(), KEY_BYTES + 4 * width * header.step as usize);
    let Some((key, rest)) = past.split_first_chunk::<KEY_BYTES>().filter(|_| found == expected)
    else {
        let why = format!("its history has {found} bytes; {} steps have {expected}", header.step);
        return Err(StateError::External(why).into());
    };
    let (rest, _) = rest.as_chunks::<4>();
    let actions = rest.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect::<Vec<_>>();
    if actions.iter().any(|action| !action.is_finite()) {
        let why = "its history has an action that is not finite".to_owned();
        return Err(StateError::External(why).into());
    }
    Ok((*key, actions))
}

impl StateHeader {
    pub(super) fn write(&self) -> Vec<u8> {
        let Self { episode, step, limit } = self;
        [&episode.to_le_bytes()[..], &step.to_le_bytes(), &limit.to_le_bytes()].concat()
    }

    /// Reads the header; also returns the bytes after it.
    pub(super) fn read(bytes: &[u8], longest: u32) -> Result<(Self, &[u8]), SimError> {
        let Some((header, rest)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
            let why = format!("it has {} bytes; its header has {HEADER_BYTES}", bytes.len());
            return Err(StateError::External(why).into());
        };
        let number = u128::from_le_bytes(*header);
        let (episode, step, limit) = (number as u64, (number >> 64) as u32, (number >> 96) as u32);
        if step >= limit || limit > longest {
            let why =
                format!("its step is {step} of {limit}; an episode has at most {longest} steps");
            return Err(StateError::External(why).into());
        }
        Ok((Self { episode, step, limit }, rest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_survives_encoding_and_headers_of_finished_episodes_are_rejected() {
        let header = StateHeader { episode: 7 << 40, step: 3, limit: 5 };
        let bytes = [header.write(), b"rest".to_vec()].concat();
        let (read, rest) = StateHeader::read(&bytes, 5).unwrap();
        assert_eq!((read.episode, read.step, read.limit, rest), (7 << 40, 3, 5, &b"rest"[..]));
        for (step, limit) in [(5, 5), (0, 6), (0, 0)] {
            let bytes = StateHeader { episode: 0, step, limit }.write();
            assert!(StateHeader::read(&bytes, 5).is_err(), "step {step} of {limit}");
        }
        assert!(StateHeader::read(&bytes[..15], 5).is_err());
    }
}
