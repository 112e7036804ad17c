//! Tests of several logs of one run, lost shares, and the file size limit.

use std::collections::BTreeSet;
use std::path::PathBuf;

use proto::{Episodes, EvaluationWork};

use super::work::fresh_work;
use super::{WHOLE, evaluate, files, next_work, read, roll, start};

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
    let steps = |path: &PathBuf| read(path).1.iter().map(|share| share.steps.len()).sum::<usize>();
    assert_eq!(logs.iter().map(steps).sum::<usize>(), 4800);
}
