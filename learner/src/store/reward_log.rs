//! The learner's part of a trajectory log: intrinsic rewards, which nobody knows before all of an iteration's steps
//! have come in and the densities are fitted on them. A thread of its own writes them. What it cannot take is lost and
//! counted: a log never holds training up.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use marl::Rewards;
use proto::{Digest, Episodes, ShareRewards, reward_log_name, rollout_episode_id};

use crate::durable::{self, FileError};
use crate::environments::Share;
use crate::error::LearnerError;

/// Iterations that may wait to be written.
const QUEUE: usize = 32;

/// The reward log of one start of the learner. Dropped, it waits until everything is on the disk.
#[derive(Debug)]
pub struct RewardLog {
    episodes: Episodes,
    /// `None` only while it is dropped.
    orders: Option<SyncSender<Vec<ShareRewards>>>,
    lost: Arc<AtomicU64>,
    /// Lost steps that have been told.
    told: u64,
    thread: Option<JoinHandle<()>>,
}

/// An iteration whose rewards are known.
#[derive(Clone, Copy, Debug)]
pub struct Paid<'a> {
    /// The iteration.
    pub iteration: u64,
    /// The snapshot that acted in it.
    pub weights: Digest,
    /// The run's settings and seed.
    pub config: Digest,
    /// What it consists of.
    pub shares: &'a [Share],
    /// Intrinsic, for each agent `[T, B]`.
    pub rewards: &'a Rewards,
    /// `B`
    pub environments: usize,
}

impl RewardLog {
    /// Starts the thread for a file in `folder`, which is made with the first line; `None` if no episode of training is
    /// logged.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn open(folder: &Path, episodes: Episodes) -> Result<Option<Self>, LearnerError> {
        if !episodes.include_rollouts() {
            return Ok(None);
        }
        let lost = Arc::new(AtomicU64::new(0));
        let (orders, queue) = sync_channel(QUEUE);
        // Each start of the learner writes a file of its own.
        let names = (1..).map(|start| folder.join(reward_log_name(start)));
        let path = names.into_iter().find(|path| !path.exists()).unwrap_or_default();
        let scribe = Scribe { path, file: None, broken: false, lost: Arc::clone(&lost) };
        let thread = std::thread::Builder::new().name("reward-log".to_owned());
        let thread = thread.spawn(move || scribe.work(&queue)).map_err(|error| {
            LearnerError::Threads { what: "the reward log's thread", detail: error.to_string() }
        })?;
        Ok(Some(Self { episodes, orders: Some(orders), lost, told: 0, thread: Some(thread) }))
    }

    /// Hands in an iteration: those of its shares that are logged.
    pub fn take(&self, paid: Paid<'_>) {
        let held = |share: &&Share| self.episodes.include_rollout(share.environment, share.episode);
        let shares = paid.shares.iter().filter(held);
        let lines: Vec<_> = shares.map(|share| paid.line(share)).collect();
        if lines.is_empty() {
            return;
        }
        let count = steps(&lines);
        let orders = self.orders.as_ref().expect("it is open until it is dropped");
        if orders.try_send(lines).is_err() {
            self.lost.fetch_add(count, Ordering::Relaxed);
        }
    }

    /// Steps lost since this was last asked.
    pub fn newly_lost(&mut self) -> u64 {
        let lost = self.lost.load(Ordering::Relaxed);
        lost - std::mem::replace(&mut self.told, lost)
    }
}

impl Drop for RewardLog {
    fn drop(&mut self) {
        self.orders = None;
        // It fails only if the thread has panicked, which has then been told.
        let _ended = self.thread.take().map(JoinHandle::join);
    }
}

impl Paid<'_> {
    fn line(&self, share: &Share) -> ShareRewards {
        let rows = share.slot_step..share.slot_step + share.steps;
        let row = |step: usize| step * self.environments + share.environment as usize;
        let finite = |reward: f32| reward.is_finite().then_some(reward);
        let agent =
            |rewards: &Vec<f32>| rows.clone().map(|step| finite(rewards[row(step)])).collect();
        let line = ShareRewards {
            episode_id: rollout_episode_id(share.environment, share.episode),
            first_step: share.first_step,
            iteration: self.iteration,
            weights_sha256: self.weights.to_string(),
            config_sha256: self.config.to_string(),
            intrinsic_reward: self.rewards.iter().map(agent).collect(),
            sha256: String::new(),
        };
        line.sealed()
    }
}

/// Steps that some lines are about.
fn steps(lines: &[ShareRewards]) -> u64 {
    lines.iter().map(|line| line.steps() as u64).sum()
}

/// The thread's side.
struct Scribe {
    path: PathBuf,
    file: Option<BufWriter<File>>,
    /// Nothing is written any more.
    broken: bool,
    lost: Arc<AtomicU64>,
}

impl Scribe {
    fn work(mut self, queue: &Receiver<Vec<ShareRewards>>) {
        while let Ok(lines) = queue.recv() {
            let written = if self.broken { Ok(false) } else { self.write(&lines).map(|()| true) };
            if !self.survive(written) {
                self.lost.fetch_add(steps(&lines), Ordering::Relaxed);
            }
        }
        let synced = self.file.as_ref().map_or(Ok(()), |file| file.get_ref().sync_data());
        let synced = synced.map_err(FileError::of("flush", &self.path));
        self.survive(synced.map(|()| true));
        let lost = self.lost.load(Ordering::Relaxed);
        if lost > 0 {
            tracing::warn!("the intrinsic rewards of {lost} logged steps are lost");
        }
    }

    /// The first failure ends the log, not the run.
    fn survive(&mut self, written: Result<bool, FileError>) -> bool {
        written.unwrap_or_else(|error| {
            tracing::warn!("the reward log ends here, training goes on: {error}");
            self.broken = true;
            false
        })
    }

    fn write(&mut self, lines: &[ShareRewards]) -> Result<(), FileError> {
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(create(&self.path)?),
        };
        let write = |file: &mut BufWriter<File>| {
            for line in lines {
                serde_json::to_writer(&mut *file, line)?;
                file.write_all(b"\n")?;
            }
            file.flush()
        };
        write(file).map_err(FileError::of("write", &self.path))
    }
}

fn create(path: &Path) -> Result<BufWriter<File>, FileError> {
    if let Some(folder) = path.parent() {
        durable::make_folder(folder)?;
    }
    let file = OpenOptions::new().write(true).create_new(true).open(path);
    Ok(BufWriter::new(file.map_err(FileError::of("make", path))?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two environments, three steps, one agent; environment 0 begins its second episode with the last step.
    const SHARES: [Share; 3] = [
        Share { environment: 0, episode: 0, first_step: 7, slot_step: 0, steps: 2 },
        Share { environment: 0, episode: 1, first_step: 0, slot_step: 2, steps: 1 },
        Share { environment: 1, episode: 4, first_step: 0, slot_step: 0, steps: 3 },
    ];

    fn paid(rewards: &Rewards) -> Paid<'_> {
        let weights = Digest([0xab; 32]);
        let config = Digest([0xcd; 32]);
        Paid { iteration: 5, weights, config, shares: &SHARES, rewards, environments: 2 }
    }

    fn rewards() -> Rewards {
        vec![vec![0.1, 10.0, 0.2, f32::NAN, 0.3, 30.0]]
    }

    fn open(folder: &Path, episodes: Episodes) -> RewardLog {
        RewardLog::open(folder, episodes).unwrap().expect("something is logged")
    }

    fn read(folder: &Path) -> Vec<ShareRewards> {
        let text = std::fs::read_to_string(folder.join("rewards-0001.jsonl")).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    #[test]
    fn every_share_s_rewards_are_those_of_its_environment_and_steps() {
        let folder = tempfile::tempdir().unwrap();
        let logs = folder.path().join("logs");
        let mut log = open(&logs, Episodes::All);
        log.take(paid(&rewards()));
        assert_eq!(log.newly_lost(), 0);
        drop(log);
        let found = read(&logs);
        let ids: Vec<_> = found.iter().map(|line| (&*line.episode_id, line.first_step)).collect();
        assert_eq!(ids, [("rollout-0-0", 7), ("rollout-0-1", 0), ("rollout-1-4", 0)]);
        let rewards: Vec<_> = found.iter().map(|line| line.intrinsic_reward[0].clone()).collect();
        let expected =
            [vec![Some(0.1), Some(0.2)], vec![Some(0.3)], vec![Some(10.0), None, Some(30.0)]];
        assert_eq!(rewards, expected);
        for line in &found {
            assert_eq!((line.iteration, line.check()), (5, Ok(())));
            assert_eq!(line.weights_sha256, "ab".repeat(32));
            assert_eq!(line.config_sha256, "cd".repeat(32));
        }
    }

    #[test]
    fn episodes_that_actors_do_not_log_are_left_out() {
        let folder = tempfile::tempdir().unwrap();
        open(folder.path(), Episodes::Every(2)).take(paid(&rewards()));
        let found: Vec<_> = read(folder.path()).into_iter().map(|line| line.episode_id).collect();
        assert_eq!(found, ["rollout-0-0"]);
        let none = RewardLog::open(folder.path(), Episodes::Evaluation).unwrap();
        assert!(none.is_none(), "evaluations are not learnt from");
    }

    #[test]
    fn a_file_that_cannot_be_made_costs_the_log_and_nothing_else() {
        let log = open(Path::new("/dev/null/logs"), Episodes::All);
        let lost = Arc::clone(&log.lost);
        log.take(paid(&rewards()));
        log.take(paid(&rewards()));
        drop(log);
        assert_eq!(lost.load(Ordering::Relaxed), 12);
    }

    #[test]
    fn a_full_queue_loses_what_comes_and_holds_nobody_up() {
        let (orders, waiting) = sync_channel(1);
        let lost = Arc::default();
        let mut log = RewardLog {
            episodes: Episodes::All,
            orders: Some(orders),
            lost,
            told: 0,
            thread: None,
        };
        for _ in 0..3 {
            log.take(paid(&rewards()));
        }
        assert_eq!(log.newly_lost(), 12, "one waits, two iterations of six steps are lost");
        assert_eq!(log.newly_lost(), 0, "they are told once");
        assert_eq!(waiting.try_iter().count(), 1);
    }
}
