//! Tests of matching a learner's intrinsic rewards with logged steps.

use std::path::{Path, PathBuf};

use policy::arrays::hex;
use proto::{ShareRewards, reward_log_name};

use super::work::run;
use super::{files, read, slot_log};
use crate::share::LoggedShare;
use crate::trajectory_log::{Index, join};

/// Reward line of a share: -1, -2, ... for the first agent, lower by 0.1 for each further agent.
fn paid(share: &LoggedShare) -> ShareRewards {
    let reward = |agent: usize, step: usize| -((step + 1) as f32) - 0.1 * agent as f32;
    let agents = 0..share.steps[0].agents.len();
    let steps = |agent| (0..share.steps.len()).map(|step| Some(reward(agent, step))).collect();
    let unsealed = ShareRewards {
        episode_id: share.head.episode_id.clone(),
        first_step: share.head.first_step,
        iteration: share.head.iteration,
        weights_sha256: hex(&share.head.weights_sha256),
        config_sha256: run().config_sha256.to_string(),
        intrinsic_reward: agents.map(steps).collect(),
        sha256: String::new(),
    };
    unsealed.sealed()
}

/// Changes a line and updates its checksum.
fn alter(line: &mut ShareRewards, change: impl FnOnce(&mut ShareRewards)) {
    change(line);
    *line = line.clone().sealed();
}

fn lines(rewards: &[ShareRewards]) -> String {
    rewards.iter().map(|line| serde_json::to_string(line).unwrap() + "\n").collect()
}

/// Writes a log of three shares and returns their reward lines, in the order in which they are joined.
fn logged(folder: &Path) -> Vec<ShareRewards> {
    let mut rewards: Vec<_> = read(&slot_log(folder).0).1.iter().map(paid).collect();
    rewards.sort_by_key(|line| line.episode_id.clone());
    rewards
}

fn reward_log(folder: &Path, start: u64, text: &str) -> PathBuf {
    let path = folder.join(reward_log_name(start));
    std::fs::write(&path, text).unwrap();
    path
}

fn index(paths: &[PathBuf]) -> Index {
    let mut index = Index::default();
    paths.iter().for_each(|path| index.add(path).unwrap());
    index
}

fn joined(folder: &Path, paths: &[PathBuf]) -> Vec<LoggedShare> {
    let out = folder.join("joined.mcap");
    join(&index(paths), &out, |_, _| {}).unwrap();
    read(&out).1
}

fn found(shares: &[LoggedShare]) -> Vec<Vec<Vec<Option<f32>>>> {
    let agents = |share: &LoggedShare| 0..share.steps[0].agents.len();
    let of = |share: &LoggedShare, agent: usize| {
        share.steps.iter().map(|step| step.agents[agent].intrinsic_reward).collect()
    };
    shares.iter().map(|share| agents(share).map(|agent| of(share, agent)).collect()).collect()
}

fn expected(rewards: &[ShareRewards]) -> Vec<Vec<Vec<Option<f32>>>> {
    rewards.iter().map(|line| line.intrinsic_reward.clone()).collect()
}

#[test]
fn joined_steps_have_the_rewards_that_the_learner_logged() {
    let folder = tempfile::tempdir().unwrap();
    let rewards = logged(folder.path());
    // The lines are not in order, and a restarted learner has logged some of them again.
    reward_log(folder.path(), 1, &lines(&[rewards[2].clone(), rewards[0].clone()]));
    reward_log(folder.path(), 2, &lines(&rewards));
    let paths = files(folder.path());
    let all = index(&paths);
    assert_eq!((all.paid(), all.contradictions()), ((3, 3), Vec::new()));
    let shares = joined(folder.path(), &paths);
    assert_eq!(found(&shares), expected(&rewards));
}

#[test]
fn shares_without_a_line_have_no_rewards_and_incomplete_lines_are_skipped() {
    let folder = tempfile::tempdir().unwrap();
    let rewards = logged(folder.path());
    let text = lines(&rewards);
    let half = text.len() - 20;
    reward_log(folder.path(), 1, &text[..half]);
    let index = index(&files(folder.path()));
    assert_eq!((index.paid(), index.damaged().len()), ((2, 3), 0));
    assert!(index.remarks()[0].ends_with("rewards-0001.jsonl ends with an incomplete line"));
    let shares = joined(folder.path(), &files(folder.path()));
    assert_eq!(found(&shares)[..2], expected(&rewards)[..2]);
    assert!(found(&shares)[2].iter().flatten().all(Option::is_none));
}

#[test]
fn a_joined_log_keeps_its_rewards_when_joined_again_with_its_sources() {
    let folder = tempfile::tempdir().unwrap();
    let rewards = logged(folder.path());
    let (raw, out) = (files(folder.path()).remove(0), folder.path().join("joined.mcap"));
    reward_log(folder.path(), 1, &lines(&rewards));
    joined(folder.path(), &files(folder.path()));
    for order in [[raw.clone(), out.clone()], [out, raw]] {
        let index = index(&order);
        assert_eq!((index.paid(), index.copies()), ((3, 3), 3));
        let out = folder.path().join("again.mcap");
        join(&index, &out, |_, _| {}).unwrap();
        assert_eq!(found(&read(&out).1), expected(&rewards));
        std::fs::remove_file(out).unwrap();
    }
}

/// The only contradiction of the log and reward logs in a folder, which prevents a join.
fn contradiction(folder: &Path) -> String {
    let index = index(&files(folder));
    let found = index.contradictions();
    let refused = join(&index, &folder.join("joined.mcap"), |_, _| {}).unwrap_err().to_string();
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(found[0], refused);
    refused
}

#[test]
fn rewards_with_other_steps_or_weights_contradict_the_share() {
    let changes: [fn(&mut ShareRewards); 3] = [
        |line| line.weights_sha256 = "0".repeat(64),
        |line| line.iteration += 1,
        |line| line.intrinsic_reward.iter_mut().for_each(|steps| steps.push(Some(0.0))),
    ];
    for change in changes {
        let folder = tempfile::tempdir().unwrap();
        let mut rewards = logged(folder.path());
        alter(&mut rewards[1], change);
        let path = reward_log(folder.path(), 1, &lines(&rewards));
        let expected = format!("{} has other steps or weights than the share", path.display());
        let found = contradiction(folder.path());
        assert_eq!(found, format!("rollout-6-1 from step 0 on: {expected}"));
    }
}

#[test]
fn different_rewards_of_a_share_are_a_contradiction() {
    let folder = tempfile::tempdir().unwrap();
    let mut rewards = logged(folder.path());
    let first = reward_log(folder.path(), 1, &lines(&rewards));
    alter(&mut rewards[1], |line| line.intrinsic_reward[0][0] = Some(7.0));
    let second = reward_log(folder.path(), 2, &lines(&rewards));
    let expected = format!("{} and {} differ", first.display(), second.display());
    let found = contradiction(folder.path());
    assert_eq!(found, format!("rollout-6-1 from step 0 on: {expected}"));
}

#[test]
fn rewards_for_a_wrong_number_of_agents_are_rejected_without_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut rewards = logged(folder.path());
    alter(&mut rewards[0], |line| drop(line.intrinsic_reward.pop()));
    reward_log(folder.path(), 1, &lines(&rewards));
    let paths = files(folder.path());
    let refused = join(&index(&paths), &folder.path().join("joined.mcap"), |_, _| {})
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("rollout-6-0 has rewards for 1 agents, but the log has 2 agents"),
        "{refused}"
    );
    assert_eq!(files(folder.path()), paths);
}

#[test]
fn joined_logs_and_lines_with_different_rewards_are_contradictions() {
    let folder = tempfile::tempdir().unwrap();
    let mut rewards = logged(folder.path());
    reward_log(folder.path(), 1, &lines(&rewards));
    let one = folder.path().join("joined.mcap");
    joined(folder.path(), &files(folder.path()));
    alter(&mut rewards[1], |line| line.intrinsic_reward[0][0] = None);
    let line = reward_log(folder.path(), 1, &lines(&rewards));
    let raw = folder.path().join("trajectories-a-0000.mcap");
    let two = folder.path().join("other.mcap");
    join(&index(&[raw, line.clone()]), &two, |_, _| {}).unwrap();
    let first = &read(&two).1[1].steps[0].agents[0];
    assert!(first.intrinsic_reward.unwrap().is_nan(), "a non-finite reward is NaN");
    let shown = [&one, &two, &line].map(|path| path.display().to_string());
    let place = "rollout-6-1 from step 0 on: ";
    let differ = format!("{place}{} and {} differ", shown[0], shown[1]);
    assert_eq!(index(&[one.clone(), two.clone()]).contradictions(), [differ]);
    let pays = format!("{place}{} has other rewards than the share", shown[2]);
    assert_eq!(index(&[one, line.clone()]).contradictions(), [pays]);
    assert_eq!(index(&[two, line]).contradictions(), [""; 0]);
}

#[test]
fn rewards_of_another_run_are_a_contradiction() {
    let folder = tempfile::tempdir().unwrap();
    let mut rewards = logged(folder.path());
    alter(&mut rewards[1], |line| line.config_sha256 = "f".repeat(64));
    let path = reward_log(folder.path(), 1, &lines(&rewards));
    let expected = "belongs to a run with other settings or another seed";
    assert_eq!(contradiction(folder.path()), format!("{} {expected}", path.display()));
}

#[test]
fn damaged_lines_are_skipped_and_the_first_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let rewards = logged(folder.path());
    let mut changed = rewards[0].clone();
    changed.intrinsic_reward[0][0] = Some(7.0);
    for (wrong, why) in [
        ("{\"iteration\": 4}".to_owned(), "missing field `episode_id`"),
        ("\u{1}".to_owned(), "expected value"),
        (lines(&[changed]), "the checksum does not match the content"),
        (
            lines(&rewards[..1]).replace("{\"ep", "{\"newer\":1,\"ep"),
            "unknown field `newer`, expected one of `episode_id`, `first_step`, `iteration`, \
             `weights_sha256`, `config_sha256`, `intrinsic_reward`, `sha256`",
        ),
    ] {
        let text = lines(&rewards[1..2]) + wrong.trim_end() + "\n" + &lines(&rewards[2..]);
        let path = reward_log(folder.path(), 1, &text);
        let index = index(&files(folder.path()));
        let report = format!("{}: 1 damaged lines, first line 2: {why}", path.display());
        assert_eq!((index.damaged(), index.paid()), (&[report][..], (2, 3)));
    }
}
