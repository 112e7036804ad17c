//! Faults of the learner's host: its process is suspended, it runs out of file descriptors, a certificate
//! expires. Each is reported in one line, the actors survive, and the run ends as an undisturbed one.

use std::fs::File;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, SystemTime};

use crate::commands::signal;
use crate::learners::{Learner, inspect};
use crate::runs::s2mia;
use crate::waiting::{eventually, has_begun};
use security::Role;
use security::development::{Issued, Issuer};

/// Iterations of a run that is stopped when its test has seen enough.
const ENDLESS: &str = "run.iterations=1000000";
const DAY: Duration = Duration::from_secs(86_400);
/// Validity of a certificate that expires during a test.
const SHORT: Duration = Duration::from_secs(15);

/// An actor process, and the file with its log.
struct Actor {
    process: Child,
    log: PathBuf,
}

impl Actor {
    /// Starts an actor whose log is in `folder`.
    fn start(folder: &Path, name: &str, url: &str, more: &[String]) -> Self {
        let log = folder.join(format!("{name}.log"));
        let mut command = Command::new(env!("CARGO_BIN_EXE_s2mia"));
        command.args(["actor", "--learner", url, "--name", name]).args(more);
        command.stdout(Stdio::null()).stderr(File::create(&log).unwrap());
        Self { process: command.spawn().unwrap(), log }
    }

    fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap()
    }
}

impl Drop for Actor {
    fn drop(&mut self) {
        // The actor still runs only if the test failed.
        let _killed = self.process.kill();
        let _reaped = self.process.wait();
    }
}

/// Waits until `text` contains `words` `count` times.
fn says(text: impl Fn() -> String, words: &str, count: usize) {
    eventually(|| match text() {
        text if text.matches(words).count() >= count => Ok(()),
        text => Err(format!("`{words}` is not there {count} times: {text}")),
    });
}

fn run(command: &str, arguments: &[&str]) {
    assert!(Command::new(command).args(arguments).status().unwrap().success(), "{command}");
}

/// Iterations that the run has finished.
fn iteration(run: &Path) -> u64 {
    let metrics = std::fs::read_to_string(run.join("metrics.jsonl")).unwrap_or_default();
    let kind = |line: &&str| line.contains("\"kind\":\"iteration\"");
    metrics.lines().filter(kind).count() as u64
}

fn continues(run: &Path) {
    let before = iteration(run);
    eventually(|| match iteration(run) {
        now if now > before + 1 => Ok(()),
        now => Err(format!("iteration {now} is the last")),
    });
}

/// Stops the learner by a signal and its actors after it; returns the learner's log.
fn stopped(learner: &mut Learner, actors: Vec<Actor>) -> String {
    let log = learner.stop();
    for mut actor in actors {
        signal(actor.process.id(), "-TERM");
        assert!(actor.process.wait().unwrap().success(), "{}", actor.log());
    }
    log
}

/// Compares the run with an undisturbed one of as many iterations.
fn ends_as_undisturbed(run: &Path) {
    let quiet = run.with_file_name("quiet");
    let found = inspect(run);
    let length = format!("run.iterations={}", found["iteration"]);
    Learner::start(&quiet, &[length]).finish(&[]);
    assert_eq!(found, inspect(&quiet));
}

#[test]
fn a_learner_that_is_suspended_for_twenty_seconds_keeps_its_actors_and_its_result() {
    let folder = tempfile::tempdir().unwrap();
    let run_folder = folder.path().join("run");
    let settings = [ENDLESS, "lease.ttl_secs=1"];
    let mut learner = Learner::start(&run_folder, &settings.map(str::to_owned));
    let actors = ["one", "two"].map(|name| Actor::start(folder.path(), name, &learner.url, &[]));
    has_begun(&run_folder);
    let id = learner.process.id();
    signal(id, "-STOP");
    // Longer than leases, calls and heartbeats may take.
    std::thread::sleep(Duration::from_secs(20));
    signal(id, "-CONT");
    continues(&run_folder);
    stopped(&mut learner, actors.into());
    ends_as_undisturbed(&run_folder);
}

#[test]
fn a_learner_without_free_file_descriptors_reports_it_once_and_continues() {
    let folder = tempfile::tempdir().unwrap();
    let run_folder = folder.path().join("run");
    let settings = [ENDLESS, "checkpoint.every=1"].map(str::to_owned);
    let mut learner = Learner::start(&run_folder, &settings);
    let actors = vec![Actor::start(folder.path(), "one", &learner.url, &[])];
    has_begun(&run_folder);
    let id = learner.process.id();
    let held = std::fs::read_dir(format!("/proc/{id}/fd")).unwrap().count() + 2;
    let limit =
        |soft: &str| run("prlimit", &["--pid", &id.to_string(), &format!("--nofile={soft}:")]);
    limit(&held.to_string());
    let address = learner.url.strip_prefix("http://").unwrap().to_owned();
    // More than there are descriptors left: the last ones wait in the kernel's queue.
    let peers = (0..12).map(|_| TcpStream::connect(&address).unwrap()).collect::<Vec<_>>();
    says(|| learner.log(), "cannot accept connections: Too many open files", 1);
    says(|| learner.log(), "checkpoint failed", 1);
    // The learner tries to accept at least this long.
    assert!(!s2mia(&["health", "--learner", &learner.url, "--timeout-secs", "1"]).status.success());
    continues(&run_folder);
    limit("1024");
    drop(peers);
    says(|| learner.log(), "accepting connections again", 1);
    continues(&run_folder);
    assert!(s2mia(&["health", "--learner", &learner.url]).status.success());
    let log = stopped(&mut learner, actors);
    let lines = log.matches("cannot accept connections").count();
    assert!(lines <= 2, "{lines} lines instead of one in ten seconds: {log}");
    ends_as_undisturbed(&run_folder);
}

fn files(folder: &Path, authority: &str, name: &str) -> Vec<String> {
    let (certificate, key) = (format!("{name}.pem"), format!("{name}.key"));
    [(authority, "ca.pem"), ("--tls-certificate", &certificate), ("--tls-key", &key)]
        .iter()
        .flat_map(|(flag, name)| [(*flag).to_owned(), folder.join(name).display().to_string()])
        .collect()
}

/// A learner over TLS and an actor at work. One of the two certificates, `expiring`, expires soon.
struct Guarded {
    folder: tempfile::TempDir,
    lasting: Issuer,
    learner: Learner,
    actor: Actor,
}

impl Guarded {
    fn start(expiring: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let lasting = Issuer::new(SystemTime::now(), DAY).unwrap();
        let short = Issuer::new(SystemTime::now(), SHORT).unwrap();
        let authorities = [lasting.certificate(), short.certificate()].concat();
        std::fs::write(folder.path().join("ca.pem"), authorities).unwrap();
        let issuer = |name| if name == expiring { &short } else { &lasting };
        let server = issuer("server").server(&["127.0.0.1".to_owned()]).unwrap();
        write(folder.path(), "server", &server);
        write(folder.path(), "actor", &issuer("actor").client(&[Role::Actor]).unwrap());
        let run = folder.path().join("run");
        let tls = files(folder.path(), "--tls-client-ca", "server");
        let learner = Learner::start(&run, &[vec![ENDLESS.to_owned()], tls].concat());
        let tls = files(folder.path(), "--tls-ca", "actor");
        let actor = Actor::start(folder.path(), "one", &learner.url, &tls);
        has_begun(&run);
        Self { folder, lasting, learner, actor }
    }

    /// Waits until a new connection is refused for the reason `why`, while the actor keeps its own. In the moment in
    /// which a certificate expires, only one of the two ends may find it expired, so that the reason may be another.
    fn is_refused(&self, why: &str) {
        let tls = files(self.folder.path(), "--tls-ca", "actor");
        let tls = tls.iter().map(String::as_str);
        let health = ["health", "--learner", &self.learner.url].into_iter().chain(tls);
        let health = health.collect::<Vec<_>>();
        eventually(|| {
            let asked = s2mia(&health);
            let said = String::from_utf8(asked.stderr).unwrap();
            if !asked.status.success() && said.contains(why) { Ok(()) } else { Err(said) }
        });
        continues(&self.folder.path().join("run"));
        assert!(!self.actor.log().contains("session ended"), "{}", self.actor.log());
    }
}

fn write(folder: &Path, name: &str, issued: &Issued) {
    std::fs::write(folder.join(format!("{name}.key")), &issued.key).unwrap();
    std::fs::write(folder.join(format!("{name}.pem")), &issued.certificate).unwrap();
}

#[test]
fn an_actor_whose_certificate_expires_keeps_its_connection_and_a_new_one_reads_the_renewed_file() {
    let Guarded { folder, lasting, mut learner, actor } = {
        let guarded = Guarded::start("actor");
        guarded.is_refused("actor.pem expired at ");
        guarded
    };
    write(folder.path(), "actor", &lasting.client(&[Role::Actor]).unwrap());
    let tls = files(folder.path(), "--tls-ca", "actor");
    let second = Actor::start(folder.path(), "two", &learner.url, &tls);
    says(|| learner.log(), "actor registered", 2);
    stopped(&mut learner, vec![actor, second]);
    ends_as_undisturbed(&folder.path().join("run"));
}

#[test]
fn a_learner_whose_certificate_expires_keeps_its_connections_and_gets_no_new_ones() {
    let guarded = Guarded::start("server");
    guarded.is_refused("the learner's certificate is refused: certificate expired");
    let Guarded { mut learner, actor, .. } = guarded;
    stopped(&mut learner, vec![actor]);
}
