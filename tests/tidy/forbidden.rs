//! Words and calls that the project must not contain. Clippy's list (`clippy.toml`) sees types and so
//! catches more; what is here also holds for text that clippy does not read.

use crate::assert_none;
use crate::repository::{LIBRARIES, Text, rust_files, texts};
use crate::rust_text::code_lines;

/// Crates whose results must depend on their arguments only.
const PURE: [&str; 6] = ["kernels", "marl", "policy", "proto", "rollout", "sim"];
/// Crates whose numbers reach the weights.
const EXACT: [&str; 5] = ["kernels", "marl", "policy", "rollout", "sim"];

/// A piece of code, the crates that must not contain it, and why.
type Ban = (&'static str, &'static [&'static str], &'static str);

const BANS: [Ban; 15] = [
    ("thread_rng", &LIBRARIES, "draws come from policy::randomness"),
    ("from_entropy", &LIBRARIES, "draws come from policy::randomness"),
    ("from_os_rng", &LIBRARIES, "draws come from policy::randomness"),
    ("HashMap", &EXACT, "its order differs from process to process: BTreeMap or Vec"),
    ("HashSet", &EXACT, "its order differs from process to process: BTreeSet or Vec"),
    ("Instant::now", &PURE, "time is passed in"),
    ("SystemTime", &PURE, "time is passed in"),
    ("std::fs", &PURE, "bytes are passed in"),
    ("std::net", &PURE, "no sockets here"),
    ("std::env", &PURE, "settings are passed in"),
    ("std::process", &PURE, "no processes here"),
    ("println!(", &LIBRARIES, "return it, or log it with tracing"),
    ("dbg!(", &LIBRARIES, "left over"),
    ("serde(default", &LIBRARIES, "a default is in configs/base.toml and nowhere else"),
    ("unimplemented!(", &LIBRARIES, "finish it or leave it out"),
];

/// Where a ban does not apply. safetensors takes a file's metadata as a `HashMap`; with a single entry, which is all we
/// write, it has one order only. A task file is not a setting: what it leaves out is absent or MuJoCo's.
const EXCEPTIONS: [(&str, &str); 4] = [
    ("HashMap", "policy/src/arrays.rs"),
    ("serde(default", "sim/src/robot/softness.rs"),
    ("serde(default", "sim/src/task/definition.rs"),
    ("serde(default", "sim/src/task/start.rs"),
];

fn is_source_of(path: &str, crates: &[&str]) -> bool {
    crates.iter().any(|name| path.starts_with(&format!("{name}/src/")))
}

fn breaches(file: &Text) -> Vec<String> {
    let bans = BANS.iter().filter(|(_, crates, _)| is_source_of(&file.path, crates));
    let bans = bans.filter(|(call, ..)| !EXCEPTIONS.contains(&(call, file.path.as_str())));
    let mut found = Vec::new();
    for (call, _, reason) in bans {
        let hits = code_lines(&file.body).filter(|(_, line)| line.contains(call));
        found.extend(hits.map(|(number, _)| format!("{}:{number}: {call}: {reason}", file.path)));
    }
    found
}

#[test]
fn no_crate_calls_what_would_break_its_promise() {
    let found = rust_files().iter().flat_map(breaches).collect::<Vec<_>>();
    assert_none("forbidden here:", &found);
}

/// What only some files of `actor`, `learner` and `recording` may do, by the beginnings of their paths.
const PLACES: [(&str, &[&str], &str); 2] = [
    (
        "wire::",
        &[
            "actor/src/client",
            "actor/src/stepping",
            "learner/src/lease/check.rs",
            "learner/src/serve/service",
        ],
        "face the network",
    ),
    (
        "std::fs",
        &[
            "learner/src/store/checkpoint",
            "learner/src/store/durable",
            "learner/src/store/json_lines",
            "learner/src/store/plain_file",
            "learner/src/observe/metrics",
            "learner/src/serve/page/exposition",
            "learner/src/store/run_folder",
            "recording/src/mcap_file",
            "recording/src/record.rs",
            "recording/src/trajectory_log/file",
            "recording/src/trajectory_log/source",
            "recording/src/trajectory_log/tests",
        ],
        "touch the disk",
    ),
];

#[test]
fn only_the_files_meant_for_it_face_the_network_or_the_disk() {
    let mut found = Vec::new();
    let crates = ["actor", "learner", "recording"];
    for file in rust_files().iter().filter(|file| is_source_of(&file.path, &crates)) {
        for (call, places, deed) in PLACES {
            let elsewhere = !places.iter().any(|place| file.path.starts_with(place));
            let hits = code_lines(&file.body).filter(|(_, line)| elsewhere && line.contains(call));
            found.extend(
                hits.map(|(number, _)| format!("{}:{number}: only {places:?} {deed}", file.path)),
            );
        }
    }
    assert_none("this belongs into another file:", &found);
}

#[test]
fn no_test_can_be_skipped() {
    let ignored = concat!("#[", "ignore");
    let files = rust_files().into_iter().filter(|file| file.body.contains(ignored));
    let found = files.map(|file| file.path).collect::<Vec<_>>();
    assert_none("a test that does not run tells nothing:", &found);
}

/// Unfinished work, paths of one machine, and talk about how the text came to be. Cut in two so that
/// this file does not hold them.
const WORDS: [&str; 17] = [
    concat!("TO", "DO"),
    concat!("hash", "_here"),
    concat!("FIX", "ME"),
    concat!("XX", "X:"),
    concat!("HACK", ":"),
    concat!("to", "do!("),
    concat!("for ", "now"),
    concat!("/wo", "rk/"),
    concat!("/ho", "me/"),
    concat!("/ro", "ot/"),
    concat!("sandbox", "ed machine"),
    concat!("cla", "ude"),
    concat!("anth", "ropic"),
    concat!("chat", "gpt"),
    concat!("language ", "model"),
    concat!("ai ", "agent"),
    concat!("ai-", "generated"),
];

#[test]
fn no_file_holds_unfinished_work_or_the_paths_of_one_machine() {
    let mut found = Vec::new();
    for file in texts().into_iter().filter(|file| file.path != "Cargo.lock") {
        let lines = file.body.lines().map(str::to_lowercase).enumerate().collect::<Vec<_>>();
        for word in WORDS.map(str::to_lowercase) {
            let hits = lines.iter().filter(|(_, line)| line.contains(&word));
            found.extend(hits.map(|(index, _)| format!("{}:{}: {word}", file.path, index + 1)));
        }
    }
    assert_none("words that do not belong here:", &found);
}
