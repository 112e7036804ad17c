//! Load of one learner with many actors: throughput, processor time and memory by number of actors. The actors do not
//! step environments; each sends the same recorded slot, whose log-densities the learner checks as usual. The policies
//! do not change, because the learning rate is negligible and nothing is scaled by running statistics.

use std::io::{BufRead as _, BufReader};
use std::net::Ipv4Addr;
use std::process::{Child, Stdio};
use std::sync::Arc;

use anyhow::{Context as _, bail};
use policy::PolicySnapshot;
use prost::Message as _;
use proto::wire::get_weights_response::Part;
use proto::wire::learner_service_client::LearnerServiceClient;
use proto::wire::push_trajectory_request::Content;
use proto::{
    Lease, LeaseAnswer, PushHeader, Registered, Registration, RunDescription, TrajectoryChunk,
    WeightsName, Work, wire,
};
use tokio::sync::OnceCell;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status};

use crate::Effort;
use crate::clock::median;
use crate::end_to_end::{COLD, Watched, watch};
use crate::run_in_process::{registration, roll_out};
use crate::settings::{CaseSettings, program};
use crate::table::CaseRow;

const SLOTS: usize = 256;
const STEPS: usize = 200;
/// Actors for each address of the loopback network; a learner accepts 512 connections from one.
const ACTORS_PER_ADDRESS: usize = 256;

/// One environment per slot, and minimal training.
const SETTINGS: [&str; 14] = [
    "halfcheetah-2x3",
    "environments.count=256",
    "environments.per_slot=1",
    "environments.steps=200",
    "observation.norm=none",
    "critic.state_norm=none",
    "evaluation.every_steps=0",
    "update.learning_rate=1e-30",
    "update.epochs=1",
    "critic.epochs=1",
    "influence.lambda=0",
    "surprise.alpha=0",
    "environments.phase=lockstep",
    "learner.threads=2",
];

/// A recorded slot as encoded messages.
struct Recording {
    chunks: Vec<(TrajectoryChunk, wire::TrajectoryChunk)>,
    bytes: usize,
}

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    effort.actors.iter().map(|&actors| row(actors, effort)).collect()
}

fn row(actors: usize, effort: Effort) -> anyhow::Result<CaseRow> {
    let folder = tempfile::tempdir()?;
    let dir = format!("run.dir={}", folder.path().join("run").display());
    let length = format!("run.iterations={}", COLD + effort.iterations.min(3));
    let own = [&SETTINGS[..], &[&*dir, &*length]].concat();
    let mut learner = program(&[&["learner", "--listen=127.0.0.1:0"], own.as_slice()].concat())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()?;
    let url = address(&mut learner)?;
    let settings = CaseSettings::of(&own)?;
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    let recording = Arc::new(OnceCell::new());
    // One after the other: a learner keeps only 256 connections without an actor.
    let registered = (0..actors).map(|index| runtime.block_on(Actor::register(&url, index)));
    for mut actor in registered.collect::<anyhow::Result<Vec<_>>>()? {
        let (settings, recording) = (settings.clone(), Arc::clone(&recording));
        // A failed call ends an actor, like the end of the run.
        runtime.spawn(async move { actor.work(&settings, &recording).await.ok() });
    }
    let watched = watch(learner, &folder.path().join("run/metrics.jsonl"))?;
    let bytes = recording.get().map_or(0, |recording: &Recording| recording.bytes) * SLOTS;
    Ok(CaseRow { case: format!("{actors} actors"), figures: figures(&watched, bytes as f64) })
}

fn figures(watched: &Watched, bytes: f64) -> Vec<(&'static str, f64)> {
    let collected = median(watched.values_of("rollout_secs"));
    vec![
        ("iteration, s", median(watched.lasted())),
        ("collected in, s", collected),
        ("MB/s", bytes / 1e6 / collected),
        ("env steps/s", (SLOTS * STEPS) as f64 / collected),
        ("update, s", median(watched.values_of("update_secs"))),
        ("learner, processor s", median(watched.used())),
        ("actors, processor s", median(watched.used_here())),
        ("learner, MB", watched.learner),
    ]
}

/// The learner's URL: the last word of its first line.
fn address(learner: &mut Child) -> anyhow::Result<String> {
    let stdout = learner.stdout.take().context("the learner's output is not piped")?;
    let mut first = String::new();
    BufReader::new(stdout).read_line(&mut first)?;
    Ok(first.split_whitespace().last().context("the learner printed no address")?.to_owned())
}

/// A registered actor.
struct Actor {
    service: LearnerServiceClient<Channel>,
    run: RunDescription,
    own: Registered,
}

impl Actor {
    async fn register(url: &str, index: usize) -> anyhow::Result<Self> {
        let address = Ipv4Addr::from_bits(
            Ipv4Addr::LOCALHOST.to_bits() + (index / ACTORS_PER_ADDRESS) as u32,
        );
        let endpoint = Endpoint::from_shared(url.to_owned())?.local_address(Some(address.into()));
        let mut service = LearnerServiceClient::new(endpoint.connect().await?);
        let answer = service.describe_run(wire::DescribeRunRequest {}).await?.into_inner();
        let run = RunDescription::from_wire(answer.run)?;
        // The recording has the random draws of another slot, so only an actor without a fingerprint may send it.
        let foreign = Registration { rollout_fingerprint: None, ..registration(&run) };
        let registered = service.register(foreign.to_wire()).await?.into_inner();
        let own = Registered::from_wire(&registered);
        Ok(Self { service, run, own })
    }

    /// Sends results until the run is over.
    async fn work(
        &mut self,
        settings: &CaseSettings,
        recording: &OnceCell<Recording>,
    ) -> anyhow::Result<()> {
        loop {
            let request = wire::LeaseSlotsRequest {
                actor_id: self.own.actor.0,
                incarnation: self.own.incarnation.0,
                wait_millis: 10_000,
                log_steps_lost: 0,
            };
            let answer = self.service.lease_slots(request).await?.into_inner();
            let lease = match LeaseAnswer::from_wire(answer, &self.run)? {
                LeaseAnswer::Lease(lease) => lease,
                LeaseAnswer::Retry { .. } => continue,
                LeaseAnswer::Done => return Ok(()),
            };
            let recorded = record(self.service.clone(), settings, &self.run, &lease);
            let recording = recording.get_or_try_init(|| recorded).await?;
            // Another actor may have finished a copy of the slot first.
            if let Err(status) = push(&mut self.service, &lease, recording).await
                && status.code() != Code::Aborted
            {
                return Err(status.into());
            }
        }
    }
}

/// Sends the slot and waits for its last acknowledgement.
async fn push(
    service: &mut LearnerServiceClient<Channel>,
    lease: &Lease,
    recording: &Recording,
) -> Result<(), Status> {
    let Work::Rollout(work) = &lease.work else { return Ok(()) };
    let origin = work.origin();
    let messages: Vec<_> = recording
        .chunks
        .iter()
        .map(|(chunk, message)| {
            let header = PushHeader::of(lease, chunk.digest(&origin));
            header.to_wire(Content::Chunk(message.clone()))
        })
        .collect();
    let mut answers = service.push_trajectory(tokio_stream::iter(messages)).await?.into_inner();
    while let Some(answer) = answers.message().await? {
        if answer.lease_finished {
            break;
        }
    }
    Ok(())
}

/// Rolls out one slot with the leased weights.
async fn record(
    service: LearnerServiceClient<Channel>,
    settings: &CaseSettings,
    run: &RunDescription,
    lease: &Lease,
) -> anyhow::Result<Recording> {
    let Work::Rollout(work) = &lease.work else { bail!("the run has no evaluations") };
    let policy = weights(service, lease.weights).await?;
    let mut world = settings.world(settings.learner.environments.per_slot)?;
    let played = roll_out(run, work, &policy, &mut *world);
    let both = |chunk: TrajectoryChunk| {
        let message = chunk.to_wire(run, &work.origin()).0;
        (chunk, message)
    };
    let chunks: Vec<_> = played.into_iter().map(both).collect();
    let bytes = chunks.iter().map(|(_, message)| message.encoded_len()).sum();
    Ok(Recording { chunks, bytes })
}

async fn weights(
    mut service: LearnerServiceClient<Channel>,
    name: WeightsName,
) -> anyhow::Result<PolicySnapshot> {
    let request = wire::GetWeightsRequest { weights: Some(name.to_wire()), repeats: false };
    let mut parts = service.get_weights(request).await?.into_inner();
    let mut bytes = Vec::new();
    while let Some(part) = parts.message().await? {
        if let Some(Part::Data(data)) = part.part {
            bytes.extend_from_slice(&data);
        }
    }
    Ok(PolicySnapshot::from_bytes(&bytes)?)
}
