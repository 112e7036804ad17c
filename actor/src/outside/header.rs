//! Header of an encoded state of an external environment, and the history of an episode that is replayed.

use proto::EpisodePosition;
use sim::{SimError, StateError};

/// Size of the header, bytes.
pub(super) const HEADER_BYTES: usize = 16;

/// Size of an episode's key, bytes.
pub(super) const KEY_BYTES: usize = 32;

/// The key and the actions, `[steps, A]`, of an episode with joint actions of `width` numbers.
pub(super) fn history(
    steps: u32,
    past: &[u8],
    width: usize,
) -> Result<([u8; KEY_BYTES], Vec<f32>), SimError> {
    let found = past.len();
    let expected = KEY_BYTES + 4 * width * steps as usize;
    let Some((key, rest)) = past.split_first_chunk::<KEY_BYTES>().filter(|_| found == expected)
    else {
        let why = format!("its history has {found} bytes; {steps} steps have {expected}");
        return Err(StateError(why).into());
    };
    let (rest, _) = rest.as_chunks::<4>();
    let actions = rest.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect::<Vec<_>>();
    if actions.iter().any(|action| !action.is_finite()) {
        let why = "its history has an action that is not finite".to_owned();
        return Err(StateError(why).into());
    }
    Ok((*key, actions))
}

/// The header of a state at `position`.
pub(super) fn header(position: EpisodePosition) -> Vec<u8> {
    let EpisodePosition { episode, step, limit } = position;
    [&episode.to_le_bytes()[..], &step.to_le_bytes(), &limit.to_le_bytes()].concat()
}

/// Reads the header; also returns the bytes after it.
pub(super) fn read_header(
    bytes: &[u8],
    longest: u32,
) -> Result<(EpisodePosition, &[u8]), SimError> {
    let Some((header, rest)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
        let why = format!("it has {} bytes; its header has {HEADER_BYTES}", bytes.len());
        return Err(StateError(why).into());
    };
    let number = u128::from_le_bytes(*header);
    let episode = number as u64;
    let step = (number >> 64) as u32;
    let limit = (number >> 96) as u32;
    if step >= limit || limit > longest {
        let why = format!(
            "its step is {step} of {limit}, an episode has at most {longest} steps; a state begins with its episode (u64), \
             step and limit (u32)"
        );
        return Err(StateError(why).into());
    }
    Ok((EpisodePosition { episode, step, limit }, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_survives_encoding_and_headers_of_finished_episodes_are_rejected() {
        let position = EpisodePosition { episode: 7 << 40, step: 3, limit: 5 };
        let bytes = [header(position), b"rest".to_vec()].concat();
        assert_eq!(read_header(&bytes, 5).unwrap(), (position, &b"rest"[..]));
        for (step, limit) in [(5, 5), (0, 6), (0, 0)] {
            let bytes = header(EpisodePosition { episode: 0, step, limit });
            assert!(read_header(&bytes, 5).is_err(), "step {step} of {limit}");
        }
        assert!(read_header(&bytes[..15], 5).is_err());
    }
}
