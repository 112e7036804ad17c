//! Connections that stall within a message, sixty of each kind.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::{ProcessUsage, UNDISTURBED, http2_frames, learner};
use crate::certificates::Certificates;
use crate::processes::{Learner, until};
use crate::runs::{Runs, inspect, words};

const EACH: usize = 60;
/// Maximum memory of the learner per stalled connection.
const MOST_MIB_EACH: f64 = 0.5;
/// The learner closes a connection without a handshake after 10 s, and one that does not answer a keepalive ping after
/// 30 s. The rest is for a slow machine.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Bytes sent before a connection stalls.
fn first_bytes() -> [Vec<u8>; 4] {
    let half_a_preface = http2_frames::FIRST_BYTES[..11].to_vec();
    [
        Vec::new(),
        half_a_preface,
        http2_frames::half_a_header_block(),
        http2_frames::half_a_message(),
    ]
}

/// The first half of a TLS client hello: its header announces more bytes than follow.
fn half_a_handshake() -> Vec<u8> {
    vec![22, 3, 1, 2, 0, 1, 0, 1, 252, 3, 3, 7, 7, 7]
}

fn stalled(url: &str, words: &[u8]) -> TcpStream {
    let address = url.split_once("://").unwrap().1;
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(words).unwrap();
    stream
}

fn stalled_connections(url: &str, first_bytes: &[Vec<u8>]) -> Vec<TcpStream> {
    let each = |words: &Vec<u8>| (0..EACH).map(|_| stalled(url, words)).collect::<Vec<_>>();
    first_bytes.iter().flat_map(each).collect()
}

/// Waits until the learner has closed all connections.
fn all_closed(connections: Vec<TcpStream>, begun: Instant) {
    for mut stream in connections {
        let left = TIMEOUT.saturating_sub(begun.elapsed()).max(Duration::from_millis(1));
        stream.set_read_timeout(Some(left)).unwrap();
        // Any data before the end is ignored; a reset also counts as closed.
        let mut words = Vec::new();
        let end = stream.read_to_end(&mut words).map_err(|error| error.kind());
        let waiting = [std::io::ErrorKind::WouldBlock, std::io::ErrorKind::TimedOut];
        let open = end.is_err_and(|kind| waiting.contains(&kind));
        assert!(!open, "a stalled connection is still open after {:?}", begun.elapsed());
    }
}

fn uses_little(learner: &Learner, before: ProcessUsage, connections: usize) {
    let during = ProcessUsage::of(learner);
    let most = before.resident_mib as f64 + MOST_MIB_EACH * connections as f64;
    assert!(during.resident_mib as f64 <= most, "{before:?}, {during:?}");
    assert!(during.descriptors <= before.descriptors + connections + 16, "{before:?}, {during:?}");
}

#[test]
fn stalled_connections_are_closed_in_time_and_the_run_continues() {
    let runs = Runs::new();
    let attacked = runs.folder("attacked");
    let mut learner = learner(&attacked, &[]);
    let before = ProcessUsage::of(&learner);
    let begun = Instant::now();
    let connections = stalled_connections(&learner.url, &first_bytes());
    uses_little(&learner, before, connections.len());
    all_closed(connections, begun);
    until("descriptors of closed connections are free", || {
        ProcessUsage::of(&learner).descriptors <= before.descriptors + 8
    });
    let log = learner.finish(&[]);
    let closed = log.lines().filter(|line| line.contains("no handshake within 10 s"));
    assert_eq!(closed.count(), 2 * EACH, "{log}");
    assert_eq!(inspect(&attacked), *UNDISTURBED);
}

#[test]
fn stalled_connections_do_not_affect_the_weights() {
    let runs = Runs::new();
    let attacked = runs.folder("attacked");
    let mut learner = learner(&attacked, &[]);
    let connections = stalled_connections(&learner.url, &first_bytes());
    learner.finish(&[]);
    drop(connections);
    assert_eq!(inspect(&attacked), *UNDISTURBED);
}

#[test]
fn half_a_tls_handshake_is_closed_in_time() {
    let runs = Runs::new();
    let tls = Certificates::make(runs.folder("certificates")).of_learner();
    let mut learner = learner(&runs.folder("run"), &words(&tls));
    let before = ProcessUsage::of(&learner);
    let begun = Instant::now();
    let connections = stalled_connections(&learner.url, &[Vec::new(), half_a_handshake()]);
    uses_little(&learner, before, connections.len());
    all_closed(connections, begun);
    learner.process.stop();
}
