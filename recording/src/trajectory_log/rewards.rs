//! Intrinsic rewards from learners' reward logs, matched with the shares that they belong to.

use std::collections::{BTreeMap, BTreeSet};
use std::io::BufRead;
use std::path::{Path, PathBuf};

use proto::{Digest, ShareRewards};

use super::error::LogError;
use super::source::{open_lines, read_part};
use crate::share::LoggedShare;

/// Index of the lines of a run's reward logs. Their content stays in the files.
#[derive(Debug, Default)]
pub(super) struct RewardLines {
    files: Vec<PathBuf>,
    /// Configuration hashes in the lines, each with the first file that contains it.
    configs: BTreeMap<String, usize>,
    /// Lines by episode and first step; several only if they differ.
    places: BTreeMap<(String, u32), Vec<Place>>,
    remarks: Vec<String>,
    damaged: Vec<String>,
}

/// Position and key data of a line.
#[derive(Clone, Debug)]
struct Place {
    file: usize,
    /// Offset and length, bytes.
    bytes: (u64, u64),
    about: About,
    paid: Digest,
}

/// Data that a line and its share must have in common.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct About {
    /// Number of steps of the share.
    pub(super) steps: u32,
    /// Iteration of the share.
    pub(super) iteration: u64,
    /// SHA-256 of the acting weights, hexadecimal.
    pub(super) weights_sha256: String,
}

impl RewardLines {
    /// Adds the lines of a file. Damaged lines and an incomplete last line, which a killed learner leaves, are skipped
    /// and reported.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub(super) fn add(&mut self, path: &Path) -> Result<(), LogError> {
        let mut reader = open_lines(path)?;
        let (mut begin, mut damaged) = (0, Vec::new());
        for number in 1_u64.. {
            let mut bytes = Vec::new();
            reader.read_until(b'\n', &mut bytes).map_err(LogError::Read)?;
            match bytes.strip_suffix(b"\n") {
                Some(text) => match parse(text) {
                    Ok(line) => self.take(line, (begin, text.len() as u64)),
                    Err(why) => damaged.push((number, why)),
                },
                None if bytes.is_empty() => break,
                None => {
                    self.remarks.push(format!("{} ends with an incomplete line", path.display()))
                }
            }
            begin += bytes.len() as u64;
        }
        if let Some((number, why)) = damaged.first() {
            let (shown, count) = (path.display(), damaged.len());
            self.damaged
                .push(format!("{shown}: {count} damaged lines, first line {number}: {why}"));
        }
        self.files.push(path.to_path_buf());
        Ok(())
    }

    fn take(&mut self, line: ShareRewards, bytes: (u64, u64)) {
        let file = self.files.len();
        let paid = paid(line.intrinsic_reward.iter().flatten().copied());
        let about = About {
            steps: line.steps() as u32,
            iteration: line.iteration,
            weights_sha256: line.weights_sha256,
        };
        self.configs.entry(line.config_sha256).or_insert(file);
        let there = self.places.entry((line.episode_id, line.first_step)).or_default();
        if !there.iter().any(|place| place.about == about && place.paid == paid) {
            there.push(Place { file, bytes, about, paid });
        }
    }

    fn places(&self, episode: &str, first_step: u32) -> &[Place] {
        self.places.get(&(episode.to_owned(), first_step)).map_or(&[], Vec::as_slice)
    }

    /// Whether there are rewards for a share.
    pub(super) fn hold(&self, episode: &str, first_step: u32) -> bool {
        !self.places(episode, first_step).is_empty()
    }

    /// Reports of skipped incomplete lines.
    pub(super) fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// Reports of files with damaged lines.
    pub(super) fn damaged(&self) -> &[String] {
        &self.damaged
    }

    /// Reports of files whose configuration hash differs from `config_sha256`.
    pub(super) fn foreign(&self, config_sha256: Option<&String>) -> Vec<String> {
        let others = self.configs.iter().filter(|(config, _)| Some(*config) != config_sha256);
        let files: BTreeSet<usize> = others.map(|(_, file)| *file).collect();
        let foreign = |file: &usize| {
            format!(
                "{} belongs to a run with other settings or another seed",
                self.files[*file].display()
            )
        };
        files.iter().map(foreign).collect()
    }

    /// Describes a contradiction between two lines for a share, or a line and its share. `known` is the digest of the
    /// share's own rewards.
    pub(super) fn contradiction(
        &self,
        (episode, first_step): (&str, u32),
        share: &About,
        known: Option<Digest>,
    ) -> Option<String> {
        let file = |place: &Place| self.files[place.file].display();
        let why = match self.places(episode, first_step) {
            [one, other, ..] => format!("{} and {} differ", file(one), file(other)),
            [place] if place.about != *share => {
                format!("{} has other steps or weights than the share", file(place))
            }
            [place] if known.is_some_and(|known| known != place.paid) => {
                format!("{} has other rewards than the share", file(place))
            }
            _ => return None,
        };
        Some(format!("{episode} from step {first_step} on: {why}"))
    }

    /// Sets the intrinsic rewards of a share's steps, if there are any.
    ///
    /// # Errors
    /// If the file has changed since it was added, or has rewards for a different number of agents.
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
                let why = format!(
                    "{episode} has rewards for {} agents, but the log has {} agents",
                    agents.0, agents.1
                );
                return Err(unfit(why));
            }
            for (agent, rewards) in step.agents.iter_mut().zip(&line.intrinsic_reward) {
                agent.intrinsic_reward = Some(rewards[index].unwrap_or(f32::NAN));
            }
        }
        Ok(())
    }
}

/// Digest of the intrinsic rewards that a share contains; `None` if it has none.
pub(super) fn known(share: &LoggedShare) -> Option<Digest> {
    let agents = share.steps.first().map_or(0, |step| step.agents.len());
    let of =
        |agent: usize| share.steps.iter().map(move |step| step.agents.get(agent)?.intrinsic_reward);
    let any = (0..agents).flat_map(of).any(|reward| reward.is_some());
    let finite = |reward: Option<f32>| reward.filter(|reward| reward.is_finite());
    any.then(|| paid((0..agents).flat_map(of).map(finite)))
}

/// Digest of rewards, in agent order.
fn paid(rewards: impl Iterator<Item = Option<f32>>) -> Digest {
    let bits = |reward: Option<f32>| reward.unwrap_or(f32::NAN).to_le_bytes();
    Digest::of(&rewards.flat_map(bits).collect::<Vec<u8>>())
}

fn parse(text: &[u8]) -> Result<ShareRewards, String> {
    let line: ShareRewards = serde_json::from_slice(text).map_err(|error| {
        // The message ends with a position, as if the line were a file.
        let text = error.to_string();
        text.split(" at line ").next().unwrap_or_default().to_owned()
    })?;
    line.check().map(|()| line)
}
