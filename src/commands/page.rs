//! `s2mia page`: the web page of runs, finished or growing, from nothing but their folders.

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::Args;
use learner::observe::metrics::{self, Curves, MeasuredReturn};
use learner::observe::snapshot::FilmedEpisode;
use learner::serve::page::{EpisodeName, RunFacts, Runs, ShownRun};
use learner::store::json_lines::JsonLinesReader;
use learner::store::run_folder::{METRICS, RunFolder};
use learner::store::{checkpoint, plain_file};
use proto::{ActionChoice, EvaluationResult, PolicyVersion};
use rollout::FilmRecorder;

use crate::commands::film;
use crate::endpoints::PageAccess;
use crate::errors::Usage;
use crate::figures::learning_curve::{self, Curve};
use crate::process::{output, runtime};
use crate::run::chosen::{self, Which};
use crate::run::{self, run_path, stored};

/// `s2mia page`
#[derive(Args, Debug)]
pub(crate) struct RunsPageArguments {
    /// Run folders, finished or growing [default: all runs in ./runs].
    #[arg(value_name = "RUN")]
    pub(crate) runs: Vec<PathBuf>,
    /// Address of the page; port 0 selects a free port.
    #[arg(
        long,
        value_name = "ADDRESS",
        default_value = "127.0.0.1:0",
        value_parser = crate::endpoints::address
    )]
    pub(crate) listen: SocketAddr,
    /// Access.
    #[command(flatten)]
    pub(crate) access: PageAccess,
}

/// How often the metrics are read, at most.
const LOOK_AGAIN: Duration = Duration::from_secs(1);
/// Number of episodes that can be chosen of each checkpoint.
const EPISODES: u32 = 1000;

/// Serves the page until the process is stopped.
pub(super) fn run(arguments: &RunsPageArguments) -> anyhow::Result<()> {
    let RunsPageArguments { listen, access, .. } = arguments;
    let permission =
        "pass --insecure-allow-remote-page to allow that, and --page-host with the names they use";
    access.check("--listen", *listen, permission)?;
    let folders =
        if arguments.runs.is_empty() { run_path::all_runs()? } else { arguments.runs.clone() };
    folders.iter().try_for_each(|folder| run_path::demand_run(folder))?;
    let folders: Vec<_> = folders.iter().map(|folder| RunFolder::of(folder)).collect();
    demand_distinct(&folders)?;
    let stored = StoredRuns {
        followed: Mutex::new(Followed::of(&folders)),
        folders,
        played: Mutex::default(),
    };
    runtime()?.block_on(async {
        let advice = "choose another port, or 0 for any free one";
        let page = access.open(("--listen", *listen), advice, None).await?;
        // Without its printed address the page is useless.
        output::finish()?;
        learner::serve::page::serve(page, Arc::new(stored)).await;
        Ok(())
    })
}

/// Refuses a folder that is named twice: curves and legend are known by their run's name.
fn demand_distinct(folders: &[PathBuf]) -> Result<(), Usage> {
    let mut known = BTreeSet::new();
    match folders.iter().find(|folder| !known.insert(*folder)) {
        None => Ok(()),
        Some(twice) => {
            let why = "is named twice; name each run once";
            Err(Usage::new(format!("{} {why}", twice.display())))
        }
    }
}

/// The runs in folders.
struct StoredRuns {
    folders: Vec<PathBuf>,
    followed: Mutex<Followed>,
    /// The newest played episode, which is requested again if the browser did not wait for it. Locked while an episode is
    /// played, so that requests cannot occupy more than one core.
    played: Mutex<Option<Played>>,
}

/// A played episode.
struct Played {
    run: usize,
    name: EpisodeName,
    film: Arc<FilmedEpisode>,
}

impl Runs for StoredRuns {
    fn look(&self) -> Vec<ShownRun> {
        self.followed.lock().unwrap_or_else(PoisonError::into_inner).look()
    }

    fn facts(&self, run: usize) -> Result<RunFacts, String> {
        facts(&self.folders[run]).map_err(|error| format!("{error:#}"))
    }

    fn film(&self, run: usize, name: EpisodeName) -> Result<Option<Arc<FilmedEpisode>>, String> {
        let Ok(mut played) = self.played.try_lock() else { return Ok(None) };
        let is_this = |known: &&Played| (known.run, known.name) == (run, name);
        if let Some(known) = played.as_ref().filter(is_this) {
            return Ok(Some(Arc::clone(&known.film)));
        }
        let film = Arc::new(play(&self.folders[run], name).map_err(|error| format!("{error:#}"))?);
        *played = Some(Played { run, name, film: Arc::clone(&film) });
        Ok(Some(film))
    }
}

fn facts(folder: &Path) -> anyhow::Result<RunFacts> {
    let (file, config) = stored::settings_of_run(folder)?;
    let settings = plain_file::read_to_string(&file).with_context(|| file.display().to_string())?;
    Ok(RunFacts {
        manifest: RunFolder::recorded(folder).unwrap_or_default(),
        settings,
        command: run::command(&config, folder),
        iterations: config.iterations(),
        env_steps: config.env_steps(),
    })
}

/// Plays an episode of a checkpoint with mean actions, as `s2mia film` does.
fn play(folder: &Path, name: EpisodeName) -> anyhow::Result<FilmedEpisode> {
    let trained = stored::trained(&chosen::of_run(folder, &Which::Iteration(name.iteration))?)?;
    film::demand_simulator(&trained, folder)?;
    let mut hosted = trained.environment()?;
    let start = (trained.episode(name.index).key(), ActionChoice::Mean);
    let mut recorder = None;
    let world = hosted.environment.as_mut();
    let episode = rollout::play_episode(world, &trained.policy, start, |event| {
        FilmRecorder::follow(&mut recorder, &event);
    })
    .context("the episode failed")?;
    let film = recorder.context("the task has no robot that can be drawn")?.film();
    let result = EvaluationResult {
        episode: name.index,
        extrinsic_return: episode.extrinsic_return,
        steps: episode.steps,
        reward_terms: episode.reward_terms,
    };
    Ok(FilmedEpisode { version: PolicyVersion(name.iteration), result, film })
}

/// Several runs, whose metrics are read when the page is requested.
struct Followed {
    runs: Vec<FollowedRun>,
    looked: Option<Instant>,
}

struct FollowedRun {
    folder: PathBuf,
    name: String,
    /// Name of its group of seeds, or why its settings cannot be read.
    group: Result<String, String>,
    metrics: JsonLinesReader,
    curves: Arc<Curves>,
    /// Number of looks that found something new.
    version: u64,
    /// Mean returns of the evaluations.
    measured: Vec<MeasuredReturn>,
    /// Lines that are no JSON objects.
    damaged: u64,
    /// Why the metrics could not be read at the last attempt.
    error: Option<String>,
    /// Iterations of the checkpoints.
    checkpoints: Vec<u64>,
}

impl FollowedRun {
    fn new(folder: &Path, name: String, group: Result<String, String>) -> Self {
        Self {
            folder: folder.to_path_buf(),
            name,
            group,
            metrics: JsonLinesReader::of(folder.join(METRICS)),
            curves: Arc::default(),
            version: 0,
            measured: Vec::new(),
            damaged: 0,
            error: None,
            checkpoints: Vec::new(),
        }
    }

    fn shown(&self) -> ShownRun {
        let returns = metrics::returns(&self.measured);
        let evaluated = |iteration| (iteration, returns.get(&iteration).copied());
        let troubles = self.group.as_ref().err().cloned().into_iter().chain(self.trouble());
        let troubles = troubles.collect::<Vec<_>>().join("; ");
        let trouble = Some(troubles).filter(|troubles| !troubles.is_empty());
        ShownRun {
            name: self.name.clone(),
            group: self.group.clone().ok(),
            trouble,
            curves: Arc::clone(&self.curves),
            version: self.version,
            live: None,
            policies: self.checkpoints.iter().copied().map(evaluated).collect(),
            episodes: EPISODES,
        }
    }

    /// What of the metrics cannot be read, if anything.
    fn trouble(&self) -> Option<String> {
        let damage = match self.damaged {
            0 => None,
            1 => Some("1 damaged line is skipped".to_owned()),
            lines => Some(format!("{lines} damaged lines are skipped")),
        };
        let name = run_path::file_name(self.metrics.path()).unwrap_or_default();
        let trouble = self.error.clone().or(damage).map(|why| format!("{name}: {why}"));
        let gone = || format!("{} is gone", self.folder.display());
        if matches!(self.folder.try_exists(), Ok(false)) { Some(gone()) } else { trouble }
    }

    /// Reads what is new. Metrics that cannot be read are tried again; each new reason is reported once.
    fn follow(&mut self) {
        // A folder of checkpoints that cannot be read has no episodes to choose from.
        self.checkpoints = checkpoint::all(&self.folder).unwrap_or_default();
        let is_new = match self.metrics.more() {
            Ok(new) => {
                let is_readable_again = self.error.take().is_some();
                if new.from_the_start {
                    (self.curves, self.damaged) = (Arc::default(), 0);
                    self.measured.clear();
                }
                self.damaged += new.damaged;
                self.measured.extend(metrics::measured(&new.lines));
                let curves = Arc::make_mut(&mut self.curves);
                new.lines.iter().for_each(|line| curves.add(line));
                is_readable_again || new.from_the_start || new.damaged > 0 || !new.lines.is_empty()
            }
            Err(error) => {
                let error = error.to_string();
                let is_new = self.error.as_ref() != Some(&error);
                if is_new {
                    tracing::warn!("{}: {error}", self.metrics.path().display());
                }
                self.error = Some(error);
                is_new
            }
        };
        self.version += u64::from(is_new);
    }
}

impl Followed {
    fn of(folders: &[PathBuf]) -> Self {
        let all = folders.iter().zip(names(folders)).zip(groups(folders));
        let runs = all.map(|((folder, name), group)| FollowedRun::new(folder, name, group));
        Self { runs: runs.collect(), looked: None }
    }

    /// The curves, read again if the last look is old enough.
    fn look(&mut self) -> Vec<ShownRun> {
        if self.looked.is_none_or(|looked| looked.elapsed() >= LOOK_AGAIN) {
            self.runs.iter_mut().for_each(FollowedRun::follow);
            self.looked = Some(Instant::now());
        }
        self.runs.iter().map(FollowedRun::shown).collect()
    }
}

/// The folders' own names, or their paths as given if two names are equal.
fn names(folders: &[PathBuf]) -> Vec<String> {
    let short: Vec<_> = folders.iter().map(|folder| run_path::name(folder)).collect();
    let mut distinct = short.clone();
    distinct.sort();
    distinct.dedup();
    if distinct.len() == short.len() {
        return short;
    }
    folders.iter().map(|folder| folder.display().to_string()).collect()
}

/// For each run the name of its group, which all runs have that differ from it only in their seed, or why it has none: its
/// settings cannot be read, or an earlier run is the same.
fn groups(folders: &[PathBuf]) -> Vec<Result<String, String>> {
    let read = |folder: &Path| {
        learning_curve::without_points(folder)
            .map_err(|error| format!("its settings are unknown, so it is in no group: {error:#}"))
    };
    let mut found: Vec<Result<Curve, String>> = Vec::new();
    for folder in folders {
        let run = read(folder).and_then(|curve| {
            let is_same = |other: &Result<Curve, _>| {
                other.as_ref().is_ok_and(|other| other.is_of_the_run_of(&curve))
            };
            match found.iter().position(is_same) {
                None => Ok(curve),
                Some(same) => Err(format!(
                    "it has the settings and seed of {}, so it is in no group; name one of them",
                    folders[same].display()
                )),
            }
        });
        found.push(run);
    }
    let known: Vec<_> = found.iter().flatten().cloned().collect();
    let mut names = learning_curve::tasks_and_variants(&known).into_iter();
    let named =
        |run: Result<_, String>| run.map(|_| names.next().expect("each known run has a name"));
    found.into_iter().map(named).collect()
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    #[test]
    fn runs_with_the_same_name_are_named_by_their_paths() {
        let folders = |all: &[&str]| all.iter().map(PathBuf::from).collect::<Vec<_>>();
        assert_eq!(names(&folders(&["a/x", "a/y"])), ["x", "y"]);
        assert_eq!(names(&folders(&["a/x", "b/x"])), ["a/x", "b/x"]);
    }

    #[test]
    fn a_folder_that_is_named_twice_is_refused() {
        let folders = |all: &[&str]| all.iter().map(PathBuf::from).collect::<Vec<_>>();
        assert!(demand_distinct(&folders(&["a/x", "b/x"])).is_ok());
        let refused = demand_distinct(&folders(&["a/x", "b/x", "a/x/"])).unwrap_err();
        assert_eq!(refused.to_string(), "a/x/ is named twice; name each run once");
    }

    fn in_no_group(folder: &Path) -> FollowedRun {
        FollowedRun::new(folder, String::new(), Ok(String::new()))
    }

    #[test]
    fn metrics_that_cannot_be_read_are_reported_once_until_they_can_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        std::fs::create_dir(&path).unwrap();
        let mut run = in_no_group(folder.path());
        run.follow();
        run.follow();
        assert_eq!(run.version, 1);
        assert!(run.trouble().unwrap().contains("directory"), "{:?}", run.trouble());
        std::fs::remove_dir(&path).unwrap();
        run.follow();
        assert_eq!((run.version, run.trouble()), (2, None));
    }

    #[test]
    fn only_a_growing_run_gets_a_new_version() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let line = "{\"kind\":\"iteration\",\"env_steps\":40,\"a\":1}\n";
        std::fs::write(&path, line).unwrap();
        let mut run = in_no_group(folder.path());
        run.follow();
        run.follow();
        assert_eq!(run.shown().version, 1);
        let mut file = std::fs::File::options().append(true).open(&path).unwrap();
        file.write_all(line.as_bytes()).unwrap();
        run.follow();
        assert_eq!((run.shown().version, run.shown().curves.lines()), (2, 2));
    }
}
