//! The live view of a run, received by clients of Foxglove's protocol.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "system/runs.rs"]
mod runs;
#[path = "system/trained.rs"]
mod trained;
#[path = "system/viewer.rs"]
mod viewer;

use std::io::{BufRead as _, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use foxglove::Decode as _;
use foxglove::messages::{FrameTransforms, JointStates, SceneUpdate};
use policy::{PolicySnapshot, RunSeed};
use proto::trajectory_log::Step;
use proto::{ActionChoice, Digest, PolicyVersion, WeightsName};
use recording::LiveServer;
use rollout::EvaluationEpisode;
use serde_json::{Value, json};
use sim::EnvironmentBatch;

use runs::{Runs, TINY, inspect, s2mia, succeeded, train};
use viewer::Viewer;

/// A finished run of four iterations, shared by all tests.
fn trained() -> &'static Path {
    trained::folder("run.iterations=4")
}

/// A process that serves a live view.
struct LiveView {
    process: Child,
    url: String,
    lines: std::io::Lines<BufReader<std::process::ChildStdout>>,
}

impl LiveView {
    fn by(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
        command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut process = command.spawn().unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let told = lines.find_map(|line| {
            let line = line.unwrap();
            line.strip_prefix("live view: ws://").map(str::to_owned)
        });
        let told = told.unwrap();
        let (address, link) = told.split_once(", in Foxglove: ").unwrap();
        let escaped = address.replace(':', "%3A");
        assert!(link.ends_with(&format!("ds=foxglove-websocket&ds.url=ws%3A%2F%2F{escaped}")));
        Self { process, url: format!("ws://{address}"), lines }
    }

    fn watch(folder: &Path) -> Self {
        Self::by(&["watch", folder.to_str().unwrap(), "--listen=127.0.0.1:0"])
    }

    fn train(folder: &Path, more: &[&str]) -> Self {
        let dir = format!("run.dir={}", folder.display());
        let own = ["--watch=127.0.0.1:0", "--page=off", dir.as_str()];
        Self::by(&[&["train"], TINY, &own, more].concat())
    }
}

impl Drop for LiveView {
    fn drop(&mut self) {
        // A finished training has already exited.
        let _killed = self.process.kill();
        let _reaped = self.process.wait();
    }
}

/// Lines of one kind in `metrics.jsonl`.
fn metrics(folder: &Path, kind: &str) -> Vec<Value> {
    let text = std::fs::read_to_string(folder.join("metrics.jsonl")).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    lines.filter(|line| line["kind"] == kind).collect()
}

/// The environment of a run, its newest policy, and that policy's first evaluation episode.
fn evaluation(folder: &Path) -> (Box<dyn EnvironmentBatch>, PolicySnapshot, EvaluationEpisode) {
    let loaded = learner::checkpoint::load_newest(folder).unwrap().checkpoint;
    let policy = PolicySnapshot::from_bytes(&loaded.policy).unwrap();
    let (seed, iteration, index) = (RunSeed(7), loaded.iteration, 0);
    (trained::world(folder), policy, EvaluationEpisode { seed, iteration, index })
}

#[test]
fn topics_of_a_finished_run_are_those_of_a_recording_plus_curves_and_run() {
    let shown = LiveView::watch(trained());
    let mut viewer = Viewer::connect(&shown.url);
    // The topic that is advertised last.
    viewer.wait_for("/share_end");
    let named = |(topic, told): (&String, &Value)| {
        assert!(!told["schema"].as_str().unwrap().is_empty(), "{topic}");
        (topic.clone(), told["schemaName"].as_str().unwrap().to_owned())
    };
    let found = viewer.topics.iter().map(named).collect::<Vec<_>>();
    let agents = (0..6).map(|agent| (format!("/agents/{agent}"), "s2mia.log.v1.AgentStep"));
    let others = [
        ("/curves", "s2mia.Curves"),
        ("/joint_states", "foxglove.JointStates"),
        ("/run", "s2mia.Run"),
        ("/scene", "foxglove.SceneUpdate"),
        ("/share", "s2mia.log.v1.Share"),
        ("/share_end", "s2mia.log.v1.ShareEnd"),
        ("/step", "s2mia.log.v1.Step"),
        ("/tf", "foxglove.FrameTransforms"),
    ];
    let others = others.map(|(topic, schema)| (topic.to_owned(), schema));
    let expected = agents.chain(others).map(|(topic, schema)| (topic, schema.to_owned()));
    assert_eq!(found, expected.collect::<Vec<_>>());
}

#[test]
fn an_evaluation_episode_of_the_newest_policy_is_shown_in_real_time() {
    let folder = trained();
    let shown = LiveView::watch(folder);
    let mut viewer = Viewer::connect(&shown.url);
    let begun = Instant::now();
    viewer.subscribe(&["/scene", "/run", "/tf", "/joint_states", "/step"]);
    let (mut seen, mut times, mut torso) = (Vec::new(), Vec::new(), Vec::new());
    let (mut shapes, mut joints, mut run) = (0, 0, Value::Null);
    while seen.len() < 20 {
        let (topic, nanos, bytes) = viewer.next();
        match topic.as_str() {
            "/step" => {
                seen.push(<Step as prost::Message>::decode(bytes.as_slice()).unwrap());
                times.push(nanos);
            }
            "/tf" => {
                let frames = FrameTransforms::decode(bytes.as_slice()).unwrap().transforms;
                torso.push(frames[0].translation.unwrap().x);
            }
            "/scene" => shapes = SceneUpdate::decode(bytes.as_slice()).unwrap().entities.len(),
            "/joint_states" => joints = JointStates::decode(bytes.as_slice()).unwrap().joints.len(),
            _ => run = serde_json::from_slice(&bytes).unwrap(),
        }
    }
    let took = begun.elapsed();
    let (mut world, policy, episode) = evaluation(folder);
    let mut rewards = Vec::new();
    let keep = |step: &rollout::PlayedStep<'_>| rewards.push(step.outcome.reward);
    let start = (episode.key(), ActionChoice::Mean);
    rollout::play_episode(&mut *world, &policy, start, keep).unwrap();
    for step in &seen {
        assert_eq!(step.reward, rewards[step.step as usize], "{step:?}");
    }
    assert!(torso.windows(2).any(|two| two[0] != two[1]), "the robot moves: {torso:?}");
    let apart = times.windows(2).map(|two| two[1] - two[0]).collect::<Vec<_>>();
    assert!(apart.iter().all(|nanos| nanos % 50_000_000 == 0), "{apart:?}");
    // The first two may be repetitions of an earlier step.
    assert!(took.as_millis() >= 18 * 50, "18 steps of 50 ms were shown within {took:?}");
    // Seven links with eight capsules, and the floor.
    assert_eq!((shapes, joints), (9, 6));
    let of_run = ["task", "iteration", "seed"].map(|word| run[word].as_str().unwrap().to_owned());
    assert_eq!(of_run, ["halfcheetah-6x1", "4", "7"]);
}

#[test]
fn a_late_viewer_gets_the_scene_and_all_curves_at_once() {
    let folder = trained();
    let shown = LiveView::watch(folder);
    let mut first = Viewer::connect(&shown.url);
    first.subscribe(&["/scene", "/tf", "/curves"]);
    first.next_on("/scene");
    first.next_on("/curves");
    // The next episode, and with it the next scene, is a minute away.
    let mut late = Viewer::connect(&shown.url);
    let begun = Instant::now();
    late.subscribe(&["/scene", "/curves"]);
    late.next_on("/scene");
    assert!(begun.elapsed().as_secs() < 30, "the scene is that of the next episode");
    let curves = late.json_on("/curves");
    drop(late);
    let evaluations = metrics(folder, "evaluation");
    let of = |name: &str| evaluations.iter().map(|line| line[name].clone()).collect::<Value>();
    let mean = json!({ "env_steps": of("env_steps"), "value": of("mean") });
    assert_eq!(curves["evaluation"]["mean"], mean);
    let iterations = metrics(folder, "iteration");
    let sigma = iterations.iter().map(|line| line["agent0/sigma"].clone()).collect::<Value>();
    assert_eq!(curves["agent0"]["sigma"]["value"], sigma);
    // The first viewer still gets messages after the other has disconnected.
    first.next_on("/tf");
}

#[test]
fn a_running_run_shows_curves_before_its_first_checkpoint_and_then_its_robot() {
    let runs = Runs::new();
    let folder = runs.folder("begun");
    let mut shown = LiveView::train(&folder, &["run.iterations=100000", "checkpoint.every=100000"]);
    let told = shown.lines.next().unwrap().unwrap();
    assert!(told.contains("until the first checkpoint"), "{told}");
    let mut viewer = Viewer::connect(&shown.url);
    viewer.subscribe(&["/run", "/curves"]);
    assert!(viewer.json_on("/run")["waits_for"].is_string());
    // The initial pose of the robot, sent before the subscription.
    viewer.subscribe(&["/tf"]);
    viewer.next_on("/tf");
    let points = |curves: Value| curves["agent0"]["sigma"]["value"].as_array().map_or(0, Vec::len);
    let mut grow_beyond = |before: usize| loop {
        let found = points(viewer.json_on("/curves"));
        if found > before {
            break found;
        }
    };
    let begun = grow_beyond(0);
    grow_beyond(begun);
    viewer.subscribe(&["/step"]);
    succeeded(&["checkpoint", folder.to_str().unwrap()]);
    let first = viewer.next_on("/step");
    assert_eq!(<Step as prost::Message>::decode(first.as_slice()).unwrap().step, 0);
}

#[test]
fn only_curves_are_shown_for_an_external_environment() {
    let runs = Runs::new();
    let folder = runs.folder("outside");
    train(&folder, &["run.iterations=2", "observation.norm=none"]);
    let settings = folder.join("config.toml");
    let own = std::fs::read_to_string(&settings).unwrap();
    let theirs = own.replacen("\nurl = \"\"", "\nurl = \"http://127.0.0.1:1\"", 1);
    assert_ne!(own, theirs);
    std::fs::write(settings, theirs).unwrap();
    let mut shown = LiveView::watch(&folder);
    let told = shown.lines.next().unwrap().unwrap();
    assert!(told.contains("only the learning curves"), "{told}");
    let mut viewer = Viewer::connect(&shown.url);
    viewer.subscribe(&["/curves"]);
    assert!(viewer.json_on("/curves")["evaluation"]["mean"].is_object());
    assert_eq!(viewer.topics.keys().collect::<Vec<_>>(), ["/curves"]);
}

/// Hashes of the weights after each iteration.
fn weights(folder: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(folder.join("provenance.jsonl")).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    lines.map(|line| line["weights_sha256"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn a_viewer_that_never_reads_does_not_affect_the_weights() {
    let runs = Runs::new();
    let (alone, watched) = (runs.folder("alone"), runs.folder("watched"));
    let mut shown = LiveView::train(&watched, &["run.iterations=150"]);
    let mut viewer = Viewer::connect(&shown.url);
    viewer.wait_for("/share_end");
    let topics = viewer.topics.keys().cloned().collect::<Vec<_>>();
    viewer.subscribe(&topics.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(shown.process.wait().unwrap().success());
    train(&alone, &["run.iterations=150"]);
    assert_eq!((weights(&watched), inspect(&watched)), (weights(&alone), inspect(&alone)));
    assert_eq!(weights(&alone).len(), 150);
}

#[test]
fn an_immediate_subscription_to_a_new_topic_gets_its_messages() {
    let server = LiveServer::open("127.0.0.1:0".parse().unwrap(), "quick").unwrap();
    let mut viewer = Viewer::connect(&server.url());
    let topics: Vec<String> = (0..300).map(|number| format!("/number/{number}")).collect();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for topic in &topics {
                viewer.subscribe(&[topic]);
                assert_eq!(viewer.json_on(topic)["topic"], **topic);
            }
        });
        for topic in &topics {
            let shown = server.topic(topic, &json!({ "title": "Topic", "type": "object" }));
            shown.unwrap().show(&json!({ "topic": topic }));
        }
    });
}

#[test]
fn a_slow_viewer_blocks_nothing_and_misses_old_messages() {
    let server = LiveServer::open("127.0.0.1:0".parse().unwrap(), "slow").unwrap();
    let topic = server.topic("/numbers", &json!({ "title": "Number", "type": "object" })).unwrap();
    let mut viewer = Viewer::connect(&server.url());
    topic.show(&json!({ "number": 0 }));
    viewer.subscribe(&["/numbers"]);
    assert_eq!(viewer.json_on("/numbers")["number"], 0);
    // More data than socket buffers and the queue can hold.
    let filler = "x".repeat(1 << 20);
    (1..=700).for_each(|number| topic.show(&json!({ "number": number, "filler": filler })));
    let mut seen = vec![0];
    while seen.last() != Some(&700) {
        seen.push(viewer.json_on("/numbers")["number"].as_u64().unwrap());
    }
    assert!(seen.is_sorted() && seen.len() < 600, "{seen:?}");
}

#[test]
fn an_episode_without_viewers_is_aborted_after_its_first_step() {
    let (mut world, policy, episode) = evaluation(trained());
    let weights = WeightsName { version: PolicyVersion(4), digest: Digest([0; 32]) };
    let server = LiveServer::open("127.0.0.1:0".parse().unwrap(), "alone").unwrap();
    let mut scene = server.scene(&*world).unwrap();
    assert!(!scene.is_watched());
    let played = scene.play(&mut *world, (&policy, weights), episode, || ()).unwrap();
    assert_eq!(played.steps, 1);
}

fn refusal(arguments: &[&str]) -> (Option<i32>, String) {
    let output = s2mia(arguments);
    let line = String::from_utf8(output.stderr).unwrap();
    assert!(output.stdout.is_empty() && line.lines().count() == 1, "{line}");
    (output.status.code(), line)
}

#[test]
fn a_port_in_use_is_reported_before_the_run_begins() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let (listen, watch) = (format!("--listen={address}"), format!("--watch={address}"));
    let (code, line) = refusal(&["watch", trained().to_str().unwrap(), &listen]);
    assert!(code == Some(2) && line.contains(&format!("--listen {address}: ")), "{line}");
    let runs = Runs::new();
    let folder = runs.folder("never");
    let dir = format!("run.dir={}", folder.display());
    let (code, line) = refusal(&[&["train"], TINY, &[dir.as_str(), &watch]].concat());
    assert!(code == Some(2) && line.contains(&format!("--watch {address}: ")), "{line}");
    assert!(!folder.exists());
}

#[test]
fn a_folder_without_a_run_or_a_checkpoint_is_rejected() {
    let runs = Runs::new();
    let empty = runs.folder("empty");
    std::fs::create_dir(&empty).unwrap();
    let (code, line) = refusal(&["watch", empty.to_str().unwrap(), "--listen=127.0.0.1:0"]);
    assert!(code == Some(2) && line.contains("it has no config.toml"), "{line}");
    std::fs::copy(trained().join("config.toml"), empty.join("config.toml")).unwrap();
    let (code, line) = refusal(&["watch", empty.to_str().unwrap(), "--listen=127.0.0.1:0"]);
    assert!(code == Some(1) && line.contains("has no checkpoint yet"), "{line}");
}

#[test]
fn remote_viewers_require_an_option() {
    let of = trained().to_str().unwrap();
    for (arguments, permission) in [
        (&["watch", of, "--listen=0.0.0.0:0"][..], "--insecure-allow-remote "),
        (&["train", "--watch=0.0.0.0:0"], "--insecure-allow-remote-watch "),
    ] {
        let (code, line) = refusal(arguments);
        assert!(code == Some(2) && line.contains(permission), "{line}");
    }
}
