//! Actor threads that step the hopper for an exchange until the run is done.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use learner::lease::exchange::Exchange;
use learner::lease::slots::{ConnectionId, Preview, ResultPart};
use policy::PolicySnapshot;
use proto::{
    Ack, Lease, LeaseAnswer, PROTOCOL_VERSION, PushHeader, Refusal, Registered, Registration,
    RunDescription, TrajectoryChunk, Work,
};

use crate::hopper;

/// Running actor threads.
pub(crate) struct ActorThreads {
    threads: Vec<JoinHandle<()>>,
    stop: Arc<AtomicBool>,
}

impl ActorThreads {
    /// Starts an actor on each of these connections.
    pub(crate) fn start(connections: Range<u64>, exchange: &Arc<Exchange>) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let start = |index| {
            let (exchange, stop) = (Arc::clone(exchange), Arc::clone(&stop));
            let thread = std::thread::Builder::new().name(format!("actor-{index}"));
            thread.spawn(move || work(&exchange, ConnectionId(index), &stop)).unwrap()
        };
        Self { threads: connections.map(start).collect(), stop }
    }

    /// Stops all actors.
    pub(crate) fn end(self) {
        self.stop.store(true, Ordering::Relaxed);
        self.threads.into_iter().for_each(|thread| thread.join().unwrap());
    }
}

fn work(exchange: &Exchange, connection: ConnectionId, stop: &AtomicBool) {
    let run = exchange.run.clone();
    let own = exchange.register(connection, &registration(&run)).unwrap();
    while !stop.load(Ordering::Relaxed) {
        match ask(exchange, connection, own, Duration::from_millis(50)) {
            LeaseAnswer::Lease(lease) => perform(exchange, connection, &run, &lease),
            LeaseAnswer::Retry { .. } => {}
            LeaseAnswer::Done => break,
        }
    }
    exchange.disconnect(connection);
}

/// Requests a lease and waits this long for one.
pub(crate) fn ask(
    exchange: &Exchange,
    connection: ConnectionId,
    own: Registered,
    wait: Duration,
) -> LeaseAnswer {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
    runtime.block_on(exchange.lease(connection, own.actor, own.incarnation, wait)).unwrap()
}

/// Registers with the run's fingerprint.
pub(crate) fn registration(run: &RunDescription) -> Registration {
    Registration {
        client: "test".to_owned(),
        build: run.build.clone(),
        protocol_version: PROTOCOL_VERSION,
        environment: hopper::environment(),
        rollout_fingerprint: Some(run.rollout_fingerprint),
        process: None,
    }
}

/// Computes a lease and sends the results. The learner refuses results that arrive after its stop.
fn perform(exchange: &Exchange, connection: ConnectionId, run: &RunDescription, lease: &Lease) {
    let Ok(weights) = exchange.weights(lease.weights) else { return };
    let policy = PolicySnapshot::from_bytes(&weights.bytes).unwrap();
    match &lease.work {
        Work::Rollout(work) => {
            for chunk in hopper::roll_out(run, &policy, work) {
                let header = PushHeader::of(lease, chunk.digest(&work.origin()));
                if push(exchange, connection, &header, chunk).is_err() {
                    return;
                }
            }
        }
        Work::Evaluation(work) => {
            let result = hopper::evaluate(run, &policy, work);
            let header = PushHeader::of(lease, result.digest(work.iteration));
            if let Ok(Preview::Next(check)) = exchange.expected(connection, &header, None) {
                let _late = exchange.take(connection, &header, &check, ResultPart::Episode(result));
            }
        }
    }
}

/// Checks and takes in a chunk of a slot, as the service does.
pub(crate) fn push(
    exchange: &Exchange,
    connection: ConnectionId,
    header: &PushHeader,
    chunk: TrajectoryChunk,
) -> Result<Ack, Refusal> {
    let check = match exchange.expected(connection, header, Some(chunk.sequence))? {
        Preview::Repeated(ack) => return Ok(ack),
        Preview::Next(check) => check,
    };
    let Work::Rollout(slot) = &*check.assignment.work else { panic!("{check:?} is of an episode") };
    check.chunk(&chunk, slot, &exchange.run, &exchange.states)?;
    exchange.take(connection, header, &check, ResultPart::Chunk(chunk))
}
