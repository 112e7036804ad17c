//! A run in an external environment equals the run in the same built-in environment, in spite of failures, and invalid
//! messages of the program are rejected by field.

use std::path::Path;
use std::process::Command;

use actor::EnvironmentService;
use proto::wire::play_response::Answer;
use serde_json::Value;
use sim::{EnvironmentBatch as _, ObservationNorm};

use crate::cue_service::{CueService, Faults, look};
use crate::processes::{Background, Learner, children, has_begun, signal};
use crate::runs::{
    Runs, error, inspect, json, refused, s2mia, succeeded, success, text, tiny, weights,
};

/// Slots shorter than an episode of 50 steps.
const CUE: [&str; 2] = ["task=cue-2x1", "run.iterations=6"];

/// `s2mia train` of the game.
fn cue(folder: &Path, more: &[&str]) -> Command {
    tiny("train", folder, &[&CUE, more].concat())
}

/// The weights of the game trained in `folder`.
fn trained(folder: &Path, more: &[&str]) -> Value {
    success(&mut cue(folder, more));
    weights(folder)
}

#[test]
fn a_game_in_an_external_program_gives_the_weights_of_the_built_in_game() {
    let runs = Runs::new();
    let own = runs.folder("own");
    let expected = trained(&own, &["run.actors=1"]);
    let states = |folder: &Path| json(&folder.join("manifest.json"))["environment_states"].clone();
    assert_eq!(states(&own), "encoded");
    for (faults, kind) in [(Faults::NONE, "saved"), (Faults::STATELESS, "replayed")] {
        let service = CueService::start(faults);
        for actors in ["run.actors=1", "run.actors=2"] {
            let folder = runs.folder(&format!("{kind}-{actors}"));
            let found = trained(&folder, &[actors, "--environment", &service.url]);
            assert_eq!(found, expected, "states {kind}, {actors}");
            assert_eq!(states(&folder), kind);
        }
    }
}

#[test]
fn with_feature_z_actors_standardise_what_an_external_program_shows() {
    let runs = Runs::new();
    let service = CueService::start(Faults::NONE);
    let weights_of = |norm: &str, actors: &str| {
        let folder = runs.folder(&format!("{norm}-{actors}"));
        trained(&folder, &[norm, actors, "--environment", &service.url])
    };
    let scaled = weights_of("observation.norm=feature_z", "run.actors=1");
    assert_eq!(weights_of("observation.norm=feature_z", "run.actors=2"), scaled);
    assert_ne!(weights_of("observation.norm=none", "run.actors=1"), scaled);
    let shown = |norm| first_observation(&service.url, norm);
    let (plain, scaled) = (shown(ObservationNorm::None), shown(ObservationNorm::FeatureZ));
    // Place, cue and index are one-hot: three of the nine features are 1. Mean 1/3, variance 1/3 - 1/9.
    assert_eq!((plain.len(), plain.iter().sum::<f32>()), (9, 3.0));
    for (plain, scaled) in plain.into_iter().zip(scaled) {
        let expected = (plain - 1.0 / 3.0) / (2.0f32 / 9.0).sqrt();
        assert!((scaled - expected).abs() < 1e-6, "{plain}: {scaled}");
    }
}

/// What the first agent of an external program observes first.
fn first_observation(url: &str, norm: ObservationNorm) -> Vec<f32> {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let service = runtime.block_on(EnvironmentService::connect(url)).unwrap().scaled(norm);
    let _entered = runtime.enter();
    let mut environments = service.environments(1);
    environments.reset(0, 0, 50, [0; 32]).unwrap();
    look(&environments).observations.remove(0)
}

#[test]
fn killed_actors_and_failures_of_the_program_do_not_affect_the_weights() {
    let runs = Runs::new();
    let longer = ["run.iterations=30", "run.actors=2", "--environment"];
    let expected = trained(&runs.folder("own"), &longer[..2]);
    let service = CueService::start(Faults::NONE);
    let in_service = [&longer[..], &[service.url.as_str()]].concat();
    // A run in the service, and its actors.
    let begun = |folder: &Path| {
        let run = Background::start(&mut cue(folder, &in_service));
        has_begun(folder);
        let actors = children(run.process.id(), 2);
        (run, actors)
    };

    let killed = runs.folder("killed");
    let (mut run, actors) = begun(&killed);
    signal(actors[0], "-KILL");
    run.rest();
    assert_eq!(weights(&killed), expected);

    let died = runs.folder("died");
    let (mut run, _) = begun(&died);
    let address = service.url.trim_start_matches("http://").to_owned();
    drop(service);
    let _again = CueService::start_at(&address, Faults::NONE);
    run.rest();
    assert_eq!(weights(&died), expected);

    let service = CueService::start(Faults { abort_every: 150, ..Faults::NONE });
    let broken = trained(&runs.folder("broken"), &[&longer[..], &[service.url.as_str()]].concat());
    assert_eq!(broken, expected);
}

#[test]
fn a_run_continues_if_its_program_rejects_the_states_that_it_saved() {
    let runs = Runs::new();
    let service = CueService::start(Faults { rejects: |_| true, ..Faults::NONE });
    let hashes = ["run.actors=1", "run.actors=2"].map(|actors| {
        let folder = runs.folder(actors);
        let (_, log) = success(&mut cue(&folder, &[actors, "--environment", &service.url]));
        for cause in [
            "returned its lease, at slot 0",
            "ValueError: no state of this game",
            "the start states are from actor",
            "no actor can continue its episodes",
        ] {
            assert!(log.contains(cause), "no {cause:?} in {log}");
        }
        weights(&folder)
    });
    assert_eq!(hashes[0], hashes[1], "new episodes have the same keys for any actors");
    let folder = runs.folder("run.actors=1");
    let provenance = std::fs::read_to_string(folder.join("provenance.jsonl")).unwrap();
    assert!(provenance.contains(r#""begun_again":["#), "{provenance}");
    let address = service.url.trim_start_matches("http://").to_owned();
    drop(service);
    let _healthy = CueService::start_at(&address, Faults::NONE);
    let line = error(&s2mia(&["verify", text(&folder)]));
    let why = "began new episodes because theirs could not be continued (provenance.jsonl)";
    assert!(line.contains("is not verified: ") && line.contains(why), "{line}");
}

/// The last line with which training in `folder` fails with `faults`.
fn refusal(folder: &Path, faults: Faults, more: &[&str]) -> String {
    let service = CueService::start(faults);
    let mut run = cue(folder, more);
    let output = run.args(["--environment", &service.url]).output().unwrap();
    let log = error(&output);
    assert_eq!(output.status.code(), Some(1), "{log}");
    log.lines().last().unwrap().to_owned()
}

#[test]
fn an_environment_that_always_dies_ends_the_run_with_its_cause_and_a_checkpoint() {
    let runs = Runs::new();
    let folder = runs.folder("always");
    let line = refusal(&folder, Faults { abort_every: 1, ..Faults::NONE }, &[]);
    assert!(line.contains(" times and no actor could finish it"), "{line}");
    assert!(line.contains("Unavailable: temporarily unavailable"), "{line}");
    assert_eq!(inspect(&folder)["iteration"], 0);
}

/// The tests of `proto` have a description and an answer for each field.
#[test]
fn an_invalid_description_and_an_invalid_answer_are_rejected_by_field() {
    for (faults, field) in [
        (Faults { description: |spec| spec.dt_secs = 0.0, ..Faults::NONE }, "environment.dt_secs"),
        (
            Faults { answer: lie, ..Faults::NONE },
            "NOT_FINITE: steps.reward: element 0 is NaN (step",
        ),
        (
            Faults { answer: one_observation, ..Faults::NONE },
            "view.observations: 1 entries, expected 2 (after a reset)",
        ),
    ] {
        let runs = Runs::new();
        let folder = runs.folder("refused");
        let line = refusal(&folder, faults, &["run.actors=1", "lease.ttl_secs=1"]);
        assert!(line.contains("sent an invalid answer") && line.contains(field), "{line}");
    }
}

fn lie(answer: &mut Answer) {
    if let Answer::Steps(steps) = answer {
        steps.reward.as_mut().unwrap().data = f32::NAN.to_le_bytes().repeat(2).into();
    }
}

fn one_observation(answer: &mut Answer) {
    if let Answer::View(view) = answer {
        view.observations.pop();
    }
}

/// The description of another environment.
const OTHER: Faults = Faults { description: |spec| spec.dt_secs = 0.2, ..Faults::NONE };

#[test]
fn a_run_can_be_resumed_only_in_its_environment() {
    let runs = Runs::new();
    let folder = runs.folder("resumed");
    let service = CueService::start(Faults::NONE);
    trained(&folder, &["run.iterations=2", "--environment", &service.url]);
    let path = text(&folder);
    let resume = ["train", "--resume", path, "run.iterations=4"];
    let other = CueService::start(OTHER);
    let new = format!("run.dir={}", text(&runs.folder("new")));
    let begin = ["train", &new, "environment_service.description=ab"];
    for (command, url) in [(&resume[..], other.url.as_str()), (&resume, ""), (&begin, &service.url)]
    {
        let setting = format!("environment_service.url={url}");
        let line = refused(&[command, &[&setting]].concat());
        assert!(line.contains("the run's environment is one with the description"), "{line}");
        assert!(line.contains("; start the program with that of the run"), "{line}");
    }
    let line = refused(&["train", "--environment", ""]);
    assert!(line.contains("--environment"), "{line}");
    let moved = CueService::start(Faults::NONE);
    succeeded(&[&resume[..], &["--environment", &moved.url]].concat());
    let evaluated = succeeded(&["eval", path, "--episodes", "1", "--json"]);
    let holds = |part: &str| evaluated.contains(part);
    assert!(holds("\"task\":\"cue-2x1\"") && holds("\"steps\":50"), "{evaluated}");
    assert!(succeeded(&["record", path]).contains("50 steps"));
    let elsewhere = CueService::start(Faults::NONE);
    let there = ["--environment", elsewhere.url.as_str()];
    let stderr_of = |command: &str| error(&s2mia(&[command, path]));
    let line = stderr_of("film");
    assert!(line.contains("its description has no shapes") && line.lines().count() == 1, "{line}");
    let recording = folder.join("logs/iter_00000004.mcap");
    let line = error(&s2mia(&["log", "--replay", text(&recording)]));
    assert!(line.contains("its environment is another program's") && line.lines().count() == 1);
    let address = moved.url.trim_start_matches("http://").to_owned();
    drop(moved);
    let line = stderr_of("eval");
    assert!(line.contains("does not answer"), "{line}");
    let again = succeeded(&[&["eval", path, "--episodes", "1", "--json"], &there[..]].concat());
    assert_eq!(again, evaluated);
    assert!(succeeded(&[&["verify", path][..], &there].concat()).contains("is verified"));
    let _other = CueService::start_at(&address, OTHER);
    let line = stderr_of("eval");
    assert!(line.contains("the run's environment is one with the description"), "{line}");
}

#[test]
fn an_actor_without_the_environment_url_names_the_missing_option() {
    let runs = Runs::new();
    let service = CueService::start(Faults::NONE);
    let in_service = [&CUE[..], &["--environment", &service.url]].concat();
    let learner = Learner::start(&runs.folder("untold"), &in_service);
    let output = s2mia(&["actor", "--learner", &learner.url]);
    let log = error(&output);
    assert_eq!(output.status.code(), Some(1), "{log}");
    assert!(log.contains("pass --environment with its URL"), "{log}");
}
