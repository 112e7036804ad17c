//! Faults of the learner's host: its process is suspended, it runs out of file descriptors, a certificate
//! expires. Each is reported in one line, the actors survive, and the run ends as an undisturbed one.

use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, SystemTime};

use crate::certificates::Certificates;
use crate::processes::{Background, Learner, actor, eventually, has_begun, passes};
use crate::runs::{Runs, SHORT, error, inspect, metrics, s2mia, words};
use security::Role;
use security::development::Issuer;

/// The length of a run that is stopped when its test has seen enough.
const ENDLESS: [&str; 2] = ["run.iterations=1000000", SHORT[1]];
const DAY: Duration = Duration::from_secs(86_400);
/// Validity of a certificate that expires during a test.
const SHORT_TIME: Duration = Duration::from_secs(15);

fn continues(run: &Path) {
    passes(run, metrics(run, "iteration").len() + 1);
}

/// Stops the learner by a signal and its actors after it; returns the learner's log.
fn stopped(learner: &mut Learner, actors: impl IntoIterator<Item = Background>) -> String {
    let log = learner.process.stop();
    for mut actor in actors {
        actor.stop();
    }
    log
}

/// Compares the run with an undisturbed one of as many iterations.
fn ends_as_undisturbed(run: &Path) {
    let quiet = run.with_file_name("quiet");
    let found = inspect(run);
    let length = format!("run.iterations={}", found["iteration"]);
    Learner::start(&quiet, &[&length, SHORT[1]]).finish(&[]);
    assert_eq!(found, inspect(&quiet));
}

#[test]
fn a_learner_that_is_suspended_for_twenty_seconds_keeps_its_actors_and_its_result() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let mut learner = Learner::start(&folder, &[&ENDLESS[..], &["lease.ttl_secs=1"]].concat());
    let actors = ["one", "two"].map(|name| actor(&learner.url, &["--name", name]));
    has_begun(&folder);
    learner.process.signal("-STOP");
    // Longer than leases, calls and heartbeats may take.
    std::thread::sleep(Duration::from_secs(20));
    learner.process.signal("-CONT");
    continues(&folder);
    stopped(&mut learner, actors);
    ends_as_undisturbed(&folder);
}

#[test]
fn a_learner_without_free_file_descriptors_reports_it_once_and_continues() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let mut learner = Learner::start(&folder, &[&ENDLESS[..], &["checkpoint.every=1"]].concat());
    let actor = actor(&learner.url, &[]);
    has_begun(&folder);
    let id = learner.process.process.id();
    let held = std::fs::read_dir(format!("/proc/{id}/fd")).unwrap().count() + 2;
    let limit = |soft: &str| {
        let limits = ["--pid", &id.to_string(), &format!("--nofile={soft}:")];
        assert!(Command::new("prlimit").args(limits).status().unwrap().success());
    };
    limit(&held.to_string());
    let address = learner.url.strip_prefix("http://").unwrap();
    // More than there are descriptors left: the last ones wait in the kernel's queue.
    let peers = (0..12).map(|_| TcpStream::connect(address).unwrap()).collect::<Vec<_>>();
    learner.process.logs("cannot accept connections: Too many open files", 1);
    learner.process.logs("checkpoint failed", 1);
    // The learner tries to accept at least this long.
    assert!(!s2mia(&["health", "--learner", &learner.url, "--timeout-secs", "1"]).status.success());
    continues(&folder);
    limit("1024");
    drop(peers);
    learner.process.logs("accepting connections again", 1);
    continues(&folder);
    assert!(s2mia(&["health", "--learner", &learner.url]).status.success());
    let log = stopped(&mut learner, [actor]);
    let lines = log.matches("cannot accept connections").count();
    assert!(lines <= 2, "{lines} lines instead of one in ten seconds: {log}");
    ends_as_undisturbed(&folder);
}

#[test]
fn a_run_whose_metrics_cannot_be_written_has_its_checkpoints_and_later_its_metrics() {
    let runs = Runs::new();
    let folder = runs.folder("run");
    let mut learner = Learner::start(&folder, &[&ENDLESS[..], &["checkpoint.every=1"]].concat());
    let actor = actor(&learner.url, &[]);
    has_begun(&folder);
    let lines = folder.join("metrics.jsonl");
    let elsewhere = folder.join("metrics.before");
    learner.process.signal("-STOP");
    std::fs::rename(&lines, &elsewhere).unwrap();
    std::fs::create_dir(&lines).unwrap();
    learner.process.signal("-CONT");
    learner.process.logs("the checkpoint is written without these lines", 2);
    learner.process.signal("-STOP");
    std::fs::remove_dir(&lines).unwrap();
    std::fs::rename(&elsewhere, &lines).unwrap();
    learner.process.signal("-CONT");
    stopped(&mut learner, [actor]);
    assert_eq!(
        Some(metrics(&folder, "iteration").len() as u64),
        inspect(&folder)["iteration"].as_u64()
    );
    ends_as_undisturbed(&folder);
}

/// A learner over TLS and an actor at work. One of the two certificates, `expiring`, expires soon.
struct Guarded {
    runs: Runs,
    certificates: Certificates,
    lasting: Issuer,
    learner: Learner,
    actor: Background,
}

impl Guarded {
    fn start(expiring: &str) -> Self {
        let runs = Runs::new();
        let lasting = Issuer::new(SystemTime::now(), DAY).unwrap();
        let short = Issuer::new(SystemTime::now(), SHORT_TIME).unwrap();
        let certificates = Certificates(runs.folder("certificates"));
        std::fs::create_dir(&certificates.0).unwrap();
        let authorities = [lasting.certificate(), short.certificate()].concat();
        std::fs::write(certificates.0.join("ca.pem"), authorities).unwrap();
        let issuer = |name| if name == expiring { &short } else { &lasting };
        let server = issuer("server").server(&["127.0.0.1".to_owned()]).unwrap();
        certificates.write("server", &server);
        certificates.write("actor", &issuer("actor").client(&[Role::Actor]).unwrap());
        let folder = runs.folder("run");
        let tls = certificates.of_learner();
        let learner = Learner::start(&folder, &[&ENDLESS[..], &words(&tls)].concat());
        let tls = certificates.of_client(&certificates, "actor");
        let actor = actor(&learner.url, &words(&tls));
        has_begun(&folder);
        Self { runs, certificates, lasting, learner, actor }
    }

    /// Waits until a new connection is refused for the reason `why`, while the actor keeps its own. In the moment in
    /// which a certificate expires, only one of the two ends may find it expired, so that the reason may be another.
    fn is_refused(&self, why: &str) {
        let tls = self.certificates.of_client(&self.certificates, "actor");
        let health = [&["health", "--learner", &self.learner.url], &words(&tls)[..]].concat();
        eventually(|| {
            let asked = s2mia(&health);
            let said = error(&asked);
            if !asked.status.success() && said.contains(why) { Ok(()) } else { Err(said) }
        });
        continues(&self.runs.folder("run"));
        assert!(!self.actor.log().contains("session ended"), "{}", self.actor.log());
    }
}

#[test]
fn an_actor_whose_certificate_expires_keeps_its_connection_and_a_new_one_reads_the_renewed_file() {
    let guarded = Guarded::start("actor");
    guarded.is_refused("actor.pem expired at ");
    let Guarded { runs, certificates, lasting, mut learner, actor: first } = guarded;
    certificates.write("actor", &lasting.client(&[Role::Actor]).unwrap());
    let tls = certificates.of_client(&certificates, "actor");
    let second = actor(&learner.url, &words(&tls));
    learner.process.logs("actor registered", 2);
    stopped(&mut learner, [first, second]);
    ends_as_undisturbed(&runs.folder("run"));
}

#[test]
fn a_learner_whose_certificate_expires_keeps_its_connections_and_gets_no_new_ones() {
    let mut guarded = Guarded::start("server");
    guarded.is_refused("the learner's certificate is refused: it expired");
    stopped(&mut guarded.learner, [guarded.actor]);
}
