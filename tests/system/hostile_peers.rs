//! A learner with hostile peers: invalid messages, many peers, stalled connections.
//! Its memory and descriptors stay bounded, it logs each incident, and it ends with the weights of an undisturbed run.

mod attackers;
mod http2_frames;
mod invalid_messages;
mod many_peers;
mod resource_limits;
mod stalled_connections;

use std::path::Path;
use std::sync::LazyLock;

use serde_json::Value;

use crate::processes::Learner;
use crate::runs::{Runs, SHORT, inspect};

/// The state in which a run ends without disturbance; it is trained once.
static UNDISTURBED: LazyLock<Value> = LazyLock::new(|| {
    let runs = Runs::new();
    let run = runs.folder("run");
    learner(&run, &[]).finish(&[]);
    inspect(&run)
});

/// The learner of a short run with two agents.
fn learner(folder: &Path, more: &[&str]) -> Learner {
    Learner::start(folder, &[&SHORT[..], &["task=halfcheetah-2x3"], more].concat())
}

/// Lets a valid actor do all the work while the peers stay connected.
async fn finished(mut learner: Learner) {
    tokio::task::spawn_blocking(move || learner.finish(&[])).await.unwrap();
}

/// Memory and descriptors of a process, from the operating system.
#[derive(Clone, Copy, Debug)]
struct ProcessUsage {
    resident_mib: u64,
    descriptors: usize,
}

impl ProcessUsage {
    fn of(learner: &Learner) -> Self {
        let process = learner.process.process.id();
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
        let kib: u64 = line.split_whitespace().nth(1).unwrap().parse().unwrap();
        let descriptors = std::fs::read_dir(format!("/proc/{process}/fd")).unwrap().count();
        Self { resident_mib: kib / 1024, descriptors }
    }
}
