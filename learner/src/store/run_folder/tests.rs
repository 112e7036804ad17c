//! A run folder: who may claim it, what its files say, and where a run may begin.

use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::time::Duration;

use security::Token;
use serde_json::json;
use tempfile::tempdir;

use super::*;

fn start() -> Value {
    json!({"config_sha256": "aa"})
}

/// A run that this process has started in `path`.
fn begun(path: &Path) -> RunFolder {
    let run = RunFolder::claim_new(path).unwrap();
    run.begin("", &start()).unwrap();
    run
}

fn resumed(path: &Path) -> Result<RunFolder, RunFolderError> {
    RunFolder::claim_existing(path, "aa")
}

#[test]
fn a_folder_says_where_its_learner_listens_while_it_does() {
    let folder = tempdir().unwrap();
    assert_eq!(RunFolder::listening(folder.path()).unwrap(), None);
    let run = RunFolder::claim_new(folder.path()).unwrap();
    run.note_address("127.0.0.1:50051".parse().unwrap()).unwrap();
    let found = RunFolder::listening(folder.path()).unwrap();
    assert_eq!(found, Some("127.0.0.1:50051".parse().unwrap()));
    drop(run);
    assert_eq!(RunFolder::listening(folder.path()).unwrap(), None);
}

#[test]
fn a_learner_that_starts_does_not_listen_where_an_earlier_one_did() {
    let folder = tempdir().unwrap();
    let run = begun(folder.path());
    run.note_address("127.0.0.1:50051".parse().unwrap()).unwrap();
    drop(run);
    let run = resumed(folder.path()).unwrap();
    let error = RunFolder::listening(folder.path()).unwrap_err().to_string();
    assert!(error.ends_with(
        "is starting and does not listen yet; repeat the command in a moment, or name its URL"
    ));
    run.note_address("127.0.0.1:50052".parse().unwrap()).unwrap();
    let found = RunFolder::listening(folder.path()).unwrap();
    assert_eq!(found, Some("127.0.0.1:50052".parse().unwrap()));
}

#[test]
fn a_place_that_holds_no_address_is_named() {
    let folder = tempdir().unwrap();
    let _run = begun(folder.path());
    for text in ["", "garbage", "http://127.0.0.1:7"] {
        fs::write(folder.path().join(ADDRESS), text).unwrap();
        let error = RunFolder::listening(folder.path()).unwrap_err().to_string();
        assert!(
            error.ends_with("address is damaged: it holds no address; name the URL of the learner")
        );
    }
}

#[test]
fn a_look_at_a_folder_does_not_keep_a_learner_from_it() {
    let folder = tempdir().unwrap();
    drop(begun(folder.path()));
    let looking = fs::File::open(folder.path()).unwrap();
    looking.try_lock_shared().unwrap();
    let look = move || {
        std::thread::sleep(Duration::from_millis(100));
        drop(looking);
    };
    let looked = std::thread::Builder::new().name("look".into()).spawn(look).unwrap();
    resumed(folder.path()).unwrap();
    looked.join().unwrap();
}

#[test]
fn a_start_moves_damaged_lines_of_earlier_ones_away() {
    let folder = tempdir().unwrap();
    drop(begun(folder.path()));
    let starts = folder.path().join(STARTS);
    let whole = fs::read_to_string(&starts).unwrap();
    fs::write(&starts, format!("\u{feff}{whole}{whole}")).unwrap();
    resumed(folder.path()).unwrap().begin("", &start()).unwrap();
    assert_eq!(fs::read_to_string(&starts).unwrap(), whole.repeat(2));
    let damaged = fs::read_to_string(folder.path().join("starts.jsonl.damaged")).unwrap();
    assert_eq!(damaged, format!("\u{feff}{whole}"));
}

#[test]
fn files_of_others_with_a_runs_names_are_known_until_a_run_begins() {
    let folder = tempdir().unwrap();
    let path = folder.path();
    assert_eq!(RunFolder::in_place_of_own(path).unwrap(), None);
    fs::write(path.join("thesis.tex"), "").unwrap();
    assert_eq!(RunFolder::in_place_of_own(path).unwrap(), None);
    fs::write(path.join(CONFIG), "mine").unwrap();
    assert_eq!(RunFolder::in_place_of_own(path).unwrap(), Some(path.join(CONFIG)));
    assert!(!RunFolder::was_started(path));
    drop(RunFolder::claim_new(path).unwrap());
    assert_eq!(RunFolder::in_place_of_own(path).unwrap(), None);
    assert!(RunFolder::was_started(path));
}

#[test]
fn a_second_learner_on_one_folder_is_refused_in_one_line() {
    let folder = tempdir().unwrap();
    let path = folder.path();
    let first = begun(path);
    let line =
        format!("{} is in use by another learner (process {})", path.display(), std::process::id());
    assert_eq!(resumed(path).unwrap_err().to_string(), line);
    assert_eq!(RunFolder::demand_free(path).unwrap_err().to_string(), line);
    fs::remove_file(path.join(LOCK)).unwrap();
    let nameless = format!("{} is in use by another learner", path.display());
    assert_eq!(RunFolder::demand_free(path).unwrap_err().to_string(), nameless);
    assert_eq!(resumed(path).unwrap_err().to_string(), nameless);
    drop(first);
    RunFolder::demand_free(path).unwrap();
    resumed(path).unwrap();
}

#[test]
fn a_start_after_one_that_a_crash_cut_off_has_a_line_of_its_own() {
    let folder = tempdir().unwrap();
    let run = begun(folder.path());
    let starts = folder.path().join(STARTS);
    let whole = fs::read_to_string(&starts).unwrap();
    assert_eq!(whole, "{\"config_sha256\":\"aa\"}\n");
    fs::write(&starts, format!("{whole}{{\"config_sha")).unwrap();
    run.begin("", &start()).unwrap();
    assert_eq!(fs::read_to_string(&starts).unwrap(), whole.repeat(2));
}

#[test]
fn a_folder_is_a_run_from_its_manifest_on_and_is_resumed_only_with_its_settings() {
    let folder = tempdir().unwrap();
    let path = folder.path();
    let refusal = |claimed: Result<RunFolder, RunFolderError>| claimed.unwrap_err().to_string();
    assert!(refusal(resumed(path)).contains("holds no run to resume"));
    let ended_early = RunFolder::claim_new(path).unwrap();
    durable::replace(&ended_early.file(CONFIG), b"a = 1\n").unwrap();
    drop(ended_early);
    assert!(refusal(resumed(path)).contains("holds no run to resume"));
    RunFolder::claim_new(path).unwrap().begin("a = 2\n", &start()).unwrap();
    assert_eq!(fs::read_to_string(path.join(CONFIG)).unwrap(), "a = 2\n");
    assert!(refusal(RunFolder::claim_new(path)).contains("holds a run already"));
    let line = RunFolder::claim_existing(path, "bb").unwrap_err().to_string();
    assert!(line.contains("config aa, this one has bb"), "{line}");
    resumed(path).unwrap();
}

#[test]
fn every_start_is_a_line_and_the_manifest_keeps_the_first() {
    let folder = tempdir().unwrap();
    let start = |commit: &str| json!({"config_sha256": "aa", "commit": commit});
    RunFolder::claim_new(folder.path()).unwrap().begin("", &start("first")).unwrap();
    let run = resumed(folder.path()).unwrap();
    run.begin("", &start("next")).unwrap();
    assert_eq!(run.manifest().unwrap()["commit"], "first");
    let lines = fs::read_to_string(run.file(STARTS)).unwrap();
    let commits = lines.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    assert!(commits.map(|start| start["commit"].clone()).eq(["first", "next"]));
}

#[test]
fn a_flipped_bit_in_any_byte_of_a_manifest_but_a_blank_is_damage() {
    let folder = tempdir().unwrap();
    let path = folder.path().join(MANIFEST);
    manifest::write(&path, json!({"config_sha256": "aa", "seed": 7})).unwrap();
    let good = fs::read(&path).unwrap();
    assert_eq!(manifest::read(&path).unwrap()["config_sha256"], "aa");
    for at in (0..good.len()).filter(|at| !good[*at].is_ascii_whitespace()) {
        let mut bad = good.clone();
        bad[at] ^= 1;
        fs::write(&path, &bad).unwrap();
        let error = manifest::read(&path).unwrap_err();
        assert!(matches!(error, RunFolderError::Damaged { .. }), "byte {at}: {error}");
    }
}

/// Only what is gone or damaged is written again.
#[test]
fn a_manifest_that_cannot_be_read_stays_as_it_is_and_the_run_is_not_resumed() {
    let folder = tempdir().unwrap();
    drop(begun(folder.path()));
    let file = folder.path().join(MANIFEST);
    fs::remove_file(&file).unwrap();
    // As for a file without permission, the error is another one than that there is no file.
    fs::create_dir(&file).unwrap();
    let error = resumed(folder.path()).unwrap_err().to_string();
    assert!(error.contains("manifest.json"), "{error}");
    assert!(file.is_dir());
}

#[test]
fn a_run_that_ever_had_a_foreign_actor_says_so_for_good() {
    let folder = tempdir().unwrap();
    let run = begun(folder.path());
    assert_eq!(run.manifest().unwrap()["foreign_actors"], false);
    run.note_foreign_actors().unwrap();
    run.begin("", &start()).unwrap();
    assert_eq!(run.manifest().unwrap()["foreign_actors"], true);
}

#[test]
fn the_token_file_is_its_owners_only_and_goes_with_the_next_start_without_one() {
    let folder = tempdir().unwrap();
    let run = RunFolder::claim_new(folder.path()).unwrap();
    assert!(RunFolder::token(folder.path()).unwrap().is_none());
    let file = RunFolder::token_file(folder.path());
    for _start in 0..2 {
        let token = Token::random().unwrap();
        // What a crash may leave.
        fs::write(folder.path().join(".tmp-token"), "").unwrap();
        run.note_token(Some(&token)).unwrap();
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        let read = RunFolder::token(folder.path()).unwrap().unwrap();
        assert_eq!(read.text(), token.text());
    }
    run.note_token(None).unwrap();
    assert!(RunFolder::token(folder.path()).unwrap().is_none());
    fs::write(&file, "abc").unwrap();
    let line = RunFolder::token(folder.path()).unwrap_err().to_string();
    assert!(line.contains("token is damaged: a token has 64"), "{line}");
}

#[test]
fn no_run_starts_in_any_folder_of_another_run() {
    let folder = tempdir().unwrap();
    let [run, link] = ["run", "link"].map(|name| folder.path().join(name));
    let _begun = begun(&run);
    symlink(&run, &link).unwrap();
    let inside = ["checkpoints/iter_00000001", "logs", "new/sub"].map(|name| run.join(name));
    fs::create_dir_all(&inside[0]).unwrap();
    for place in [&inside[..], &[link.join("logs")]].concat() {
        let error = RunFolder::claim_new(&place).unwrap_err().to_string();
        assert!(error.contains("is inside the run") && error.contains("/run,"), "{error}");
    }
    assert!(!run.join("new").exists());
    RunFolder::claim_new(&folder.path().join("beside")).unwrap();
}

#[test]
fn folders_of_other_programs_contain_no_run() {
    let folder = tempdir().unwrap();
    fs::write(folder.path().join(MANIFEST), "{}").unwrap();
    fs::create_dir(folder.path().join("checkpoints")).unwrap();
    assert_eq!(RunFolder::around(&folder.path().join("runs/a")), None);
}

#[test]
fn a_folder_whose_lock_cannot_be_opened_for_writing_is_refused_and_one_without_a_lock_is_left_as_it_is()
 {
    let folder = tempdir().unwrap();
    let path = folder.path();
    RunFolder::demand_writable(path).unwrap();
    assert_eq!(path.read_dir().unwrap().count(), 0);
    drop(begun(path));
    RunFolder::demand_writable(path).unwrap();
    fs::remove_file(path.join(LOCK)).unwrap();
    fs::create_dir(path.join(LOCK)).unwrap();
    let line = RunFolder::demand_writable(path).unwrap_err().to_string();
    let expected = format!("cannot write {}: it is a directory", path.display());
    assert!(line.starts_with(&expected), "{line}");
}

#[test]
fn a_link_to_nothing_is_named_as_the_reason_why_no_run_starts_there_or_below() {
    let folder = tempdir().unwrap();
    let link = folder.path().join("link");
    symlink("nowhere", &link).unwrap();
    let why = format!("{} is a link to nowhere, which does not exist", link.display());
    for path in [link.clone(), link.join("a/b")] {
        let shown = path.display();
        let line = RunFolder::file_of_others(&path).unwrap_err().to_string();
        assert_eq!(line, format!("cannot read {shown}: {why}"));
        let line = RunFolder::claim_new(&path).unwrap_err().to_string();
        assert_eq!(line, format!("cannot make {shown}: {why}"));
    }
}

#[test]
fn only_what_a_start_of_a_run_left_is_not_a_file_of_others() {
    let folder = tempdir().unwrap();
    let path = folder.path();
    let others = || RunFolder::file_of_others(path).unwrap();
    assert_eq!(RunFolder::file_of_others(&path.join("none")).unwrap(), None);
    fs::create_dir(path.join(LOGS)).unwrap();
    for (name, found) in [
        ("logs/actor_0.log", None),
        (CONFIG, Some(CONFIG)),
        (LOCK, None),
        ("thesis.tex", Some("thesis.tex")),
    ] {
        fs::write(path.join(name), "").unwrap();
        assert_eq!(others(), found.map(|found| path.join(found)));
    }
}

#[test]
fn a_file_system_without_locks_is_named_as_the_reason() {
    let unsupported = std::io::ErrorKind::Unsupported.into();
    let error = place::not_lockable(Path::new("a/learner.lock"), &unsupported);
    let line = "cannot lock a/learner.lock: its file system must support flock (unsupported)";
    assert_eq!(error.to_string(), line);
}

#[test]
fn a_link_or_a_pipe_in_the_place_of_a_runs_file_is_refused_and_left_as_it_is() {
    let folder = tempdir().unwrap();
    let [run, elsewhere] = ["run", "elsewhere"].map(|name| folder.path().join(name));
    drop(begun(&run));
    fs::write(&elsewhere, "mine").unwrap();
    for name in [CONFIG, LOCK, "metrics.jsonl", ".tmp-config.toml", "checkpoints"] {
        let path = run.join(name);
        let before = fs::rename(&path, run.join("before")).is_ok();
        for kind in ["a link", "a pipe"] {
            if kind == "a link" {
                symlink(&elsewhere, &path).unwrap();
            } else {
                nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
            }
            let line = resumed(&run).unwrap_err().to_string();
            assert!(line.contains(name) && line.contains(&format!("it is {kind}")), "{line}");
            fs::remove_file(&path).unwrap();
        }
        assert!(!before || fs::rename(run.join("before"), &path).is_ok());
    }
    assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "mine");
    resumed(&run).unwrap();
}

#[test]
fn a_renamed_a_replaced_a_deleted_and_an_emptied_folder_are_lost() {
    let folder = tempdir().unwrap();
    let [path, moved] = ["run", "moved"].map(|name| folder.path().join(name));
    let first = begun(&path);
    first.demand_in_place().unwrap();
    fs::rename(&path, &moved).unwrap();
    let line = first.demand_in_place().unwrap_err().to_string();
    assert!(line.starts_with(&format!("{} was renamed", path.display())), "{line}");
    let second = begun(&path);
    second.demand_in_place().unwrap();
    first.demand_in_place().unwrap_err();
    fs::remove_dir_all(&path).unwrap();
    second.demand_in_place().unwrap_err();
    fs::rename(&moved, &path).unwrap();
    first.demand_in_place().unwrap();
    fs::remove_file(path.join(LOCK)).unwrap();
    first.demand_in_place().unwrap();
    fs::remove_file(path.join(MANIFEST)).unwrap();
    first.demand_in_place().unwrap_err();
}
