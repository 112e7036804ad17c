//! Tests of several logs of one run, lost shares, and the file size limit.

use std::collections::BTreeSet;

use proto::{Episodes, EvaluationWork};

use super::work::fresh_work;
use super::{WHOLE, evaluate, files, next_work, read, roll, start};
use crate::trajectory_log::source::read_bytes;
use crate::trajectory_log::{Index, join, replay};

/// Logs two successive slots by two actors; the second actor also plays an evaluation.
fn two_actors(folder: &std::path::Path) {
    let (a, handle_of_a) = start(folder, "a", Episodes::All, 64);
    let (b, handle_of_b) = start(folder, "b", Episodes::All, 64);
    evaluate(&handle_of_b, EvaluationWork { iteration: 4, episode: 1 });
    let chunks = roll(&handle_of_a, &fresh_work(), WHOLE);
    roll(&handle_of_b, &next_work(&chunks), WHOLE);
    a.close();
    b.close();
}

fn index(paths: &[std::path::PathBuf]) -> Index {
    let mut index = Index::default();
    paths.iter().for_each(|path| index.add(path).unwrap());
    index
}

#[test]
fn another_actor_continues_where_a_share_ended() {
    let folder = tempfile::tempdir().unwrap();
    two_actors(folder.path());
    let logs = files(folder.path());
    let (first, second) = (read(&logs[0]).1, read(&logs[1]).1);
    let ended = first.iter().find(|share| share.head.episode_id == "rollout-6-1").unwrap();
    let begun = second.iter().find(|share| share.head.episode_id == "rollout-6-1").unwrap();
    assert_eq!((ended.next_step(), begun.head.first_step), (25, 25));
    assert_eq!(ended.end.environment_state, begun.head.environment_state);
    assert_eq!(ended.end.state, begun.steps[0].step.state);
}

#[test]
fn joined_shares_are_in_order_and_can_be_replayed() {
    let folder = tempfile::tempdir().unwrap();
    two_actors(folder.path());
    let out = folder.path().join("joined.mcap");
    let all = index(&files(folder.path()));
    assert_eq!((all.contradictions(), all.gaps()), (Vec::new(), Vec::new()));
    let joined = join(&all, &out, |_, _| {}).unwrap();
    assert_eq!((joined.episodes, joined.shares, joined.steps), (4, 6, 185));
    let shares = read(&out).1;
    let order: Vec<_> = shares
        .iter()
        .map(|share| (share.head.episode_id.as_str(), share.head.first_step))
        .collect();
    let expected = [
        ("rollout-6-0", 0),
        ("rollout-6-1", 0),
        ("rollout-6-1", 25),
        ("rollout-7-0", 0),
        ("rollout-7-0", 40),
        ("evaluation-4-1", 0),
    ];
    assert_eq!(order, expected);
    assert_eq!(replay(&read_bytes(&out).unwrap(), |_, _| {}).unwrap().steps, 185);
    let parts = index(std::slice::from_ref(&out));
    assert_eq!((parts.gaps(), parts.copies()), (Vec::new(), 0));
    assert!(join(&all, &out, |_, _| {}).unwrap_err().to_string().contains("already exists"));
}

#[test]
fn a_join_and_a_replay_report_each_share_up_to_the_last_one() {
    let folder = tempfile::tempdir().unwrap();
    two_actors(folder.path());
    let out = folder.path().join("joined.mcap");
    let (mut written, mut replayed) = (Vec::new(), Vec::new());
    join(&index(&files(folder.path())), &out, |share, all| written.push((share, all))).unwrap();
    assert_eq!(written, [1, 2, 3, 4, 5, 6].map(|share| (share, 6)));
    replay(&read_bytes(&out).unwrap(), |step, all| replayed.push((step, all))).unwrap();
    assert_eq!((replayed.len(), replayed.last()), (6, Some(&(185, 185))));
}

#[test]
fn steps_that_are_not_in_the_given_logs_are_gaps() {
    let folder = tempfile::tempdir().unwrap();
    two_actors(folder.path());
    let second = index(&files(folder.path())[1..]);
    let gaps = ["rollout-6-1: steps 0 to 24", "rollout-7-0: steps 0 to 39"];
    assert_eq!(second.gaps(), gaps);
}

#[test]
fn a_slot_that_is_logged_twice_is_counted_once() {
    let folder = tempfile::tempdir().unwrap();
    for actor in ["a", "b"] {
        let (log, handle) = start(folder.path(), actor, Episodes::All, 64);
        roll(&handle, &fresh_work(), WHOLE);
        log.close();
    }
    let both = index(&files(folder.path()));
    assert_eq!((both.shares_and_steps(), both.copies()), ((3, 80), 3));
    assert!(both.contradictions().is_empty());
}

#[test]
fn two_different_shares_are_a_contradiction_and_are_not_joined() {
    let folder = tempfile::tempdir().unwrap();
    let (log, handle) = start(folder.path(), "a", Episodes::All, 64);
    roll(&handle, &fresh_work(), WHOLE);
    let mut other = fresh_work();
    // Another iteration draws different actions for the same steps of the same episodes.
    other.iteration += 1;
    roll(&handle, &other, WHOLE);
    log.close();
    let index = index(&files(folder.path()));
    let found = index.contradictions();
    assert_eq!(found.len(), 3);
    assert!(found[0].starts_with("rollout-6-0 from step 0 on: "), "{}", found[0]);
    let refused = join(&index, &folder.path().join("out.mcap"), |_, _| {}).unwrap_err().to_string();
    assert_eq!(refused, found[0]);
    assert_eq!(files(folder.path()).len(), 1, "the rejected file is deleted");
}

#[test]
fn an_unfinished_slot_is_not_logged() {
    let folder = tempfile::tempdir().unwrap();
    let (log, handle) = start(folder.path(), "a", Episodes::All, 64);
    assert_eq!(roll(&handle, &fresh_work(), 1).len(), 1);
    log.close();
    assert!(files(folder.path()).is_empty());
}

#[test]
fn a_deleted_folder_ends_the_log_but_not_the_rollout() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("logs");
    let (log, handle) = start(&folder, "a", Episodes::All, 64);
    std::fs::remove_dir(&folder).unwrap();
    assert_eq!(roll(&handle, &fresh_work(), WHOLE).len(), 2);
    log.close();
    assert!(!folder.exists());
}

#[test]
fn a_log_continues_in_a_new_file_at_the_size_limit() {
    let folder = tempfile::tempdir().unwrap();
    let (log, handle) = start(folder.path(), "a", Episodes::All, 1);
    let mut work = fresh_work();
    for _ in 0..60 {
        work = next_work(&roll(&handle, &work, WHOLE));
    }
    log.close();
    let logs = files(folder.path());
    assert!(logs.len() > 1, "one file");
    let names: BTreeSet<_> = logs.iter().map(|path| path.file_name().unwrap()).collect();
    assert!(names.contains(std::ffi::OsStr::new("trajectories-a-0001.mcap")));
    let index = index(&logs);
    assert_eq!((index.shares_and_steps().1, index.gaps()), (4800, Vec::new()));
}
