//! The learner's HTTP page, requested like a browser and like Prometheus.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;

use serde_json::{Value, json};

use crate::processes::{Background, Learner, actor, eventually, passes};
use crate::runs::{
    Runs, command, evaluated, failure, metrics, status, succeeded, success, text, train, weights,
};

/// The learner of a long run with evaluations, and the address of its page.
fn learner(folder: &Path) -> (Learner, Page) {
    let mut learner = Learner::start(folder, &["run.iterations=100000", "--page=127.0.0.1:0"]);
    let page = Page(learner.process.url().trim_start_matches("http://").to_owned());
    (learner, page)
}

/// `s2mia page`, and its address.
fn page_of_runs(folder: &Path, runs: &[&str]) -> (Background, Page) {
    let mut process = Background::start(command(&["page"]).args(runs).current_dir(folder));
    let page = process.line().strip_prefix("page: http://").unwrap().to_owned();
    (process, Page(page))
}

/// The address of a page.
struct Page(String);

impl Page {
    /// Status code, headers and body.
    fn ask(&self, request: &str) -> (u16, String, String) {
        let mut stream = TcpStream::connect(&self.0).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        let code = head.split(' ').nth(1).unwrap().parse().unwrap();
        (code, head.to_owned(), body.to_owned())
    }

    /// Checks the status codes of requests, such as `GET / HTTP/1.1`, from a browser that was given the name `localhost`.
    fn answers(&self, requests: &[(&str, u16)]) {
        for (request, expected) in requests {
            let (code, ..) = self.ask(&format!("{request}\r\nHost: localhost\r\n\r\n"));
            assert_eq!(code, *expected, "{request}");
        }
        for path in ["/", "/api/curves/0"] {
            let (code, ..) = self.ask(&format!("GET {path} HTTP/1.1\r\nHost: example.org\r\n\r\n"));
            assert_eq!(code, 403, "{path}");
        }
    }

    /// The headers and the body of the page.
    fn root(&self) -> (String, String) {
        let (code, head, body) = self.ask("GET / HTTP/1.1\r\nHost: localhost\r\n\r\n");
        assert_eq!(code, 200);
        (head, body)
    }

    fn get(&self, path: &str) -> String {
        let (code, _, body) = self.ask(&format!("GET {path} HTTP/1.1\r\nHost: {}\r\n\r\n", self.0));
        assert_eq!(code, 200, "{path}: {body}");
        body
    }

    fn json(&self, path: &str) -> Value {
        serde_json::from_str(&self.get(path)).unwrap()
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

#[test]
fn the_figures_of_prometheus_and_of_the_page_equal_the_metrics_and_the_status() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let (learner, page) = learner(&folder);
    let actor = actor(&learner.url, &[]);
    passes(&folder, 2);
    // Without an actor, the figures do not change between requests.
    drop(actor);
    let shown = eventually(|| {
        let runs = page.json("/api/runs");
        let live = &runs["runs"][0]["live"];
        let waits = live["stage"] == "collect" && live["status"]["actors"] == 0;
        if waits { Ok(runs) } else { Err(runs.to_string()) }
    });
    let run = &shown["runs"][0];
    let of_page = &run["live"]["status"];
    let line = metrics(&folder, "iteration").pop().unwrap();
    let scrape = page.get("/metrics");
    assert_eq!(*of_page, status(&learner.url));
    for (name, of_status) in [
        ("s2mia_iteration", "iteration"),
        ("s2mia_env_steps_total", "env_steps"),
        ("s2mia_leases_reissued_total", "leases_reissued"),
        ("s2mia_slots{state=\"complete\"}", "complete_slots"),
    ] {
        assert_eq!(sample(&scrape, name), of_page[of_status].as_f64().unwrap(), "{name}");
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
    let [iteration, extrinsic_return] =
        [0, 1].map(|k| run["policies"].as_array().unwrap().last().unwrap()[k].clone());
    let film = page.json(&format!("/api/film/0/{iteration}/0"));
    assert_eq!(film["return"], extrinsic_return);
    let numbers = film["ends"].as_array().unwrap().len();
    assert_eq!(numbers, 400 * film["radii"].as_array().unwrap().len() * 6);
    let curves = page.json("/api/curves/0");
    assert_eq!(curves["version"], run["version"]);
    let curve = &curves["curves"]["rollout_secs"];
    assert_eq!(curve[0].as_array().unwrap().len() as u64, line["iteration"].as_u64().unwrap());
}

#[test]
fn steps_lost_by_an_actors_log_are_reported_by_the_learner() {
    let runs = Runs::new();
    let (learner, page) = learner(&runs.folder("run"));
    // An existing folder in which not even root can create a file.
    let _actor = actor(&learner.url, &["--log-dir", "/proc", "--log-episodes", "all"]);
    eventually(|| {
        let lost = sample(&page.get("/metrics"), "s2mia_log_dropped_total");
        // A slot has two environments of twenty steps.
        if lost >= 80.0 { Ok(()) } else { Err(format!("{lost} steps lost, of 80")) }
    });
}

#[test]
fn idle_connections_and_continuous_requests_do_not_block_the_run_or_affect_its_weights() {
    let runs = Runs::new();
    let (plain, watched) = (runs.folder("plain"), runs.folder("watched"));
    train(&plain, &["run.iterations=3", "--page", "off"]);
    let (learner, page) = learner(&watched);
    let silent: Vec<_> = (0..40).map(|_| TcpStream::connect(&page.0).unwrap()).collect();
    let actor = actor(&learner.url, &[]);
    eventually(|| {
        let paths = [
            "/",
            "/metrics.md",
            "/api/runs",
            "/api/runs/0",
            "/api/curves/0",
            "/api/film/0/0/0",
            "/metrics",
        ];
        paths.iter().for_each(|path| drop(page.get(path)));
        // An iteration's provenance is written after its metrics.
        let iterations = metrics(&watched, "iteration").len();
        if iterations > 3 { Ok(()) } else { Err(format!("{iterations} iterations of 4")) }
    });
    drop((learner, actor, silent));
    let provenance = std::fs::read_to_string(watched.join("provenance.jsonl")).unwrap();
    let third: Value = serde_json::from_str(provenance.lines().nth(2).unwrap()).unwrap();
    assert_eq!(third["weights_sha256"], weights(&plain));
}

#[test]
fn pages_reject_other_hosts_and_methods_and_may_not_load_external_content() {
    let runs = Runs::new();
    let (_learner, page) = learner(&runs.folder("run"));
    page.answers(&[("POST /api/runs HTTP/1.1", 405), ("GET /runs HTTP/1.1", 404)]);
    assert_eq!(page.ask("GET /api/runs HTTP/1.0\r\n\r\n").0, 403);
    let (code, _, body) = page.ask("HEAD / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert_eq!((code, body.as_str()), (200, ""));
    let (head, body) = page.root();
    assert!(head.contains("default-src 'none'; script-src 'sha256-"), "{head}");
    assert!(!head.to_lowercase().contains("access-control-allow"), "{head}");
    assert!(body.starts_with("<!doctype html>"));

    let place = runs.folder("place");
    write_run(&place.join("first"), 1.5);
    let (_process, several) = page_of_runs(&place, &["first"]);
    several.answers(&[("POST /api/runs HTTP/1.1", 405), ("GET /metrics HTTP/1.1", 404)]);
    let (other_head, other_body) = several.root();
    let policy = |head: &str| {
        let mut lines = head.lines().map(str::to_owned);
        lines.find(|line| line.starts_with("content-security-policy")).unwrap()
    };
    assert_eq!(policy(&other_head), policy(&head));
    assert_eq!(other_body, body);
}

#[test]
fn the_page_of_several_runs_has_all_their_curves_and_follows_those_that_grow() {
    let runs = Runs::new();
    let folder = runs.folder("place");
    write_run(&folder.join("runs/first"), 1.5);
    write_run(&folder.join("runs/second"), -2.0);
    std::fs::create_dir(folder.join("runs/notes")).unwrap();
    let (_process, page) = page_of_runs(&folder, &[]);
    let curves = |run: usize| page.json(&format!("/api/curves/{run}"));
    let evaluation = |run: usize| curves(run)["curves"]["evaluation/mean"].clone();
    assert_eq!([evaluation(0), evaluation(1)], [json!([[40], [1.5]]), json!([[40], [-2.0]])]);
    let of_runs = |key: &str| {
        let found = page.json("/api/runs");
        [0, 1].map(|run| found["runs"][run][key].clone())
    };
    assert_eq!(of_runs("name"), ["first", "second"]);
    let before = of_runs("version");
    assert_eq!(before, [0, 1].map(|run| curves(run)["version"].clone()));
    add_evaluation(&folder.join("runs/second"), 80, 3.0);
    let now = eventually(|| {
        let now = of_runs("version");
        if now == before { Err(format!("{now:?}")) } else { Ok(now) }
    });
    assert_eq!(now[0], before[0], "only the run that grew has a new version");
    assert_eq!(
        [evaluation(0), evaluation(1)],
        [json!([[40], [1.5]]), json!([[40, 80], [-2.0, 3.0]])]
    );
    let unknown =
        ["runs/2", "curves/2", "film/2/1/0"].map(|path| format!("GET /api/{path} HTTP/1.1"));
    page.answers(&unknown.each_ref().map(|path| (path.as_str(), 404)));
}

#[test]
fn runs_that_differ_only_in_their_seed_have_one_group_and_a_damaged_run_or_a_copy_has_none() {
    let runs = Runs::new();
    let folder = runs.folder("place");
    for (name, settings) in [
        ("a", ["run.seed=1", "run.actors=1"]),
        ("b", ["run.seed=2", "run.actors=2"]),
        ("c", ["run.seed=1", "algorithm=happo"]),
        ("copy", ["run.seed=1", "run.actors=1"]),
    ] {
        write_run(&folder.join(name), 1.5);
        let settings = succeeded(&["config", "halfcheetah-2x3", settings[0], settings[1]]);
        std::fs::write(folder.join(name).join("config.toml"), settings).unwrap();
    }
    let damaged = folder.join("d");
    write_run(&damaged, 1.5);
    std::fs::write(damaged.join("config.toml"), "task = ").unwrap();
    std::fs::write(damaged.join("metrics.jsonl"), "{\"kind\":\"evaluati\n\0\0\n").unwrap();
    let (_process, page) = page_of_runs(&folder, &["a", "b", "c", "d", "copy"]);
    let of_runs = |key: &str| {
        let found = page.json("/api/runs")["runs"].as_array().unwrap().clone();
        found.iter().map(|run| run[key].clone()).collect::<Vec<_>>()
    };
    let groups = json!(["happo-s2mia", "happo-s2mia", "happo", null, null]);
    assert_eq!(Value::from(of_runs("group")), groups);
    let troubles = of_runs("trouble");
    assert_eq!(troubles[..3], [Value::Null, Value::Null, Value::Null]);
    for part in ["config.toml", "metrics.jsonl: 2 damaged lines are skipped"] {
        assert!(troubles[3].as_str().unwrap().contains(part), "{}", troubles[3]);
    }
    assert!(troubles[4].as_str().unwrap().contains("it has the settings and seed of"));
    // The damaged run grows again.
    add_evaluation(&damaged, 40, 3.0);
    eventually(|| {
        let curve = page.json("/api/curves/3")["curves"]["evaluation/mean"].clone();
        if curve == json!([[40], [3.0]]) { Ok(()) } else { Err(curve.to_string()) }
    });
}

#[test]
fn the_page_of_a_finished_run_plays_its_episodes_and_has_the_command_that_trains_it_again() {
    let runs = Runs::new();
    let (folder, again) = (runs.folder("run"), runs.folder("again"));
    train(&folder, &["run.iterations=2", "--page=off"]);
    let (_process, page) = page_of_runs(&folder, &["."]);
    let run = page.json("/api/runs")["runs"][0].clone();
    let mean = metrics(&folder, "evaluation").pop().unwrap()["mean"].clone();
    assert_eq!(run["policies"].as_array().unwrap().last(), Some(&json!([2, mean])));
    let of_eval = evaluated(text(&folder), &["--episodes", "2"]);
    for index in [1, 0] {
        let film = page.json(&format!("/api/film/0/2/{index}"));
        assert_eq!(film["return"], of_eval["episodes"][index]["return"]);
    }
    let why = page.json("/api/film/0/1/0")["error"].to_string();
    assert!(why.contains("no checkpoint of iteration 1"), "{why}");
    let facts = page.json("/api/runs/0");
    assert_eq!(facts["settings"], std::fs::read_to_string(folder.join("config.toml")).unwrap());
    let words: Vec<_> = facts["command"].as_str().unwrap().split(' ').collect();
    assert_eq!(words[..3], ["s2mia", "train", "halfcheetah-6x1"]);
    success(command(&words[1..]).args(["--page=off", &format!("run.dir={}", again.display())]));
    assert_eq!(weights(&again), weights(&folder));
}

#[test]
fn folders_that_are_no_runs_and_addresses_of_other_machines_are_refused_in_one_line() {
    let runs = Runs::new();
    let folder = runs.folder("place");
    write_run(&folder.join("first"), 1.5);
    for (arguments, reason) in [
        (&["first", "missing"][..], "there is no run folder `missing`"),
        (&["first", "--listen", "0.0.0.0:0"], "--insecure-allow-remote-page"),
        (&[], "there is no run in ./runs"),
    ] {
        let mut page = command(&["page"]);
        let line = failure(page.args(arguments).current_dir(&folder), 2);
        assert!(line.contains(reason), "{line}");
    }
}
