//! Tests of logs and log tools. Slots are rolled out as in an actor, without a learner.

mod damage;
#[path = "../../../rollout/tests/rollout/fixture.rs"]
mod fixture;
mod several;
mod whole;
#[path = "../../../rollout/tests/rollout/work.rs"]
mod work;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use policy::{Draw, DrawKey, PolicySnapshot, Purpose, RunSeed};
use proto::{
    ActionChoice, Digest, EnvironmentStart, Episodes, EvaluationWork, Incarnation, Lease, LeaseId,
    PolicyVersion, RolloutWork, Start, TrajectoryChunk, WeightsName, Work,
};
use rollout::{EvaluationEpisode, StepEvent, play_episode};

use super::shares::{ReadShares, read_shares};
use super::source::read_bytes;
use super::{Log, LogConfig, LogHandle};
use crate::share::LoggedShare;
use fixture::{policy, task, world};
use work::{fresh_work, run};

pub(super) fn start(
    folder: &Path,
    actor: &str,
    episodes: Episodes,
    file_mib: u64,
) -> (Log, LogHandle) {
    let config = LogConfig { folder: folder.to_path_buf(), episodes, file_bytes: file_mib << 20 };
    let log = Log::start(&config, actor, 1).unwrap();
    let handle = log.handle(&Arc::new(run()), &task());
    (log, handle)
}

fn lease(work: Work) -> Lease {
    let weights = WeightsName { version: PolicyVersion(4), digest: Digest([7; 32]) };
    Lease { id: LeaseId(1), incarnation: Incarnation(1), weights, attempt: 1, work }
}

/// Rolls out a slot and logs it to `handle`; stops after `most` chunks.
fn roll(handle: &LogHandle, work: &RolloutWork, most: usize) -> Vec<TrajectoryChunk> {
    roll_with(&policy(), handle, work, most)
}

/// As [`roll`], with other policies.
fn roll_with(
    policy: &PolicySnapshot,
    handle: &LogHandle,
    work: &RolloutWork,
    most: usize,
) -> Vec<TrajectoryChunk> {
    let mut collector = handle.rollout(&lease(Work::Rollout(work.clone())), work);
    let mut chunks = Vec::new();
    let observe = |event: StepEvent<'_>| collector.observe(&event);
    rollout::roll_out(&run(), work, policy, &mut *world(), observe, |chunk| {
        chunks.push(chunk);
        if chunks.len() == most { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })
    .unwrap();
    handle.send(collector);
    chunks
}

const WHOLE: usize = usize::MAX;

/// The work of the next iteration, which continues `chunks`.
fn next_work(chunks: &[TrajectoryChunk]) -> RolloutWork {
    let end = chunks.last().unwrap().end.clone().unwrap();
    let start = |(position, state): (usize, Vec<u8>)| {
        let of = position * fixture::HIDDEN..(position + 1) * fixture::HIDDEN;
        let recurrent = end.recurrent.iter().map(|rows| rows[of.clone()].to_vec()).collect();
        let start = Start::Continue { state, recurrent };
        EnvironmentStart { environment: 6 + position as u32, start }
    };
    let environments = end.environments.iter().cloned().enumerate().map(start).collect();
    RolloutWork { iteration: 5, slot: 3, environments }
}

pub(super) fn evaluate(handle: &LogHandle, work: EvaluationWork) {
    let mut world = sim::environments(&task(), 1).unwrap();
    let key = DrawKey::of(RunSeed(3), Draw::of(Purpose::EvaluationReset));
    let lease = lease(Work::Evaluation(work));
    let (seed, EvaluationWork { iteration, episode: index }) = (RunSeed(run().seed), work);
    let episode = EvaluationEpisode { seed, iteration, index };
    let Some(mut collector) = handle.evaluation(&lease, episode) else { return };
    let start = (key, ActionChoice::Mean);
    play_episode(&mut *world, &policy(), start, |event| collector.observe(&event)).unwrap();
    handle.send(collector);
}

/// Files in a folder, sorted by name.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths
}

fn read(path: &Path) -> (ReadShares, Vec<LoggedShare>) {
    let mut shares = Vec::new();
    let log = read_shares(&read_bytes(path).unwrap(), |share| {
        shares.push(share);
        Ok(())
    });
    (log.unwrap(), shares)
}

/// Writes a log of one slot.
fn slot_log(folder: &Path) -> (PathBuf, Vec<TrajectoryChunk>) {
    let (log, handle) = start(folder, "a", Episodes::All, 64);
    let chunks = roll(&handle, &fresh_work(), WHOLE);
    log.close();
    (files(folder)[0].clone(), chunks)
}
