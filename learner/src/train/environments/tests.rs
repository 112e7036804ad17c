//! First limits, running returns, and continuation over iterations.

use proto::{ActorId, LeaseId, SlotEnd, TrajectoryChunk};

use super::*;
use crate::train::assemble::tests::run_of_one_agent;

/// Two environments of one agent with 2 recurrent units, whose episodes have this many steps.
fn fresh(episode_steps: u32, phase: Phase) -> Environments {
    Environments::fresh(&run(episode_steps), 2, phase)
}

fn run(episode_steps: u32) -> RunDescription {
    let mut run = run_of_one_agent(1, 2);
    run.environment.episode_steps = episode_steps;
    run
}

fn batch(reward: [f32; 6], done_rows: &[usize]) -> Batch {
    let truncated = (0..6).map(|row| done_rows.contains(&row)).collect();
    let (steps, environments) = (3, 2);
    let (reward, terminated) = (reward.to_vec(), vec![false; 6]);
    Batch { steps, environments, reward, terminated, truncated, ..Batch::default() }
}

fn rollout() -> SlotRollout {
    let end = SlotEnd {
        environments: vec![vec![1, 2, 3], vec![4]],
        recurrent: vec![vec![0.1, 0.2, 0.3, 0.4]],
    };
    let chunk = TrajectoryChunk { steps: 3, end: Some(end), ..TrajectoryChunk::default() };
    let (actor, lease, digests) = (ActorId(1), LeaseId(1), Vec::new());
    SlotRollout { slot: 0, actor, lease, chunks: vec![chunk], digests }
}

fn limits(count: usize, episode_steps: u32, phase: Phase) -> Vec<u32> {
    let work = Environments::fresh(&run(episode_steps), count, phase).work(0, 2);
    let starts = work.into_iter().flat_map(|slot| slot.environments);
    let limit = |start: EnvironmentStart| match start.start {
        Start::Fresh { episode: 0, limit } => limit,
        other => panic!("not a first start: {other:?}"),
    };
    starts.map(limit).collect()
}

#[test]
fn staggered_first_episodes_end_at_even_intervals() {
    assert_eq!(limits(4, 1000, Phase::Staggered), [250, 500, 750, 1000]);
    assert_eq!(limits(6, 4, Phase::Staggered), [1, 1, 2, 2, 3, 4]);
    assert_eq!(limits(4, 1000, Phase::Lockstep), [1000; 4]);
}

#[test]
fn an_episode_truncated_before_its_limit_is_counted_as_a_fault() {
    // Limits 2 and 4: environment 0 reaches its limit with step 1; the end of environment 1 after step 0 is a fault.
    let mut environments = fresh(4, Phase::Staggered);
    environments.advance(&batch([0.0; 6], &[1, 2]), &[rollout()]);
    assert_eq!(environments.faults, 1);
    environments.advance(&batch([0.0; 6], &[]), &[rollout()]);
    assert_eq!(environments.faults, 0);
}

#[test]
fn a_shortened_first_episode_is_not_counted_and_the_next_one_is() {
    // Limits 2 and 4: environment 0 ends after step 1 (not counted), environment 1 continues.
    let mut environments = fresh(4, Phase::Staggered);
    environments.advance(&batch([1.0, 10.0, 1.0, 10.0, 3.0, 10.0], &[2]), &[rollout()]);
    assert_eq!(environments.mean_return(), None);
    // Environment 1 ends after one more step with 40; environment 0 after three more with 3 + 6.
    environments.advance(&batch([2.0, 10.0, 2.0, 0.0, 2.0, 0.0], &[1, 4]), &[rollout()]);
    assert_eq!(environments.mean_return(), Some((40.0 + 9.0) / 2.0));
}

#[test]
fn the_mean_is_that_of_the_last_twenty_episodes() {
    let mut environments = fresh(1, Phase::Lockstep);
    let all = [0, 1, 2, 3, 4, 5];
    environments.advance(&batch([1000.0; 6], &all), &[rollout()]);
    for _ in 0..3 {
        environments.advance(&batch([1.0; 6], &all), &[rollout()]);
    }
    // 18 of the last 20 episodes have return 1.
    assert_eq!(environments.mean_return(), Some((18.0 + 2.0 * 1000.0) / 20.0));
}

#[test]
fn environments_continue_from_the_end_states_of_slots_or_begin_the_next_episode() {
    let mut environments = fresh(9, Phase::Staggered);
    assert!(!environments.begin_again(0), "it continues no episode");
    assert_eq!(environments, fresh(9, Phase::Staggered));
    environments.advance(&batch([0.5; 6], &[]), &[rollout()]);
    let starts = |all: Vec<EnvironmentStart>| all.into_iter().map(|e| e.start).collect::<Vec<_>>();
    let first = Start::Continue { state: vec![1, 2, 3], recurrent: vec![vec![0.1, 0.2]] };
    let second = Start::Continue { state: vec![4], recurrent: vec![vec![0.3, 0.4]] };
    let next = environments.work(1, 2).remove(0).environments;
    assert_eq!(starts(next), [first, second.clone()]);
    assert!(environments.begin_again(0));
    let first = Start::Fresh { episode: 1, limit: 9 };
    assert_eq!(starts(environments.starts_of(&[0, 1])), [first, second]);
    let mut restored = fresh(9, Phase::Staggered);
    restored.restore(&environments.arrays(), 1).unwrap();
    assert_eq!(restored, environments);
    for mut both in [environments, restored] {
        both.advance(&batch([0.5; 6], &[]), &[rollout()]);
        assert_eq!(both.begun_again, [0], "also after a resume");
        both.advance(&batch([0.5; 6], &[]), &[rollout()]);
        assert_eq!(both.begun_again, [0; 0]);
    }
}

#[test]
fn states_are_invalid_that_cannot_be_decoded_or_are_at_another_position() {
    let mut environments = fresh(9, Phase::Lockstep);
    environments.advance(&batch([0.5; 6], &[1]), &[rollout()]);
    let position = |episode, step| EpisodePosition { episode, step, limit: 9 };
    let positions = move |first: EpisodePosition, second: EpisodePosition| {
        StateReader::new(move |state| Ok(if state == [4] { second } else { first }))
    };
    assert_eq!(environments.invalid(&positions(position(0, 3), position(1, 2))), []);
    let found = environments.invalid(&positions(position(0, 3), position(0, 2)));
    let why = "it is at step 2 of 9 of episode 0, its environment is at step 2 of 9 of episode 1";
    assert_eq!(found, [(1, why.to_owned())]);
    let unread = StateReader::new(|_| Err("no state".to_owned()));
    assert_eq!(environments.invalid(&unread).len(), 2);
}

#[test]
fn a_missing_or_invalid_array_is_named_in_the_error() {
    let mut environments = fresh(2, Phase::Lockstep);
    environments.advance(&batch([0.5; 6], &[]), &[rollout()]);
    for name in environments.arrays().keys() {
        let mut arrays = environments.arrays();
        arrays.insert(name.clone(), Array::F32 { shape: vec![1], data: vec![0.0] });
        let error = environments.clone().restore(&arrays, 1).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
        arrays.remove(name);
        let error = environments.clone().restore(&arrays, 1).unwrap_err().to_string();
        assert!(error.contains(&format!("array {name} is missing")), "{error}");
    }
}
