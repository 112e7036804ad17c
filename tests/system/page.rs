//! The learner's HTTP page, requested like a browser and like Prometheus.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::commands::Background;
use crate::runs::{Runs, TINY, inspect, succeeded, train};
use crate::waiting::eventually;

/// A learner with its page, and its actors.
struct Learner {
    _process: Background,
    actor: Option<Background>,
    url: String,
    page: String,
}

impl Learner {
    fn start(folder: &Path, page: &str) -> Self {
        let dir = format!("run.dir={}", folder.display());
        let own = ["run.iterations=100000", "--page", page, "--listen", "127.0.0.1:0", &dir];
        let mut process = Background::start(&[&["learner"], TINY, &own].concat());
        let url = process.url();
        let page = process.url().trim_start_matches("http://").to_owned();
        Self { _process: process, actor: None, url, page }
    }

    fn add_actor(&mut self, more: &[&str]) {
        let own = ["actor", "--learner", self.url.as_str()];
        self.actor = Some(Background::start(&[&own, more].concat()));
    }

    fn ask(&self, request: &str) -> (u16, String, String) {
        ask(&self.page, request)
    }

    fn get(&self, path: &str) -> String {
        get(&self.page, path)
    }

    fn json(&self, path: &str) -> Value {
        serde_json::from_str(&self.get(path)).unwrap()
    }
}

/// Status code, headers and body.
fn ask(page: &str, request: &str) -> (u16, String, String) {
    let mut stream = TcpStream::connect(page).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    let code = head.split(' ').nth(1).unwrap().parse().unwrap();
    (code, head.to_owned(), body.to_owned())
}

fn get(page: &str, path: &str) -> String {
    let (code, _, body) = ask(page, &format!("GET {path} HTTP/1.1\r\nHost: {page}\r\n\r\n"));
    assert_eq!(code, 200, "{path}: {body}");
    body
}

/// `s2mia page`, and its address.
struct PageOfRuns {
    _process: Background,
    page: String,
}

impl PageOfRuns {
    fn start(folder: &Path, runs: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
        command.arg("page").args(runs).current_dir(folder);
        let mut process = Background::of(&mut command);
        let page = process.line().strip_prefix("page: http://").unwrap().to_owned();
        Self { _process: process, page }
    }

    fn json(&self, path: &str) -> Value {
        serde_json::from_str(&get(&self.page, path)).unwrap()
    }
}

/// A run folder with one evaluation.
fn write_run(folder: &Path, mean: f64) {
    std::fs::create_dir_all(folder).unwrap();
    for file in ["config.toml", "manifest.json"] {
        std::fs::write(folder.join(file), "{}").unwrap();
    }
    add_evaluation(folder, 40, mean);
}

fn add_evaluation(folder: &Path, env_steps: u64, mean: f64) {
    let path = folder.join("metrics.jsonl");
    let mut file = std::fs::File::options().create(true).append(true).open(path).unwrap();
    let line = format!(r#"{{"kind":"evaluation","env_steps":{env_steps},"mean":{mean}}}"#);
    writeln!(file, "{line}").unwrap();
}

/// The value of a sample, such as `s2mia_slots{state="free"}`.
fn sample(scrape: &str, name: &str) -> f64 {
    let line = scrape.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    line.unwrap_or_else(|| panic!("no {name} in\n{scrape}")).parse().unwrap()
}

/// The last iteration in the run's metrics.
fn last_iteration(folder: &Path) -> Value {
    let text = std::fs::read_to_string(folder.join("metrics.jsonl")).unwrap_or_default();
    let mut lines = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    lines.rfind(|line| line["kind"] == "iteration").unwrap_or_default()
}

#[test]
fn the_figures_of_prometheus_and_of_the_page_equal_the_metrics_and_the_status() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let mut learner = Learner::start(&folder, "127.0.0.1:0");
    learner.add_actor(&[]);
    eventually(|| {
        let iteration = last_iteration(&folder)["iteration"].as_u64().unwrap_or_default();
        if iteration >= 3 { Ok(()) } else { Err(format!("{iteration} iterations of 3")) }
    });
    // Without an actor, the figures do not change between requests.
    learner.actor = None;
    let still = |learner: &Learner| {
        let status = learner.json("/api/status");
        let waits = status["stage"] == "collect" && status["status"]["actors"] == 0;
        if waits { Ok(status) } else { Err(status.to_string()) }
    };
    let shown = eventually(|| still(&learner));
    let (line, scrape) = (last_iteration(&folder), learner.get("/metrics"));
    let told = succeeded(&["status", &learner.url, "--json"]);
    assert_eq!(shown["status"], serde_json::from_str::<Value>(&told).unwrap());
    for (name, of_status) in [
        ("s2mia_iteration", "iteration"),
        ("s2mia_env_steps_total", "env_steps"),
        ("s2mia_leases_reissued_total", "leases_reissued"),
        ("s2mia_slots{state=\"complete\"}", "complete_slots"),
    ] {
        assert_eq!(sample(&scrape, name), shown["status"][of_status].as_f64().unwrap(), "{name}");
    }
    for (name, of_metrics) in [
        ("s2mia_iteration", "iteration"),
        ("s2mia_phase_seconds{phase=\"collect\"}", "rollout_secs"),
        ("s2mia_phase_seconds{phase=\"refit\"}", "density_secs"),
    ] {
        assert_eq!(sample(&scrape, name), line[of_metrics].as_f64().unwrap(), "{name}");
    }
    let slots =
        ["free", "leased", "complete"].map(|state| format!("s2mia_slots{{state=\"{state}\"}}"));
    assert_eq!(slots.iter().map(|name| sample(&scrape, name)).sum::<f64>(), 2.0);
    assert_eq!(sample(&scrape, "s2mia_iterations_planned"), 100_000.0);
    assert!(sample(&scrape, "process_resident_memory_bytes") > 1e6);
    assert_eq!(sample(&scrape, "s2mia_sample_reuse_ratio"), 2.0, "two epochs");
    assert_eq!(sample(&scrape, "s2mia_log_dropped_total"), 0.0);
    // Two slots of two chunks in each iteration.
    let chunks = sample(&scrape, "s2mia_chunks_total{result=\"accepted\"}");
    assert!(chunks >= 4.0 * line["iteration"].as_f64().unwrap(), "{chunks} chunks");
    // Two environments, ten steps, a state of more than ten numbers of four bytes.
    assert!(sample(&scrape, "s2mia_ingest_bytes_total") > 800.0 * chunks);
    // Every second iteration has an evaluation with a film.
    let film = learner.json("/api/film");
    assert_eq!(film["iteration"], shown["film"]);
    let numbers = film["ends"].as_array().unwrap().len();
    assert_eq!(numbers, 400 * film["radii"].as_array().unwrap().len() * 6);
    let curves = learner.json("/api/curves");
    assert_eq!(curves["lines"], shown["lines"]);
    let curve = &curves["curves"]["rollout_secs"];
    assert_eq!(curve[0].as_array().unwrap().len() as u64, line["iteration"].as_u64().unwrap());
}

#[test]
fn steps_lost_by_an_actors_log_are_reported_by_the_learner() {
    let runs = Runs::new();
    let mut learner = Learner::start(&runs.folder("run"), "127.0.0.1:0");
    // An existing folder in which not even root can create a file.
    learner.add_actor(&["--log-dir", "/proc", "--log-episodes", "all"]);
    eventually(|| {
        let lost = sample(&learner.get("/metrics"), "s2mia_log_dropped_total");
        // A slot has two environments of twenty steps.
        if lost >= 80.0 { Ok(()) } else { Err(format!("{lost} steps lost, of 80")) }
    });
}

#[test]
fn other_hosts_and_methods_are_rejected_and_the_page_may_not_load_external_content() {
    let runs = Runs::new();
    let learner = Learner::start(&runs.folder("run"), "127.0.0.1:0");
    let code = |request: &str| learner.ask(request).0;
    assert_eq!(code("GET / HTTP/1.1\r\nHost: example.org\r\n\r\n"), 403);
    assert_eq!(code("GET /api/status HTTP/1.0\r\n\r\n"), 403);
    assert_eq!(code("POST /api/status HTTP/1.1\r\nHost: localhost\r\n\r\n"), 405);
    assert_eq!(code("GET /runs HTTP/1.1\r\nHost: localhost\r\n\r\n"), 404);
    let (code, head, page) = learner.ask("GET / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert_eq!(code, 200);
    assert!(head.contains("default-src 'none'; script-src 'sha256-"), "{head}");
    assert!(!head.to_lowercase().contains("access-control-allow"), "{head}");
    assert!(page.starts_with("<!doctype html>"));
    let (code, _, body) = learner.ask("HEAD / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert_eq!((code, body.as_str()), (200, ""));
}

#[test]
fn idle_connections_and_continuous_requests_do_not_block_the_run_or_affect_its_weights() {
    let runs = Runs::new();
    let (plain, watched) = (runs.folder("plain"), runs.folder("watched"));
    train(&plain, &["run.iterations=3", "--page", "off"]);
    let mut learner = Learner::start(&watched, "127.0.0.1:0");
    let silent: Vec<_> = (0..40).map(|_| TcpStream::connect(&learner.page).unwrap()).collect();
    learner.add_actor(&[]);
    eventually(|| {
        let paths = ["/", "/api/run", "/api/status", "/api/curves", "/api/film", "/metrics"];
        paths.iter().for_each(|path| drop(learner.get(path)));
        // An iteration's provenance is written after its metrics.
        let iteration = last_iteration(&watched)["iteration"].as_u64().unwrap_or_default();
        if iteration > 3 { Ok(()) } else { Err(format!("{iteration} iterations of 4")) }
    });
    drop((learner, silent));
    let provenance = std::fs::read_to_string(watched.join("provenance.jsonl")).unwrap();
    let third: Value = serde_json::from_str(provenance.lines().nth(2).unwrap()).unwrap();
    assert_eq!(third["weights_sha256"], inspect(&plain)["weights_sha256"]);
}

#[test]
fn the_page_of_several_runs_has_all_their_curves_and_follows_those_that_grow() {
    let runs = Runs::new();
    let folder = runs.folder("place");
    write_run(&folder.join("runs/first"), 1.5);
    write_run(&folder.join("runs/second"), -2.0);
    std::fs::create_dir(folder.join("runs/notes")).unwrap();
    let page = PageOfRuns::start(&folder, &[]);
    let found = page.json("/api/curves");
    let evaluation =
        |run: usize, found: &Value| found["runs"][run]["curves"]["evaluation/mean"].clone();
    assert_eq!(evaluation(0, &found), serde_json::json!([[40], [1.5]]));
    assert_eq!(evaluation(1, &found), serde_json::json!([[40], [-2.0]]));
    let before = page.json("/api/runs");
    assert_eq!(before["runs"], serde_json::json!(["first", "second"]));
    assert_eq!(before["version"], found["version"]);
    add_evaluation(&folder.join("runs/second"), 80, 3.0);
    eventually(|| {
        let now = page.json("/api/runs");
        if now["version"] == before["version"] { Err(now.to_string()) } else { Ok(()) }
    });
    let grown = page.json("/api/curves");
    assert_eq!(evaluation(1, &grown), serde_json::json!([[40, 80], [-2.0, 3.0]]));
    assert_eq!(evaluation(0, &grown), evaluation(0, &found));
}

#[test]
fn runs_that_differ_only_in_their_seed_have_one_group_and_a_damaged_run_has_none() {
    let runs = Runs::new();
    let folder = runs.folder("place");
    for (name, settings) in [
        ("a", ["run.seed=1", "run.actors=1"]),
        ("b", ["run.seed=2", "run.actors=2"]),
        ("c", ["run.seed=1", "algorithm=happo"]),
    ] {
        write_run(&folder.join(name), 1.5);
        let settings = succeeded(&["config", "halfcheetah-2x3", settings[0], settings[1]]);
        std::fs::write(folder.join(name).join("config.toml"), settings).unwrap();
    }
    let damaged = folder.join("d");
    write_run(&damaged, 1.5);
    std::fs::write(damaged.join("config.toml"), "task = ").unwrap();
    std::fs::write(damaged.join("metrics.jsonl"), "{\"kind\":\"evaluati\n\0\0\n").unwrap();
    let page = PageOfRuns::start(&folder, &["a", "b", "c", "d"]);
    let of_runs = |key: &str| {
        let found = page.json("/api/curves")["runs"].as_array().unwrap().clone();
        found.iter().map(|run| run[key].clone()).collect::<Vec<_>>()
    };
    let groups = serde_json::json!(["happo-s2mia", "happo-s2mia", "happo", null]);
    assert_eq!(Value::from(of_runs("group")), groups);
    let troubles = of_runs("trouble");
    assert_eq!(troubles[..3], [Value::Null, Value::Null, Value::Null]);
    for part in ["config.toml", "metrics.jsonl: 2 damaged lines are skipped"] {
        assert!(troubles[3].as_str().unwrap().contains(part), "{}", troubles[3]);
    }
    // The damaged run grows again.
    add_evaluation(&damaged, 40, 3.0);
    eventually(|| {
        let curve = page.json("/api/curves")["runs"][3]["curves"]["evaluation/mean"].clone();
        if curve == serde_json::json!([[40], [3.0]]) { Ok(()) } else { Err(curve.to_string()) }
    });
}

#[test]
fn the_page_of_several_runs_has_the_rules_and_the_script_of_a_learners_page() {
    let runs = Runs::new();
    let folder = runs.folder("place");
    write_run(&folder.join("first"), 1.5);
    let page = PageOfRuns::start(&folder, &["first"]);
    let code = |request: &str| ask(&page.page, request).0;
    assert_eq!(code("GET /api/curves HTTP/1.1\r\nHost: example.org\r\n\r\n"), 403);
    assert_eq!(code("POST /api/runs HTTP/1.1\r\nHost: localhost\r\n\r\n"), 405);
    assert_eq!(code("GET /api/status HTTP/1.1\r\nHost: localhost\r\n\r\n"), 404);
    let root = "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n";
    let (_, head, shown) = ask(&page.page, root);
    let learner = Learner::start(&runs.folder("run"), "127.0.0.1:0");
    let (_, heads, of_learner) = learner.ask(root);
    let policy = |head: &str| {
        let mut lines = head.lines().map(str::to_owned);
        lines.find(|line| line.starts_with("content-security-policy")).unwrap()
    };
    assert_eq!(policy(&head), policy(&heads));
    assert!(shown.contains("<html data-view=\"runs\" "));
    assert_eq!(shown.replace("data-view=\"runs\" ", ""), of_learner);
}

#[test]
fn folders_that_are_no_runs_and_addresses_of_other_machines_are_refused_in_one_line() {
    let runs = Runs::new();
    let folder = runs.folder("place");
    write_run(&folder.join("first"), 1.5);
    for (arguments, reason) in [
        (&["first", "missing"][..], "missing is no run folder"),
        (&["first", "--listen", "0.0.0.0:0"], "--insecure-allow-remote-page"),
        (&[], "there is no run in ./runs"),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
        let output = command.arg("page").args(arguments).current_dir(&folder).output().unwrap();
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{error}");
        assert!(error.contains(reason) && error.lines().count() == 1, "{error}");
    }
}
