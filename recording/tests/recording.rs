//! Tests of recordings: topics, schemas, messages, times, and the tools that read them.

#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "../../rollout/tests/rollout/fixture.rs"]
mod fixture;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::OnceLock;

use policy::{PolicySnapshot, RunSeed};
use proto::{Digest, PolicyVersion, WeightsName};
use recording::trajectory_log::{read_bytes, read_shares, replay};
use recording::{RecordSummary, RecordedRun};
use rollout::EvaluationEpisode;
use sim::{ObservationConfig, ObservationNorm, TaskConfig};

use fixture::{policy, policy_for, task};

fn run(policy: &PolicySnapshot) -> RecordedRun<'_> {
    RecordedRun {
        policy,
        weights: WeightsName { version: PolicyVersion(4), digest: Digest([7; 32]) },
        metadata: BTreeMap::from([("run_id".to_owned(), "test".to_owned())]),
        settings_toml: "task = \"halfcheetah-2x3\"".to_owned(),
        task_settings: serde_json::to_string(&task()).unwrap(),
    }
}

/// Episodes 2 and 3 of the evaluation of iteration 4.
struct Walk {
    bytes: Vec<u8>,
    summary: RecordSummary,
    /// Episode and step of each call.
    progress: Vec<(usize, u32)>,
}

fn walk() -> &'static Walk {
    static WALK: OnceLock<Walk> = OnceLock::new();
    WALK.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("walk.mcap");
        let (mut world, policy) = (sim::environments(&task(), 1).unwrap(), policy());
        let episodes = [2, 3].map(episode);
        let mut progress = Vec::new();
        let on_step = |index, step| progress.push((index, step));
        let summary =
            recording::record(&mut *world, &run(&policy), &episodes, &path, on_step).unwrap();
        Walk { bytes: read_bytes(&path).unwrap(), summary, progress }
    })
}

fn episode(index: u32) -> EvaluationEpisode {
    EvaluationEpisode { seed: RunSeed(1), iteration: 4, index }
}

#[test]
fn the_channels_of_a_recording_name_features_and_joints() {
    let summary = mcap::Summary::read(&walk().bytes).unwrap().unwrap();
    let names = |topic: &str, key: &str| -> Vec<String> {
        let channel = summary.channels.values().find(|channel| channel.topic == topic).unwrap();
        serde_json::from_str(&channel.metadata[key]).unwrap()
    };
    assert_eq!(names("/agents/1", "action"), ["fthigh", "fshin", "ffoot"]);
    let (observation, state) = (names("/agents/0", "observation"), names("/step", "state"));
    assert_eq!((state.len(), observation.len()), (17, 19));
    assert_eq!(observation[..17], state[..]);
    assert_eq!(observation[17..], ["id.0", "id.1"]);
}

#[test]
fn a_recording_is_a_log_of_the_episodes_and_is_replayed_bit_for_bit() {
    let Walk { bytes, summary, .. } = walk();
    // Two episodes of 1,000 steps with five messages each, and three messages an episode.
    assert_eq!(summary.messages, 10_006);
    let mut shares = Vec::new();
    let log = read_shares(bytes, |share| {
        shares.push(share);
        Ok(())
    });
    assert_eq!(log.unwrap().words["run_id"], "test");
    let ids: Vec<&str> = shares.iter().map(|share| share.head.episode_id.as_str()).collect();
    assert_eq!(ids, ["evaluation-4-2", "evaluation-4-3"]);
    for (share, episode) in shares.iter().zip(&summary.episodes) {
        let rewards = share.steps.iter().map(|step| f64::from(step.step.reward));
        assert_eq!(rewards.sum::<f64>(), episode.extrinsic_return);
        assert_eq!((share.head.seed, share.head.weights_version), (1, 4));
    }
    let replayed = replay(bytes, |_, _| {}).unwrap();
    assert_eq!((replayed.shares, replayed.steps, replayed.difference), (2, 2000, None));
}

#[test]
fn every_step_is_reported_with_the_position_of_its_episode() {
    let progress = &walk().progress;
    assert_eq!((progress.len(), progress[0], progress[1999]), (2000, (0, 1), (1, 1000)));
}

#[test]
fn a_missing_folder_is_an_error() {
    let path = Path::new("/nowhere/at/all.mcap");
    let (mut world, policy) = (sim::environments(&task(), 1).unwrap(), policy());
    assert!(recording::record(&mut *world, &run(&policy), &[], path, |_, _| {}).is_err());
}

#[test]
fn a_recorded_game_has_states_and_choices_but_no_links() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("game.mcap");
    let observation = ObservationConfig { norm: ObservationNorm::None, ..task().observation };
    let task = TaskConfig { task: "cue-2x1".to_owned(), observation, ..task() };
    let mut world = sim::environments(&task, 1).unwrap();
    let policy = policy_for(world.description());
    let task_settings = serde_json::to_string(&task).unwrap();
    let run = RecordedRun { task_settings, ..run(&policy) };
    let episodes = [0, 1].map(episode);
    let summary = recording::record(&mut *world, &run, &episodes, &path, |_, _| {}).unwrap();
    assert_eq!(summary.episodes[0].steps, 50);
    let bytes = std::fs::read(&path).unwrap();
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        *counts.entry(message.unwrap().channel.topic.clone()).or_default() += 1;
    }
    let expected =
        [("/agents/0", 100), ("/agents/1", 100), ("/share", 2), ("/share_end", 2), ("/step", 100)];
    let expected = expected.map(|(topic, count)| (topic.to_owned(), count));
    assert_eq!(counts, BTreeMap::from(expected));
}
