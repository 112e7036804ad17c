//! Short runs end with the weights and the state whose SHA-256 are in `tests/data/golden.json`,
//! on every machine and with every SIMD width of its processor. If cargo uses a runner for tests of another
//! architecture, the learner and the actor use it too.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;

/// Task, algorithm and core of each run, and other settings of it.
const CASES: [[&str; 3]; 20] = [
    ["halfcheetah-2x3", "happo-s2mia", "gru"],
    ["halfcheetah-2x3", "happo-s2mia", "mlp"],
    ["walker2d-2x3", "happo-s2mia", "gru"],
    ["walker2d-2x3", "happo-s2mia", "mlp"],
    ["ant-4x2", "happo-s2mia", "gru"],
    ["ant-4x2", "happo-s2mia", "mlp"],
    ["halfcheetah-2x3", "happo", "mlp"],
    ["halfcheetah-2x3", "mappo", "gru"],
    ["halfcheetah-2x3", "maddpg", "mlp"],
    ["halfcheetah-2x3", "happo-s2mia", "gru critic.core=gru"],
    ["halfcheetah-2x3", "happo-sm-encoder", "mlp"],
    ["halfcheetah-2x3", "hasac", "mlp"],
    ["ant-4x2", "hasac", "mlp"],
    ["halfcheetah-2x3", "happo-s2mia-exact", "gru policy.noise_size=2"],
    ["halfcheetah-2x3", "hasac-sm", "mlp"],
    [
        "halfcheetah-2x3",
        "hasac",
        "mlp policy.noise=shared policy.noise_loading=0.7 policy.noise_decay_steps=400",
    ],
    ["halfcheetah-2x3", "hasac-s2mia-exact", "mlp policy.noise_size=2"],
    ["halfcheetah-2x3", "happo-shared-annealed", "gru"],
    // Links that touch objects, and servos, commands and pushes.
    ["carry-light-2x2", "happo-s2mia", "mlp"],
    ["quadruped-4x3", "happo-s2mia", "mlp"],
];

/// Cases that are repeated with each SIMD width: both cores, both rules with a replay, and a recurrent critic.
const REPEATED: [[&str; 3]; 5] = [CASES[0], CASES[5], CASES[8], CASES[9], CASES[11]];

/// Three iterations of 4 environments x 40 steps, of which MADDPG and HASAC learn in two. Widths are no multiples of 16 lanes,
/// so that kernels also process remainders.
const SETTINGS: &[&str] = &[
    "run.seed=7",
    "run.iterations=3",
    "environments.count=4",
    "environments.steps=40",
    "environments.per_slot=2",
    "environments.message_steps=20",
    "critic.width=37",
    "critic.layers=2",
    "update.learning_rate=5e-3",
    "evaluation.every_steps=0",
];

const GRU: &[&str] = &["policy.encoder=21", "policy.hidden=37"];
const MLP: &[&str] = &["policy.width=37", "policy.layers=2"];
const ON_POLICY: &[&str] = &["policy.sigma_floor=0.05", "update.desired_kl=0.01"];
const INFLUENCE: &[&str] = &["influence.encoder=21", "influence.hidden=21"];
const REPLAY: &[&str] =
    &["maddpg.replay=400", "maddpg.batch=33", "maddpg.n_step=3", "maddpg.warm_up=160"];
const SOFT_REPLAY: &[&str] = &[
    "hasac.replay=400",
    "hasac.batch=33",
    "hasac.n_step=3",
    "hasac.warm_up=160",
    "hasac.updates_per_step=0.1",
];

/// Settings of a core and of an algorithm.
fn own_settings(core: &str, algorithm: &str) -> Vec<&'static str> {
    let sizes = if core == "gru" { GRU } else { MLP };
    let rule = match algorithm {
        "maddpg" => REPLAY.to_vec(),
        "hasac" | "hasac-sm" | "hasac-s2mia-exact" => SOFT_REPLAY.to_vec(),
        "happo-s2mia" => [ON_POLICY, INFLUENCE].concat(),
        _ => ON_POLICY.to_vec(),
    };
    [sizes, rule.as_slice()].concat()
}

const RENEWAL: &str = "S2MIA_RENEW_GOLDEN=1 cargo test --test golden golden_file";

/// SHA-256 of `weights` and `state`, by name.
type Hashes = BTreeMap<String, String>;

/// The program with a SIMD width or its default, through cargo's runner for the architecture if there is one.
fn s2mia(width: Option<&str>) -> Command {
    let architecture = std::env::consts::ARCH.to_uppercase();
    let runner =
        std::env::var(format!("CARGO_TARGET_{architecture}_UNKNOWN_LINUX_GNU_RUNNER")).ok();
    let mut words = runner.iter().flat_map(|line| line.split_whitespace());
    let mut words = words.by_ref().chain([env!("CARGO_BIN_EXE_s2mia")]);
    let mut command = Command::new(words.next().unwrap());
    command.args(words).envs(width.map(|width| ("S2MIA_SIMD", width)));
    command
}

/// Trains a case with one actor; returns the hashes of its last checkpoint.
fn train([task, algorithm, core]: [&str; 3], width: Option<&str>) -> Hashes {
    let folder = tempfile::tempdir().unwrap();
    let (core, others) = core.split_once(' ').unwrap_or((core, ""));
    let chosen = [
        format!("task={task}"),
        format!("algorithm={algorithm}"),
        format!("policy.core={core}"),
        format!("run.dir={}", folder.path().display()),
    ];
    let mut learner = s2mia(width)
        .args(["learner", "--listen=127.0.0.1:0"])
        .args(chosen.iter().map(String::as_str).chain(SETTINGS.iter().copied()))
        .args(own_settings(core, algorithm))
        .args(others.split_whitespace())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut first = String::new();
    BufReader::new(learner.stdout.take().unwrap()).read_line(&mut first).unwrap();
    let url = first.split_whitespace().last().unwrap_or_default();
    let actor = s2mia(width).args(["actor", "--learner", url]).output().unwrap();
    if !actor.status.success() {
        // Otherwise the learner would wait for another actor. It may have already exited.
        let _killed = learner.kill();
    }
    let learner = learner.wait_with_output().unwrap();
    assert!(learner.status.success() && actor.status.success(), "{}{}", log(&learner), log(&actor));
    hashes(folder.path())
}

fn hashes(folder: &Path) -> Hashes {
    let output = s2mia(None).args(["inspect", "--json"]).arg(folder).output().unwrap();
    let printed: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(printed["env_steps"], 3 * 4 * 40);
    let hash =
        |of: &str| (of.to_owned(), printed[format!("{of}_sha256")].as_str().unwrap().to_owned());
    ["weights", "state"].map(hash).into()
}

fn log(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Names of SIMD widths, and whether this processor supports them.
fn widths() -> [(&'static str, bool); 4] {
    #[cfg(target_arch = "x86_64")]
    let (avx2, avx512) = (
        std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma"),
        std::arch::is_x86_feature_detected!("avx512f"),
    );
    #[cfg(not(target_arch = "x86_64"))]
    let (avx2, avx512) = (false, false);
    let neon = cfg!(target_arch = "aarch64");
    [("scalar", true), ("avx2", avx2), ("avx512", avx512), ("neon", neon)]
}

#[test]
fn every_case_ends_with_the_hashes_of_the_golden_file() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/golden.json");
    let found: BTreeMap<_, _> = CASES.map(|case| (case.join(" "), train(case, None))).into();
    if std::env::var_os("S2MIA_RENEW_GOLDEN").is_some() {
        std::fs::write(file, serde_json::to_string_pretty(&found).unwrap() + "\n").unwrap();
        return;
    }
    let golden = std::fs::read_to_string(file).unwrap();
    let golden: BTreeMap<String, Hashes> = serde_json::from_str(&golden).unwrap();
    let mut differences = String::new();
    for (case, hashes) in &found {
        for (of, hash) in hashes {
            let expected = golden.get(case).and_then(|hashes| hashes.get(of));
            if expected != Some(hash) {
                differences += &format!("{case}, {of}: expected {expected:?}, found {hash}\n");
            }
        }
    }
    assert!(
        differences.is_empty(),
        "{differences}tests/data/golden.json is renewed only if results change intentionally: `{RENEWAL}`"
    );
}

#[test]
fn every_simd_width_of_this_processor_gives_the_same_result() {
    for case in REPEATED {
        let chosen = train(case, None);
        for (width, _) in widths().into_iter().filter(|(_, here)| *here) {
            assert_eq!(train(case, Some(width)), chosen, "{case:?} with S2MIA_SIMD={width}");
        }
    }
}

#[test]
fn an_unsupported_and_an_unknown_simd_width_are_rejected_in_one_line() {
    let absent = widths().into_iter().filter(|(_, here)| !here).map(|(width, _)| width);
    for width in absent.chain(["abacus"]) {
        let output = s2mia(Some(width)).arg("tasks").output().unwrap();
        let line = log(&output);
        assert_eq!(output.status.code(), Some(2), "S2MIA_SIMD={width}: {line}");
        assert!(line.contains("S2MIA_SIMD") && line.contains(width), "{line}");
        assert_eq!(line.lines().count(), 1, "{line}");
    }
}
