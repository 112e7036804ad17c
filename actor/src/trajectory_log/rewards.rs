//! Intrinsic rewards, which learners log beside the actors, found for the shares that they belong to.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use proto::ShareRewards;
use sha2::{Digest as _, Sha256};

use super::LogError;
use super::shares::LoggedShare;
use super::source::{open, read_part};

/// The lines of a run's reward logs. They stay in their files.
#[derive(Debug, Default)]
pub(super) struct RewardLines {
    files: Vec<PathBuf>,
    /// By episode and first step; only lines that differ have more than one place.
    places: BTreeMap<(String, u32), Vec<Place>>,
}

/// Where a line stands, and what it is about.
#[derive(Clone, Debug)]
struct Place {
    file: usize,
    /// First byte and number of bytes.
    bytes: (u64, u64),
    digest: [u8; 32],
    about: About,
}

/// What a line and its share must have in common.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct About {
    /// Steps of the share.
    pub(super) steps: u32,
    /// The iteration that they belong to.
    pub(super) iteration: u64,
    /// The weights that acted, hexadecimal.
    pub(super) weights_sha256: String,
}

impl RewardLines {
    /// Takes the lines of a file in. Half a line at its end, which a learner that was killed left, is passed over.
    ///
    /// # Errors
    /// If the file cannot be read, or a line is none of a reward log.
    pub(super) fn add(&mut self, path: &Path) -> Result<(), LogError> {
        let mut reader = BufReader::new(open(path)?);
        let (mut begin, mut number) = (0, 1);
        while let Some(bytes) = next_line(&mut reader)? {
            let line = parse(&bytes).map_err(|detail| LogError::Line { number, detail })?;
            self.take(line, (begin, &bytes));
            (begin, number) = (begin + bytes.len() as u64, number + 1);
        }
        self.files.push(path.to_path_buf());
        Ok(())
    }

    fn take(&mut self, line: ShareRewards, (begin, bytes): (u64, &[u8])) {
        let digest = Sha256::digest(bytes).into();
        let there = self.places.entry((line.episode_id, line.first_step)).or_default();
        if there.iter().any(|place| place.digest == digest) {
            return;
        }
        let about = About {
            steps: line.intrinsic_reward[0].len() as u32,
            iteration: line.iteration,
            weights_sha256: line.weights_sha256,
        };
        let bytes = (begin, bytes.len() as u64);
        there.push(Place { file: self.files.len(), bytes, digest, about });
    }

    fn places(&self, episode: &str, first_step: u32) -> &[Place] {
        self.places.get(&(episode.to_owned(), first_step)).map_or(&[], Vec::as_slice)
    }

    /// Whether there are intrinsic rewards for a share.
    pub(super) fn hold(&self, episode: &str, first_step: u32) -> bool {
        !self.places(episode, first_step).is_empty()
    }

    /// What two lines for one share, or a line and its share, say differently.
    pub(super) fn contradiction(
        &self,
        episode: &str,
        first_step: u32,
        share: &About,
    ) -> Option<String> {
        let file = |place: &Place| self.files[place.file].display();
        let why = match self.places(episode, first_step) {
            [one, other, ..] => format!("{} and {} differ", file(one), file(other)),
            [place] if place.about != *share => {
                format!("{} is about other steps or weights than the share", file(place))
            }
            _ => return None,
        };
        Some(format!("{episode} from step {first_step} on: {why}"))
    }

    /// Sets the intrinsic rewards of a share's steps, if there are any.
    ///
    /// # Errors
    /// If the file has changed since it was taken in, or is about another number of agents.
    pub(super) fn fill(&self, share: &mut LoggedShare) -> Result<(), LogError> {
        let (episode, first) = (&share.head.episode_id, share.head.first_step);
        let Some(place) = self.places(episode, first).first() else { return Ok(()) };
        let path = &self.files[place.file];
        let unfit = |why: String| LogError::Unfit(format!("{}: {why}", path.display()));
        let line = read_part(path, place.bytes.0, place.bytes.1)?;
        let line = parse(&line).map_err(unfit)?;
        for (index, step) in share.steps.iter_mut().enumerate() {
            let agents = (line.intrinsic_reward.len(), step.agents.len());
            if agents.0 != agents.1 {
                let why = format!("{episode} is paid to {} agents, not to {}", agents.0, agents.1);
                return Err(unfit(why));
            }
            for (agent, rewards) in step.agents.iter_mut().zip(&line.intrinsic_reward) {
                agent.intrinsic_reward = rewards.get(index).copied();
            }
        }
        Ok(())
    }
}

/// The next whole line, with its end.
fn next_line(reader: &mut impl BufRead) -> Result<Option<Vec<u8>>, LogError> {
    let mut bytes = Vec::new();
    reader.read_until(b'\n', &mut bytes).map_err(LogError::Read)?;
    Ok(bytes.ends_with(b"\n").then_some(bytes))
}

fn parse(bytes: &[u8]) -> Result<ShareRewards, String> {
    let line: ShareRewards = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    let first = line.intrinsic_reward.first().map_or(0, Vec::len);
    let even = line.intrinsic_reward.iter().all(|rewards| rewards.len() == first);
    if first == 0 || !even {
        return Err("its agents are not paid for as many steps each".to_owned());
    }
    Ok(line)
}
