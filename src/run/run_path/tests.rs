//! Names of run folders.

use std::time::Duration;

use serde_json::json;

use super::*;

#[test]
fn a_run_has_a_name_that_can_be_shown() {
    assert!(check_name(Path::new("runs/a run/")).is_ok());
    for hidden in ["runs/a\u{2028}b", "a\nb", "a\u{202e}", "\u{200b}", " a"] {
        let line = check_name(Path::new(hidden)).unwrap_err().to_string();
        let shown = !line.contains(['\n', '\u{2028}', '\u{202e}', '\u{200b}']);
        assert!(line.starts_with("run.dir: the name \"") && shown, "{line}");
    }
}

#[test]
fn a_new_run_is_named_for_what_it_is() {
    let now = SystemTime::UNIX_EPOCH + Duration::from_secs(951_827_696);
    assert_eq!(
        default_folder("halfcheetah-6x1", "happo", 7, now),
        PathBuf::from("runs/halfcheetah-6x1-happo-seed7-20000229-123456")
    );
    assert_eq!(
        default_folder("../My task", "happo", 7, now),
        PathBuf::from("runs/..-My-task-happo-seed7-20000229-123456")
    );
}

#[test]
fn the_newest_run_with_a_learner_comes_before_newer_ones_without() {
    let runs = tempfile::tempdir().unwrap();
    assert_eq!(newest(runs.path()), None);
    let begin = |name: &str, age_secs: u64| {
        let path = runs.path().join(name);
        let run = RunFolder::claim_new(&path).unwrap();
        run.begin("", &json!({"config_sha256": "aa"})).unwrap();
        let started = SystemTime::now() - Duration::from_secs(age_secs);
        let starts = std::fs::File::options().append(true).open(path.join(STARTS));
        starts.unwrap().set_modified(started).unwrap();
        (path, run)
    };
    std::fs::create_dir(runs.path().join("no run")).unwrap();
    let ((old, live), (new, ended)) = (begin("b", 60), begin("a", 0));
    drop(ended);
    live.note_address("127.0.0.1:50051".parse().unwrap()).unwrap();
    assert_eq!(newest(runs.path()), Some(old.clone()));
    drop(live);
    // A process that another test starts holds the lock, too, until its program begins.
    let is_free = || {
        std::thread::sleep(Duration::from_millis(10));
        !RunFolder::is_locked(&old).unwrap()
    };
    assert!((0..1000).any(|_| is_free()));
    assert_eq!(newest(runs.path()), Some(new));
}

#[test]
fn runs_of_one_second_get_folders_of_their_own_and_an_unused_one_is_removed() {
    let folder = tempfile::tempdir().unwrap();
    let first = folder.path().join("runs/a");
    let threads: Vec<_> = (0..4)
        .map(|_| {
            let first = first.clone();
            let made = move || NewFolder::made(&first).unwrap();
            std::thread::Builder::new().spawn(made).unwrap()
        })
        .collect();
    let all: Vec<_> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
    let mut names: Vec<_> = all.iter().map(|made| name(made.path())).collect();
    names.sort();
    assert_eq!(names, ["a", "a-2", "a-3", "a-4"]);
    std::fs::write(first.join("config.toml"), "").unwrap();
    drop(all);
    assert_eq!(folder.path().join("runs").read_dir().unwrap().count(), 1);
}
