//! The same run without network: with the trainer, slot table and checks, but with actors as threads that call the
//! exchange.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::thread::{Builder, scope};
use std::time::Duration;

use learner::lease::exchange::Exchange;
use learner::lease::slots::{ConnectionId, Preview, ResultPart};
use learner::train::environments::Environments;
use learner::train::prepare::prepare;
use learner::train::trainer::Outside;
use policy::PolicySnapshot;
use proto::{
    Lease, LeaseAnswer, PROTOCOL_VERSION, PushHeader, Registration, RolloutWork, RunDescription,
    TrajectoryChunk, Work,
};

use crate::iteration::IterationLog;
use crate::settings::CaseSettings;
use crate::update::Updates;

/// Rollout threads.
pub(crate) const ACTORS: usize = 2;

fn per_slot(settings: &CaseSettings) -> usize {
    settings.learner.environments.per_slot
}

/// The first slot of a new run, with the policies and the environments that roll it out.
pub(crate) struct FirstSlot {
    pub(crate) run: RunDescription,
    pub(crate) work: RolloutWork,
    pub(crate) policy: PolicySnapshot,
    world: Box<dyn sim::EnvironmentBatch>,
}

impl FirstSlot {
    pub(crate) fn of(settings: &CaseSettings) -> anyhow::Result<Self> {
        let folder = tempfile::tempdir()?;
        let (_trainer, run) = prepare(settings.launch(folder.path(), 1)?)?;
        let policy = Updates::new(settings, &settings.problem()?, 1)?.snapshot()?;
        let count = per_slot(settings);
        let environments = Environments::fresh(&run, count, settings.learner.environments.phase);
        let work = environments.work(0, count).remove(0);
        Ok(Self { run, work, policy, world: settings.world(count)? })
    }

    pub(crate) fn roll_out(&mut self) -> Vec<TrajectoryChunk> {
        roll_out(&self.run, &self.work, &self.policy, &mut *self.world)
    }
}

/// Rolls out all chunks of a slot.
pub(crate) fn roll_out(
    run: &RunDescription,
    work: &RolloutWork,
    policy: &PolicySnapshot,
    world: &mut dyn sim::EnvironmentBatch,
) -> Vec<TrajectoryChunk> {
    let mut chunks = Vec::new();
    let keep = |chunk| {
        chunks.push(chunk);
        ControlFlow::Continue(())
    };
    rollout::roll_out(run, work, policy, world, |_| {}, keep).expect("the lease is the learner's");
    chunks
}

/// Iterations of the real trainer, with actors in the same process.
pub(crate) fn through_the_exchange(
    settings: &CaseSettings,
    folder: &Path,
    iterations: usize,
) -> anyhow::Result<IterationLog> {
    let launch = settings.launch(folder, iterations)?;
    let (trainer, description) = prepare(launch)?;
    let (lease, audit) = (settings.learner.lease, settings.learner.audit);
    let exchange = Exchange::new(description, lease, audit, settings.decoder()?);
    let log = IterationLog::default();
    let outside = Outside {
        exchange: Arc::clone(&exchange),
        observer: log.observer(),
        stop: Box::new(|| false),
    };
    let running = trainer.begin(outside)?;
    scope(|scope| {
        for index in 0..ACTORS {
            let exchange = &exchange;
            let work = move || act(exchange, ConnectionId(index as u64), settings);
            Builder::new().name("actor".to_owned()).spawn_scoped(scope, work)?;
        }
        let trained = running.train();
        exchange.finish();
        trained?;
        Ok(log)
    })
}

/// Runs an actor on this thread.
fn act(exchange: &Exchange, connection: ConnectionId, settings: &CaseSettings) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build();
    let runtime = runtime.expect("a runtime without sockets can be built");
    let run = exchange.run.clone();
    let own = exchange.register(connection, &registration(&run)).expect("it is this program");
    let mut world = settings.world(per_slot(settings)).expect("the task is known");
    loop {
        let answer =
            exchange.lease(connection, own.actor, own.incarnation, Duration::from_secs(10));
        match runtime.block_on(answer).expect("the actor is registered") {
            LeaseAnswer::Lease(lease) => perform(exchange, connection, &run, &lease, &mut *world),
            LeaseAnswer::Retry { .. } => {}
            LeaseAnswer::Done => break,
        }
    }
    exchange.disconnect(connection);
}

/// The registration of an actor of this program.
pub(crate) fn registration(run: &RunDescription) -> Registration {
    Registration {
        client: "speed".to_owned(),
        build: run.build.clone(),
        protocol_version: PROTOCOL_VERSION,
        environment: run.environment.clone(),
        rollout_fingerprint: Some(run.rollout_fingerprint),
        process: None,
    }
}

fn perform(
    exchange: &Exchange,
    connection: ConnectionId,
    run: &RunDescription,
    lease: &Lease,
    world: &mut dyn sim::EnvironmentBatch,
) {
    let Work::Rollout(work) = &lease.work else { return };
    let Ok(weights) = exchange.weights(lease.weights) else { return };
    let policy = PolicySnapshot::from_bytes(&weights.bytes).expect("the learner's own bytes");
    let origin = work.origin();
    let send = |chunk: TrajectoryChunk| {
        let header = PushHeader::of(lease, chunk.digest(&origin));
        // The backup of a slot that another actor has finished is refused.
        match exchange.expected(connection, &header, Some(chunk.sequence)) {
            Ok(Preview::Next(check))
                if check.chunk(&chunk, work, run, &exchange.states).is_ok()
                    && exchange
                        .take(connection, &header, &check, ResultPart::Chunk(chunk))
                        .is_ok() =>
            {
                ControlFlow::Continue(())
            }
            _ => ControlFlow::Break(()),
        }
    };
    rollout::roll_out(run, work, &policy, world, |_| {}, send).expect("the lease is the learner's");
}
