//! A run in an external environment equals the run in the same built-in environment, in spite of failures, and invalid
//! messages of the program are rejected by field.

use std::path::Path;
use std::process::{Child, Command, Stdio};

use actor::EnvironmentService;
use proto::wire;
use proto::wire::play_response::Answer;
use sim::{EnvironmentBatch as _, ObservationNorm};

use crate::commands::{Background, refused, signal};
use crate::cue_service::{CueService, Faults};
use crate::processes::children;
use crate::runs::{Runs, TINY, inspect, s2mia, succeeded, train};
use crate::waiting::{eventually, has_begun};

/// Slots shorter than an episode of 50 steps.
const CUE: &[&str] = &["task=cue-2x1", "run.iterations=6"];

fn settings<'a>(folder: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["train"], TINY, CUE, &[folder], more].concat()
}

fn dir(folder: &Path) -> String {
    format!("run.dir={}", folder.display())
}

fn trained(folder: &Path, more: &[&str]) {
    train(folder, &[CUE, more].concat());
}

fn weights(folder: &Path) -> serde_json::Value {
    inspect(folder)["weights_sha256"].clone()
}

fn manifest(folder: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(folder.join("manifest.json")).unwrap()).unwrap()
}

#[test]
fn a_game_in_an_external_program_gives_the_weights_of_the_built_in_game() {
    let runs = Runs::new();
    let own = runs.folder("own");
    trained(&own, &["run.actors=1"]);
    assert_eq!(manifest(&own)["environment_states"], "encoded");
    for (faults, states) in [(Faults::NONE, "saved"), (Faults::STATELESS, "replayed")] {
        let service = CueService::start(faults);
        for actors in ["run.actors=1", "run.actors=2"] {
            let folder = runs.folder(&format!("{states}-{actors}"));
            trained(&folder, &[actors, "--environment", &service.url]);
            assert_eq!(weights(&folder), weights(&own), "states {states}, {actors}");
            assert_eq!(manifest(&folder)["environment_states"], states);
        }
    }
}

#[test]
fn with_feature_z_actors_standardise_what_an_external_program_shows() {
    let runs = Runs::new();
    let service = CueService::start(Faults::NONE);
    let weights_of = |norm: &str, actors: &str| {
        let folder = runs.folder(&format!("{norm}-{actors}"));
        trained(&folder, &[norm, actors, "--environment", &service.url]);
        weights(&folder)
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
    let mut observation = vec![0.0; environments.description().agents[0].observation.len()];
    environments.observation(0, 0, &mut observation);
    observation
}

fn start(folder: &Path, more: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
    command.args(settings(&dir(folder), more)).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().unwrap()
}

/// Process ids of the actors of a running run.
fn actors(run: &Child, folder: &Path) -> Vec<u32> {
    has_begun(folder);
    eventually(|| match children(run.id()) {
        found if found.len() >= 2 => Ok(found),
        found => Err(format!("{} of 2 actors have started", found.len())),
    })
}

#[test]
fn killed_actors_and_failures_of_the_program_do_not_affect_the_weights() {
    let runs = Runs::new();
    let [own, killed, died, broken] =
        ["own", "killed", "died", "broken"].map(|name| runs.folder(name));
    let longer = ["run.iterations=30", "run.actors=2", "--environment"];
    trained(&own, &longer[..2]);
    let service = CueService::start(Faults::NONE);
    let in_service = [&longer[..], &[service.url.as_str()]].concat();

    let mut run = start(&killed, &in_service);
    signal(actors(&run, &killed)[0], "-KILL");
    assert!(run.wait().unwrap().success());
    assert_eq!(weights(&killed), weights(&own));

    let mut run = start(&died, &in_service);
    actors(&run, &died);
    let address = service.url.trim_start_matches("http://").to_owned();
    drop(service);
    let _again = CueService::start_at(&address, Faults::NONE);
    assert!(run.wait().unwrap().success());
    assert_eq!(weights(&died), weights(&own));

    let service = CueService::start(Faults { abort_every: 150, ..Faults::NONE });
    trained(&broken, &[&longer[..], &[service.url.as_str()]].concat());
    assert_eq!(weights(&broken), weights(&own));
}

#[test]
fn a_run_continues_if_its_program_rejects_the_states_that_it_saved() {
    let (runs, service) =
        (Runs::new(), CueService::start(Faults { rejects: |_| true, ..Faults::NONE }));
    let hashes = ["run.actors=1", "run.actors=2"].map(|actors| {
        let folder = runs.folder(actors);
        let output = s2mia(&settings(&dir(&folder), &[actors, "--environment", &service.url]));
        let told = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{told}");
        let causes = [
            "returned its lease, at slot 0",
            "ValueError: no state of this game",
            "the start states are from actor",
            "no actor can continue its episodes",
        ];
        for cause in causes {
            assert!(told.contains(cause), "no {cause:?} in {told}");
        }
        weights(&folder)
    });
    assert_eq!(hashes[0], hashes[1], "new episodes have the same keys for any actors");
}

#[test]
fn an_environment_that_always_dies_ends_the_run_with_its_cause_and_a_checkpoint() {
    let (runs, service) =
        (Runs::new(), CueService::start(Faults { abort_every: 1, ..Faults::NONE }));
    let folder = runs.folder("always");
    let output = s2mia(&settings(&dir(&folder), &["--environment", &service.url]));
    let told = String::from_utf8(output.stderr).unwrap();
    let line = told.lines().last().unwrap();
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(line.contains(" times and no actor could finish it"), "{line}");
    assert!(line.contains("Unavailable: temporarily unavailable"), "{line}");
    assert_eq!(inspect(&folder)["iteration"], 0);
}

/// The one-line error of training with `faults`.
fn refusal(faults: Faults) -> String {
    let (runs, service) = (Runs::new(), CueService::start(faults));
    let folder = runs.folder("refused");
    let output = s2mia(&settings(
        &dir(&folder),
        &["run.actors=1", "lease.ttl_secs=1", "--environment", &service.url],
    ));
    assert_eq!(output.status.code(), Some(1));
    String::from_utf8(output.stderr).unwrap().lines().last().unwrap().to_owned()
}

#[test]
fn an_invalid_description_is_rejected_by_field_before_the_run_starts() {
    type Lie = fn(&mut wire::EnvironmentSpec);
    let lies: [(Lie, &str); 7] = [
        (|spec| spec.feature_z = true, "environment.feature_z: must be unset"),
        (|spec| spec.agents.clear(), "environment.agents: must be at least 1"),
        (|spec| spec.task = "two\nlines".into(), "environment.task"),
        (|spec| spec.agents[1].observation.clear(), "environment.agents[1].observation"),
        (|spec| spec.agents[0].seen = vec![4], "environment.agents[0].seen"),
        (|spec| spec.agents[0].action.as_mut().unwrap().low = f32::NAN, "agents[0].action.high"),
        (|spec| spec.dt_secs = 0.0, "environment.dt_secs"),
    ];
    for (description, field) in lies {
        let line = refusal(Faults { description, ..Faults::NONE });
        assert!(line.contains("sent an invalid answer") && line.contains(field), "{line}");
    }
}

#[test]
fn an_invalid_answer_ends_the_actors_with_its_field() {
    type Lie = fn(&mut Answer);
    let lies: [(Lie, &str); 3] = [
        (
            |answer| {
                if let Answer::View(view) = answer {
                    view.observations.pop();
                }
            },
            "view.observations: 1 entries, expected 2 (after a reset)",
        ),
        (
            |answer| {
                if let Answer::Steps(steps) = answer {
                    steps.reward.as_mut().unwrap().data = f32::NAN.to_le_bytes().repeat(2).into();
                }
            },
            "NOT_FINITE: steps.reward: element 0 is NaN (step",
        ),
        (
            |answer| {
                if let Answer::Saved(saved) = answer {
                    saved.state = vec![0; 10_000].into();
                }
            },
            "saved.state: 10000 bytes",
        ),
    ];
    for (answer, field) in lies {
        let line = refusal(Faults { answer, ..Faults::NONE });
        assert!(line.contains("sent an invalid answer") && line.contains(field), "{line}");
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
    let path = folder.to_str().unwrap();
    let resume = ["train", "--resume", path, "run.iterations=4", "--environment"];
    let other = CueService::start(OTHER);
    for url in [other.url.as_str(), ""] {
        let line = refused(&[&resume[..], &[url]].concat());
        assert!(line.contains("the run's environment is one with the description"), "{line}");
    }
    let moved = CueService::start(Faults::NONE);
    succeeded(&[&resume[..], &[&moved.url]].concat());
    let told = succeeded(&["eval", path, "--episodes", "1", "--json"]);
    assert!(told.contains("\"task\":\"cue-2x1\"") && told.contains("\"steps\":50"), "{told}");
    assert!(succeeded(&["record", path]).contains("50 steps"));
    let told = |command: &str| String::from_utf8(s2mia(&[command, path]).stderr).unwrap();
    let line = told("film");
    assert!(line.contains("its description has no shapes") && line.lines().count() == 1, "{line}");
    let recording = folder.join("logs/iter_00000004.mcap");
    let output = s2mia(&["log", "--replay", recording.to_str().unwrap()]);
    let line = String::from_utf8(output.stderr).unwrap();
    assert!(line.contains("its environment is another program's") && line.lines().count() == 1);
    let address = moved.url.trim_start_matches("http://").to_owned();
    drop(moved);
    let line = told("eval");
    assert!(line.contains("does not answer"), "{line}");
    let _other = CueService::start_at(&address, OTHER);
    let line = told("eval");
    assert!(line.contains("the run's environment is one with the description"), "{line}");
}

#[test]
fn an_actor_without_the_environment_url_names_the_missing_option() {
    let runs = Runs::new();
    let service = CueService::start(Faults::NONE);
    let folder = dir(&runs.folder("untold"));
    let arguments = ["learner", "--listen=127.0.0.1:0", "--environment", &service.url, &folder];
    let mut learner = Background::start(&[&arguments, CUE].concat());
    let output = s2mia(&["actor", "--learner", &learner.url()]);
    let log = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{log}");
    assert!(log.contains("pass --environment with its URL"), "{log}");
}
