//! Faults of the learner's host: its process is suspended, it runs out of file descriptors, its certificates or those of
//! its actors expire. Each is reported in one line, the actors survive, and the run ends as an undisturbed one.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "system/learners.rs"]
mod learners;
#[path = "system/waiting.rs"]
mod waiting;

use std::fs::File;
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use learners::{Learner, inspect};
use security::Role;
use security::development::{Issued, Issuer};
use waiting::{eventually, has_begun};

/// Iterations of a run that is stopped when its test has seen enough.
const ENDLESS: &str = "run.iterations=1000000";
const DAY: Duration = Duration::from_secs(86_400);
/// Validity of a certificate that expires during a test.
const SHORT: Duration = Duration::from_secs(15);

fn s2mia(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_s2mia")).args(arguments).output().unwrap()
}

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

fn goes_on(run: &Path) {
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
        run("kill", &[&actor.process.id().to_string()]);
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
    let settings = [ENDLESS, "lease.ttl_secs=1", "lease.heartbeat_secs=0.2"];
    let mut learner = Learner::start(&run_folder, &settings.map(str::to_owned));
    let actors = ["one", "two"].map(|name| Actor::start(folder.path(), name, &learner.url, &[]));
    has_begun(&run_folder);
    let id = learner.process.id().to_string();
    run("kill", &["-STOP", &id]);
    // Longer than leases, calls and heartbeats may take.
    std::thread::sleep(Duration::from_secs(20));
    run("kill", &["-CONT", &id]);
    goes_on(&run_folder);
    stopped(&mut learner, actors.into());
    ends_as_undisturbed(&run_folder);
}

#[test]
fn a_learner_without_free_file_descriptors_says_so_once_and_goes_on() {
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
    goes_on(&run_folder);
    limit("1024");
    drop(peers);
    says(|| learner.log(), "accepting connections again", 1);
    goes_on(&run_folder);
    assert!(s2mia(&["health", "--learner", &learner.url]).status.success());
    let log = stopped(&mut learner, actors);
    let lines = log.matches("cannot accept connections").count();
    assert!(lines <= 2, "{lines} lines instead of one in ten seconds: {log}");
    ends_as_undisturbed(&run_folder);
}

/// Certificate files in a folder.
struct Files(PathBuf);

impl Files {
    fn of(folder: &Path, issuer: &Issuer) -> Self {
        std::fs::write(folder.join("ca.pem"), issuer.certificate()).unwrap();
        Self(folder.to_path_buf())
    }

    fn write(&self, name: &str, issued: &Issued) {
        std::fs::write(self.0.join(format!("{name}.key")), &issued.key).unwrap();
        std::fs::write(self.0.join(format!("{name}.pem")), &issued.certificate).unwrap();
    }

    fn arguments(&self, authority: &str, name: &str) -> Vec<String> {
        let file = |name: &str| self.0.join(name).to_str().unwrap().to_owned();
        let (certificate, key) = (format!("{name}.pem"), format!("{name}.key"));
        [(authority, "ca.pem"), ("--tls-certificate", &certificate), ("--tls-key", &key)]
            .iter()
            .flat_map(|(flag, name)| [(*flag).to_owned(), file(name)])
            .collect()
    }
}

/// Passes bytes on between an actor and its learner until it is cut.
struct Proxy {
    port: u16,
    streams: Arc<Mutex<Vec<TcpStream>>>,
}

impl Proxy {
    fn start(url: &str) -> Self {
        let target = url.rsplit('/').next().unwrap().to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let streams = Arc::new(Mutex::new(Vec::new()));
        let open = Arc::clone(&streams);
        let accept = move || {
            for near in listener.incoming() {
                let (near, far) = (near.unwrap(), TcpStream::connect(&target).unwrap());
                for (from, to) in [(&near, &far), (&far, &near)] {
                    let (mut from, mut to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    open.lock().unwrap().push(from.try_clone().unwrap());
                    spawn(move || {
                        let _passed = std::io::copy(&mut from, &mut to);
                        let _ended = to.shutdown(Shutdown::Write);
                    });
                }
            }
        };
        spawn(accept);
        Self { port, streams }
    }

    /// Closes all connections; new ones are passed on.
    fn cut(&self) {
        for stream in self.streams.lock().unwrap().drain(..) {
            let _closed = stream.shutdown(Shutdown::Both);
        }
    }
}

fn spawn(work: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new().name("proxy".into()).spawn(work).unwrap();
}

/// A learner over TLS and an actor at work, through a proxy; one of the two certificates expires soon.
struct Guarded {
    folder: tempfile::TempDir,
    files: Files,
    issuer: Issuer,
    learner: Learner,
    actor: Actor,
    proxy: Proxy,
}

const NAMES: [&str; 2] = ["localhost", "127.0.0.1"];

impl Guarded {
    fn start(expiring: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut issuer = Issuer::new(SystemTime::now(), DAY).unwrap();
        let files = Files::of(folder.path(), &issuer);
        let duration = |name: &str| if name == expiring { SHORT } else { DAY };
        issuer.set_duration(duration("server"));
        files.write("server", &issuer.server(&NAMES.map(str::to_owned)).unwrap());
        issuer.set_duration(duration("actor"));
        files.write("actor", &issuer.client(Role::Actor).unwrap());
        issuer.set_duration(DAY);
        let settings = [vec![ENDLESS.to_owned()], files.arguments("--tls-client-ca", "server")];
        let learner = Learner::start(&folder.path().join("run"), &settings.concat());
        let proxy = Proxy::start(&learner.url);
        let url = format!("https://127.0.0.1:{}", proxy.port);
        let arguments = files.arguments("--tls-ca", "actor");
        let actor = Actor::start(folder.path(), "working", &url, &arguments);
        has_begun(&folder.path().join("run"));
        Self { folder, files, issuer, learner, actor, proxy }
    }

    /// Runs a command that connects to the learner with the actor's certificate.
    fn ask(&self, command: &str) -> (bool, String) {
        let more = self.files.arguments("--tls-ca", "actor");
        let more = more.iter().map(String::as_str);
        let arguments = [command, "--learner", &self.learner.url].into_iter().chain(more);
        let output = s2mia(&arguments.collect::<Vec<_>>());
        (output.status.success(), String::from_utf8(output.stderr).unwrap())
    }

    /// Waits until new connections are refused; the one of the actor remains.
    fn expires(&self) {
        eventually(|| match self.ask("health") {
            (false, _) => Ok(()),
            (true, _) => Err("the certificate has not expired".to_owned()),
        });
        goes_on(&self.folder.path().join("run"));
        assert!(!self.actor.log().contains("session ended"), "{}", self.actor.log());
    }

    /// Stops the run and compares it with an undisturbed one.
    fn end(mut self) {
        stopped(&mut self.learner, vec![self.actor]);
        ends_as_undisturbed(&self.folder.path().join("run"));
    }
}

#[test]
fn an_actor_whose_certificate_expires_keeps_its_connection_and_reconnects_with_a_renewed_one() {
    let guarded = Guarded::start("actor");
    guarded.expires();
    let (_, told) = guarded.ask("actor");
    assert!(told.contains("actor.pem expired at ") && told.lines().count() == 1, "{told}");
    guarded.proxy.cut();
    says(|| guarded.actor.log(), "actor.pem expired at ", 1);
    guarded.files.write("actor", &guarded.issuer.client(Role::Actor).unwrap());
    says(|| guarded.learner.log(), "actor registered", 2);
    goes_on(&guarded.folder.path().join("run"));
    guarded.end();
}

#[test]
fn a_learner_whose_certificate_expires_says_so_once_and_takes_up_a_renewed_one() {
    let guarded = Guarded::start("server");
    guarded.expires();
    let (_, told) = guarded.ask("actor");
    let why = "the learner's certificate is refused: certificate expired";
    assert!(told.contains(why) && told.lines().count() == 1, "{told}");
    let log = || {
        // The learner looks at its files when a connection begins.
        guarded.ask("health");
        guarded.learner.log()
    };
    says(log, "server.pem expired at ", 1);
    assert_eq!(log().matches("server.pem expired at ").count(), 1);
    guarded.files.write("server", &guarded.issuer.server(&NAMES.map(str::to_owned)).unwrap());
    eventually(|| match guarded.ask("health") {
        (true, _) => Ok(()),
        (false, why) => Err(format!("the renewed certificate is not in use: {why}")),
    });
    guarded.proxy.cut();
    says(|| guarded.learner.log(), "actor registered", 2);
    goes_on(&guarded.folder.path().join("run"));
    guarded.end();
}
