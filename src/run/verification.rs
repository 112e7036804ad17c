//! Computes parts of a run again, each from the seed or from a checkpoint, by training in a temporary folder, and compares the
//! results with those that the run recorded.

mod lines;

use std::collections::BTreeMap;
use std::hash::{BuildHasher as _, RandomState};
use std::path::{Path, PathBuf};

use actor::Transport;
use anyhow::{Context as _, ensure};
use learner::config::EPISODES_LIMIT;
use learner::observe::event::Event;
use learner::store::checkpoint::Loaded;
use learner::store::run_folder::{FOREIGN_ACTORS, METRICS, PROVENANCE, RunFolder, START_POLICIES};
use learner::train::provenance::BEGUN_AGAIN;
use proto::Digest;
use serde_json::Value;
use tokio::runtime::Runtime;
use tokio::sync::watch;

use crate::config::keys::SAMPLED;
use crate::config::run_config::RunConfig;
use crate::process::{self, output, runtime};
use crate::run::chosen::ProgramArguments;
use crate::run::recorded::Recorded;
use crate::run::run_path::Others;
use crate::run::verification::lines::same;
use crate::run::{self, BUILD, PreparedRun, session, start};

/// Iterations of a run that one start computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Part {
    /// The iteration of the checkpoint from which it is computed; 0: from the seed.
    pub(crate) start: u64,
    /// Its last iteration.
    pub(crate) end: u64,
}

/// What was computed again with the recorded results.
#[derive(Debug)]
pub(crate) struct Confirmed {
    /// SHA-256 of the weights after the last iteration of the part, hexadecimal.
    pub(crate) weights_sha256: String,
    /// Mean return of each evaluation, by its iteration.
    pub(crate) evaluations: BTreeMap<u64, f64>,
}

impl Part {
    /// Number of its iterations.
    pub(crate) fn length(self) -> u64 {
        self.end - self.start
    }

    /// From what it is computed, for messages.
    pub(crate) fn origin(self) -> String {
        match self.start {
            0 => "from the seed".to_owned(),
            start => format!("from the checkpoint of iteration {start}"),
        }
    }
}

/// The parts of a run with these checkpoints and this `last` recorded iteration: from each start to the next one.
pub(crate) fn parts(checkpoints: &[u64], last: u64) -> Vec<Part> {
    let starts = [0].into_iter().chain(checkpoints.iter().copied());
    let ends = checkpoints.iter().copied().chain([last]);
    starts.zip(ends).map(|(start, end)| Part { start, end }).collect()
}

/// The parts in an unpredictable order.
pub(crate) fn shuffled(mut parts: Vec<Part>) -> Vec<Part> {
    let secret = RandomState::new();
    parts.sort_by_cached_key(|part| secret.hash_one(part.start));
    parts
}

/// Cuts the parts to `count` iterations in all: each has as many as are left after those before it. The newest start
/// has at least one, be it after the end of the run: it shows that the policies are those of the weights, and repeats the
/// evaluation of them. Returns the parts with any iterations in the order of the run.
pub(crate) fn chosen(parts: Vec<Part>, count: u64) -> Vec<Part> {
    let newest = parts.iter().map(|part| part.start).max();
    let mut left = count;
    let mut chosen = Vec::new();
    for Part { start, end } in parts {
        let taken = left.min(end - start);
        left -= taken;
        let least = u64::from(newest == Some(start));
        chosen.push(Part { start, end: start + taken.max(least) });
    }
    chosen.retain(|part| part.length() > 0);
    chosen.sort_by_key(|part| part.start);
    chosen
}

/// Computes parts of a run again.
pub(crate) struct Verifier<'a> {
    recorded: &'a Recorded,
    at: &'a ProgramArguments,
    runtime: Runtime,
    stop: (watch::Sender<bool>, watch::Receiver<bool>),
    scratch: Scratch,
}

/// What one training of a part evaluates.
struct PartEvaluations {
    /// Whether actions are sampled.
    sampled: bool,
    /// Number of episodes by iteration.
    planned: BTreeMap<u64, u32>,
}

impl<'a> Verifier<'a> {
    /// A verifier that a signal stops; `at` is where the environment is.
    pub(crate) fn of(recorded: &'a Recorded, at: &'a ProgramArguments) -> anyhow::Result<Self> {
        let (runtime, stop, scratch) = (runtime()?, watch::channel(false), Scratch::make()?);
        let (stop_sender, folder) = (stop.0.clone(), scratch.0.clone());
        let announce = || output::error("stopping");
        let clean_up = move || remove(&folder);
        runtime.block_on(async {
            process::stop_or_exit(stop_sender, process::SIGNAL_WINDOW, announce, clean_up)
        })?;
        Ok(Self { recorded, at, runtime, stop, scratch })
    }

    /// Computes a part; `reached` is called with each finished iteration. A resume may have changed whether evaluations sample
    /// actions: a part with both kinds is computed twice.
    ///
    /// # Errors
    /// The part cannot be computed, or a result differs from the recorded one, which is named with what may be the reason.
    pub(crate) fn verify(
        &self,
        part: Part,
        reached: impl FnMut(u64) + Clone + Send + 'static,
    ) -> anyhow::Result<Confirmed> {
        let mut confirmed =
            Confirmed { weights_sha256: String::new(), evaluations: BTreeMap::new() };
        for evaluations in self.evaluations(part)? {
            let folder = self.scratch.0.join(format!("{}-{}", part.start, evaluations.sampled));
            let found = self.compute((part, &evaluations), &folder, reached.clone())?;
            if let Err(why) = self.compare((part, &evaluations), &found, &mut confirmed) {
                anyhow::bail!("{}; {}", actor::causes(why.as_ref()), self.reason(part)?);
            }
            remove(&folder);
        }
        Ok(confirmed)
    }

    /// The recorded evaluations of a part's policies, and of those of its first checkpoint, by whether they sample actions. There
    /// are those of the settings at least, even if they are none.
    fn evaluations(&self, part: Part) -> anyhow::Result<Vec<PartEvaluations>> {
        let mut kinds = BTreeMap::new();
        for (iteration, line) in self.recorded.evaluations.range(part.start..=part.end) {
            let count = &line["episodes"];
            let episodes = count.as_u64().and_then(|count| u32::try_from(count).ok());
            let possible = episodes.filter(|count| (1..=EPISODES_LIMIT).contains(count));
            let episodes = possible.with_context(|| {
                format!(
                    "the evaluation of iteration {iteration} in {METRICS} has {count} episodes, expected 1 to {EPISODES_LIMIT}"
                )
            })?;
            kinds
                .entry(line["sampled"] == true)
                .or_insert_with(BTreeMap::new)
                .insert(*iteration, episodes);
        }
        if kinds.is_empty() {
            let usual = self.recorded.settings_after(part.start)?.learner.evaluation.sampled;
            kinds.insert(usual, BTreeMap::new());
        }
        let kinds = kinds.into_iter();
        Ok(kinds.map(|(sampled, planned)| PartEvaluations { sampled, planned }).collect())
    }

    fn compute(
        &self,
        (part, evaluations): (Part, &PartEvaluations),
        folder: &Path,
        mut reached: impl FnMut(u64) + Send + 'static,
    ) -> anyhow::Result<Recorded> {
        let config = self.settings((part, evaluations.sampled), folder)?;
        let resumed = (part.start > 0).then_some(folder);
        if let Some(folder) = resumed {
            self.copy(part.start, folder, &config.resolved.to_toml())?;
        }
        let url = config.environment.url.clone();
        let prepared =
            run::prepare_config(config, resumed, Others::Refused, &Transport::PlainTextOnLoopback);
        let prepared = match url.as_str() {
            "" => prepared,
            url => prepared
                .with_context(|| format!("the program of its environment must run at {url}")),
        };
        let PreparedRun { config, mut launch, new: _new, .. } = prepared?;
        launch.until = part.end;
        launch.evaluations = Some(evaluations.planned.clone());
        let observer = Box::new(move |event: &Event| {
            if let Event::Iteration(report) = event {
                reached(report.iteration);
            }
        });
        let training = session::train(&config, launch, None, observer, self.stop.clone());
        let summary = self.runtime.block_on(training)?;
        ensure!(!summary.stopped_early, "it was stopped");
        Recorded::read(folder)
    }

    /// The settings at the start of a part, for a run in `folder` on this machine.
    fn settings(&self, (part, sampled): (Part, bool), folder: &Path) -> anyhow::Result<RunConfig> {
        let own = self.recorded.settings_after(part.start)?;
        let mut resolved = own.resolved;
        resolved.take_machine(&RunConfig::with(&[])?.resolved);
        resolved.set("run.dir", folder.display().to_string(), "verification");
        resolved.set(SAMPLED, sampled, "verification");
        start::take_kept(&mut resolved, &self.recorded.folder);
        self.at.replace(&mut resolved)?;
        Ok(RunConfig::build(resolved)?)
    }

    /// Makes `folder` a copy of the run as it was after an iteration with a checkpoint, without its evaluations.
    fn copy(&self, iteration: u64, folder: &Path, toml: &str) -> anyhow::Result<()> {
        RunFolder::claim_new(folder)?.begin(toml, &self.recorded.manifest)?;
        self.recorded.checkpoint(iteration)?.copy_to(folder, toml)?;
        let start = self.recorded.folder.join(START_POLICIES);
        if start.exists() {
            let copied = std::fs::copy(&start, folder.join(START_POLICIES));
            copied.with_context(|| format!("cannot copy {}", start.display()))?;
        }
        for (name, lines) in
            [(PROVENANCE, &self.recorded.provenance), (METRICS, &self.recorded.metrics)]
        {
            let text: String =
                lines.range(..=iteration).map(|(_, line)| format!("{line}\n")).collect();
            let file = folder.join(name);
            std::fs::write(&file, text)
                .with_context(|| format!("cannot write {}", file.display()))?;
        }
        Ok(())
    }

    fn compare(
        &self,
        (part, evaluations): (Part, &PartEvaluations),
        found: &Recorded,
        confirmed: &mut Confirmed,
    ) -> anyhow::Result<()> {
        let recorded = self.recorded;
        for iteration in part.start + 1..=part.end.min(recorded.last()) {
            for (file, old, new) in [
                (PROVENANCE, &recorded.provenance, &found.provenance),
                (METRICS, &recorded.metrics, &found.metrics),
            ] {
                same(file, "iteration", (iteration, old, new))?;
            }
        }
        self.compare_checkpoints(part, found)?;
        let weights = found.provenance[&part.end]["weights_sha256"].as_str().unwrap_or_default();
        weights.clone_into(&mut confirmed.weights_sha256);
        for iteration in evaluations.planned.keys() {
            let lines = (*iteration, &recorded.evaluations, &found.evaluations);
            same(METRICS, "the evaluation of iteration", lines)?;
            let mean = recorded.evaluations[iteration]["mean"].as_f64().unwrap_or(f64::NAN);
            confirmed.evaluations.insert(*iteration, mean);
        }
        Ok(())
    }

    /// Compares the policies of the first checkpoint of a part with those that its weights make, and its last checkpoint, if the
    /// run keeps it, with the state that was computed.
    fn compare_checkpoints(
        &self,
        Part { start, end }: Part,
        found: &Recorded,
    ) -> anyhow::Result<()> {
        let digest = |loaded: &Loaded| Digest::of(&loaded.checkpoint.policy).to_string();
        if start > 0 {
            let policy = digest(&self.recorded.checkpoint(start)?);
            let acting = &found.provenance[&(start + 1)]["behaviour"]["digest"];
            ensure!(
                *acting == *policy,
                "the policies in the checkpoint of iteration {start} have the SHA-256 {policy}, its weights make {acting}"
            );
        }
        if self.recorded.checkpoints.contains(&end) {
            let (old, new) = (self.recorded.checkpoint(end)?, found.checkpoint(end)?);
            let [state, recorded] = [&new, &old].map(|loaded| &loaded.manifest.state_sha256);
            ensure!(
                state == recorded,
                "the state after iteration {end} has the SHA-256 {state}, its checkpoint has {recorded}"
            );
            let [policy, recorded] = [&new, &old].map(digest);
            ensure!(
                policy == recorded,
                "the policies after iteration {end} have the SHA-256 {policy}, its checkpoint has {recorded}"
            );
        }
        Ok(())
    }

    /// Why two results of a part may differ: who computed them, and episodes that were not continued, of which a state after
    /// the last iteration may have the first step.
    fn reason(&self, part: Part) -> anyhow::Result<String> {
        let programs = self.programs()?;
        let mut lines = self.recorded.provenance.range(part.start + 1..=part.end + 1);
        Ok(match lines.find(|(_, line)| !line[BEGUN_AGAIN].is_null()) {
            None => programs,
            Some((iteration, line)) => format!(
                "{programs}; in iteration {iteration}, environments {} began new episodes because theirs could not be continued \
                 ({PROVENANCE}), which may not happen again",
                line[BEGUN_AGAIN]
            ),
        })
    }

    /// Who computed the two results that differ.
    fn programs(&self) -> anyhow::Result<String> {
        let builds = self.recorded.builds()?;
        let others: Vec<_> = builds.iter().filter(|build| **build != BUILD).cloned().collect();
        let foreign = self.recorded.manifest[FOREIGN_ACTORS] == Value::Bool(true);
        Ok(if !others.is_empty() {
            let others = others.join(", ");
            format!(
                "{others} computed the run, and this program is {BUILD}: another commit may compute other numbers, so use \
                 that one to verify it"
            )
        } else if foreign {
            "actors without a fingerprint took part, whose results may not be repeatable".to_owned()
        } else {
            format!("{BUILD} computed both")
        })
    }
}

/// Most attempts to remove a temporary folder.
const MOST_REMOVALS: usize = 100;

/// A temporary folder that is removed with this value.
struct Scratch(PathBuf);

impl Scratch {
    fn make() -> anyhow::Result<Self> {
        // Process numbers are used again.
        let random = RandomState::new().hash_one(std::process::id());
        let folder = std::env::temp_dir().join(format!("s2mia-verify-{random:016x}"));
        std::fs::create_dir(&folder)
            .with_context(|| format!("cannot make {}", folder.display()))?;
        Ok(Self(folder))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        remove(&self.0);
    }
}

/// Removes a temporary folder. The system does if this fails. Under its new name nothing is added meanwhile, but a thread that
/// still works may make the folder anew.
fn remove(folder: &Path) {
    let removed = folder.with_extension("removed");
    for _ in 0..MOST_REMOVALS {
        let _renamed = std::fs::rename(folder, &removed);
        let _removed = std::fs::remove_dir_all(&removed);
        if !folder.exists() && !removed.exists() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(start: u64, end: u64) -> Part {
        Part { start, end }
    }

    #[test]
    fn a_part_reaches_from_the_seed_or_a_checkpoint_to_the_next_one_or_the_end() {
        let all = [part(0, 800), part(800, 900), part(900, 1000), part(1000, 1000)];
        assert_eq!(parts(&[800, 900, 1000], 1000), all);
        assert_eq!(parts(&[4], 6), [part(0, 4), part(4, 6)], "a killed run");
        assert_eq!(parts(&[], 3), [part(0, 3)]);
        let mut mixed = shuffled(all.to_vec());
        mixed.sort_by_key(|part| part.start);
        assert_eq!(mixed, all);
    }

    #[test]
    fn parts_are_cut_in_their_order_and_the_newest_checkpoint_is_never_left_out() {
        let all = [part(900, 1000), part(1000, 1000), part(0, 800), part(800, 900)];
        let chosen = |count| chosen(all.to_vec(), count);
        assert_eq!(chosen(60), [part(900, 960), part(1000, 1001)]);
        assert_eq!(chosen(130), [part(0, 30), part(900, 1000), part(1000, 1001)]);
        let whole = [part(0, 800), part(800, 900), part(900, 1000), part(1000, 1001)];
        assert_eq!(chosen(5000), whole);
        assert_eq!(super::chosen(vec![part(0, 3)], 2), [part(0, 2)]);
    }
}
