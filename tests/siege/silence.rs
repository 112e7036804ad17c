//! Connections that stall within a message, sixty of each kind.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::process::Command;
use std::time::{Duration, Instant};

use crate::frames;
use crate::learners::{Learner, inspect};
use crate::usage::Usage;

const EACH: usize = 60;
/// Maximum memory of the learner per stalled connection.
const MOST_MIB_EACH: f64 = 0.5;
/// Ten seconds for whoever has not begun, thirty for whoever has: one sign of life is asked for after twenty, and
/// waited for for ten. The rest is for a slow machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// What is sent before the connection stalls.
fn beginnings() -> [Vec<u8>; 4] {
    let half_a_preface = frames::BEGINNING[..11].to_vec();
    [Vec::new(), half_a_preface, frames::half_a_header_block(), frames::half_a_message()]
}

/// The first half of a client's first message of TLS: a header that announces more than comes.
fn half_a_handshake() -> Vec<u8> {
    vec![22, 3, 1, 2, 0, 1, 0, 1, 252, 3, 3, 7, 7, 7]
}

fn silent(url: &str, words: &[u8]) -> TcpStream {
    let address = url.split_once("://").unwrap().1;
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(words).unwrap();
    stream
}

fn crowd(url: &str, beginnings: &[Vec<u8>]) -> Vec<TcpStream> {
    let each = |words: &Vec<u8>| (0..EACH).map(|_| silent(url, words)).collect::<Vec<_>>();
    beginnings.iter().flat_map(each).collect()
}

/// Waits until the learner has closed all of them.
fn all_closed(crowd: Vec<TcpStream>, begun: Instant) {
    for mut stream in crowd {
        let left = PATIENCE.saturating_sub(begun.elapsed()).max(Duration::from_millis(1));
        stream.set_read_timeout(Some(left)).unwrap();
        // What the learner says before it closes is nothing to us; a reset is an end as well.
        let mut words = Vec::new();
        let end = stream.read_to_end(&mut words).map_err(|error| error.kind());
        let waiting = [std::io::ErrorKind::WouldBlock, std::io::ErrorKind::TimedOut];
        let open = end.is_err_and(|kind| waiting.contains(&kind));
        assert!(!open, "a silent connection is open after {:?}", begun.elapsed());
    }
}

fn costs_little(learner: &Learner, before: Usage, connections: usize) {
    let during = Usage::of(learner.process.id());
    let most = before.resident_mib as f64 + MOST_MIB_EACH * connections as f64;
    assert!(during.resident_mib as f64 <= most, "{before:?}, {during:?}");
    assert!(during.descriptors <= before.descriptors + connections + 16, "{before:?}, {during:?}");
}

fn peaceful(folder: &std::path::Path) -> serde_json::Value {
    let mut quiet = Learner::start(folder, &[]);
    quiet.finish(&[]);
    inspect(folder)
}

#[test]
fn whoever_stops_in_the_middle_is_let_go_in_time_and_the_run_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let besieged = folder.path().join("besieged");
    let mut learner = Learner::start(&besieged, &[]);
    let before = Usage::of(learner.process.id());
    let begun = Instant::now();
    let crowd = crowd(&learner.url, &beginnings());
    costs_little(&learner, before, crowd.len());
    all_closed(crowd, begun);
    let patience = Instant::now() + PATIENCE;
    while Usage::of(learner.process.id()).descriptors > before.descriptors + 8 {
        assert!(Instant::now() < patience, "descriptors of closed connections are still open");
        std::thread::yield_now();
    }
    let told = learner.finish(&[]);
    let silent = told.lines().filter(|line| line.contains("did not say who it is within 10 s"));
    assert_eq!(silent.count(), 2 * EACH, "{told}");
    assert_eq!(inspect(&besieged), peaceful(&folder.path().join("in-peace")));
}

#[test]
fn a_run_ends_with_the_same_weights_while_silent_connections_look_on() {
    let folder = tempfile::tempdir().unwrap();
    let besieged = folder.path().join("besieged");
    let mut learner = Learner::start(&besieged, &[]);
    let crowd = crowd(&learner.url, &beginnings());
    learner.finish(&[]);
    drop(crowd);
    assert_eq!(inspect(&besieged), peaceful(&folder.path().join("in-peace")));
}

#[test]
fn half_a_tls_handshake_is_let_go_in_time() {
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("certificates");
    let made = Command::new(env!("CARGO_BIN_EXE_s2mia")).arg("certs").arg(&own).output().unwrap();
    assert!(made.status.success());
    let file = |name: &str| own.join(name).to_str().unwrap().to_owned();
    let tls = [
        ("--tls-certificate", file("server.pem")),
        ("--tls-key", file("server.key")),
        ("--tls-client-ca", file("ca.pem")),
    ];
    let tls = tls.into_iter().flat_map(|(flag, path)| [flag.to_owned(), path]).collect::<Vec<_>>();
    let mut learner = Learner::start(&folder.path().join("run"), &tls);
    let before = Usage::of(learner.process.id());
    let begun = Instant::now();
    let crowd = crowd(&learner.url, &[Vec::new(), half_a_handshake()]);
    costs_little(&learner, before, crowd.len());
    all_closed(crowd, begun);
    learner.stop();
}
