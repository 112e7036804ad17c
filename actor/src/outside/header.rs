//! Header of an encoded state of an external environment.

use sim::{SimError, StateError};

/// Size of the header, bytes.
pub(super) const HEADER_BYTES: usize = 16;

/// Header of an encoded state.
pub(super) struct Header {
    pub(super) episode: u64,
    pub(super) step: u32,
    pub(super) limit: u32,
}

impl Header {
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
        let header = Header { episode: 7 << 40, step: 3, limit: 5 };
        let bytes = [header.write(), b"rest".to_vec()].concat();
        let (read, rest) = Header::read(&bytes, 5).unwrap();
        assert_eq!((read.episode, read.step, read.limit, rest), (7 << 40, 3, 5, &b"rest"[..]));
        for (step, limit) in [(5, 5), (0, 6), (0, 0)] {
            let bytes = Header { episode: 0, step, limit }.write();
            assert!(Header::read(&bytes, 5).is_err(), "step {step} of {limit}");
        }
        assert!(Header::read(&bytes[..15], 5).is_err());
    }
}
