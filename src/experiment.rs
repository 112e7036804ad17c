//! Many runs from one file: tasks x variants x seeds. This file plans the runs, whose settings are all checked before the first
//! one starts, and selects those that one process computes.

pub(crate) mod comparison;
pub(crate) mod file;
pub(crate) mod record;
pub(crate) mod report;
pub(crate) mod results;
pub(crate) mod run_state;
pub(crate) mod scheduler;
pub(crate) mod submit;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Display};
use std::path::PathBuf;
use std::str::FromStr;

use crate::config::Request;
use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::figures::chart::{count_of, thousands};
use crate::run::run_path::LONGEST_NAME;
use crate::run::warm_up;
use file::{ExperimentFile, Variant, assignments};

/// The setting of the interval between evaluations.
const EVERY_STEPS: &str = "evaluation.every_steps";

/// Evaluations of a run after its start, at least, if no setting says otherwise.
const EVALUATIONS: u64 = 10;

/// A curve of fewer evaluations after the start is remarked on.
const FEWEST: u64 = 3;

/// One run of an experiment.
#[derive(Clone, Debug)]
pub(crate) struct PlannedRun {
    /// Position in the plan, from 0.
    pub(crate) index: usize,
    /// Task as the file spells it: its name, or the path of its file.
    pub(crate) asked: String,
    /// Name of the task.
    pub(crate) task: String,
    /// Name of the variant.
    pub(crate) variant: String,
    /// Seed.
    pub(crate) seed: u64,
    /// Its folder.
    pub(crate) folder: PathBuf,
    /// Arguments of `s2mia train` besides the folder.
    pub(crate) settings: Vec<String>,
    /// The configuration that they resolve to.
    pub(crate) config: RunConfig,
}

impl PlannedRun {
    /// Last part of the folder: task, variant and seed.
    pub(crate) fn name(&self) -> String {
        self.folder.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Path of the run's log.
    pub(crate) fn log(&self) -> PathBuf {
        self.folder.with_file_name(format!("{}.log", self.name()))
    }
}

/// All runs: every variant on every task with its first seed, then with its second, and so on. An experiment that is
/// stopped early can therefore already compare variants.
pub(crate) fn plan(file: &ExperimentFile) -> anyhow::Result<Vec<PlannedRun>> {
    let seeds = |variant: &Variant| variant.seeds.as_ref().unwrap_or(&file.seeds).clone();
    let most = file.variants.iter().map(|variant| seeds(variant).len()).max().unwrap_or(0);
    let mut runs = Vec::new();
    for turn in 0..most {
        for variant in &file.variants {
            let Some(&seed) = seeds(variant).get(turn) else { continue };
            for task in variant.tasks.as_ref().unwrap_or(&file.tasks) {
                let run = planned(file, variant, task, seed)?;
                if turn == 0 {
                    run.config.demand_task()?;
                }
                runs.push(PlannedRun { index: runs.len(), ..run });
            }
        }
    }
    demand_own_folders(file, &runs)?;
    Ok(runs)
}

/// Refuses two runs with one folder: tasks of different spelling, or a task and a variant together, can have the same names. Also
/// a run whose log has too long a name.
fn demand_own_folders(file: &ExperimentFile, runs: &[PlannedRun]) -> Result<(), Usage> {
    let place = file.path.display();
    let mut known = BTreeMap::new();
    for run in runs {
        if run.log().file_name().is_some_and(|name| name.len() > LONGEST_NAME) {
            return Err(Usage::new(format!(
                "{place}: the log of {} would have a name of more than {LONGEST_NAME} bytes; shorten the variant's name",
                run.name()
            )));
        }
        if let Some(first) = known.insert(&run.folder, run) {
            let shown = |run: &PlannedRun| format!("task \"{}\" with {}", run.asked, run.variant);
            return Err(Usage::new(format!(
                "{place}: {} and {} would share the folder {}; leave one out, or rename a robot, partition or variant",
                shown(first),
                shown(run),
                run.name(),
            )));
        }
    }
    Ok(())
}

/// A line for each variant with too few evaluations for a curve, and for runs that end before they learn.
pub(crate) fn remarks(runs: &[PlannedRun]) -> Vec<String> {
    let few = |run: &PlannedRun| {
        let steps = run.config.env_steps();
        let every = run.config.learner.evaluation.every_steps;
        let count = steps / every;
        let advice = (steps / EVALUATIONS).max(1);
        (count < FEWEST).then(|| {
            format!(
                "note: {} has {} after its start in {} steps, too few for a curve; \
                 leave {EVERY_STEPS} out or set it to {}",
                run.variant,
                count_of(count, "evaluation"),
                thousands(steps),
                thousands(advice),
            )
        })
    };
    let idle = |run: &PlannedRun| warm_up::remark(&run.config);
    let lines = runs.iter().filter_map(few).chain(runs.iter().filter_map(idle));
    lines.collect::<BTreeSet<_>>().into_iter().collect()
}

/// The runs whose index modulo `count` is `index`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shard {
    index: usize,
    count: usize,
}

/// Runs of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Selection {
    /// All runs.
    All,
    /// The runs of a shard.
    Shard(Shard),
    /// The run with this index.
    Only(usize),
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(index, count)| {
            Some(Self { index: index.parse().ok()?, count: count.parse().ok()? })
        });
        match numbers {
            Some(shard) if shard.index < shard.count => Ok(shard),
            Some(Self { count, .. }) if count > 0 => {
                Err(format!("I of I/N must be in 0..={}", count - 1))
            }
            _ => Err("write I/N, for example 0/4 for the first of four shards".to_owned()),
        }
    }
}

impl Selection {
    /// The selected runs.
    ///
    /// # Errors
    /// Names an index that no run has.
    pub(crate) fn of(self, runs: &[PlannedRun]) -> Result<Vec<PlannedRun>, Usage> {
        if let Self::Only(index) = self
            && index >= runs.len()
        {
            let last = runs.len().saturating_sub(1);
            return Err(Usage::new(format!(
                "--only {index}: the runs have the indexes 0..={last}; --list shows them"
            )));
        }
        Ok(runs.iter().filter(|run| self.contains(run.index)).cloned().collect())
    }

    fn contains(self, index: usize) -> bool {
        match self {
            Self::All => true,
            Self::Shard(shard) => index % shard.count == shard.index,
            Self::Only(only) => index == only,
        }
    }
}

/// The arguments that select the runs, after a space.
impl Display for Selection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => Ok(()),
            Self::Shard(Shard { index, count }) => write!(f, " --shard {index}/{count}"),
            Self::Only(index) => write!(f, " --only {index}"),
        }
    }
}

fn planned(
    file: &ExperimentFile,
    variant: &Variant,
    task: &str,
    seed: u64,
) -> anyhow::Result<PlannedRun> {
    let of = |table: &Option<toml::Table>| table.as_ref().map(assignments).unwrap_or_default();
    let env_steps = variant.env_steps.unwrap_or(file.env_steps);
    let mut settings = vec![format!("task={task}"), format!("algorithm={}", variant.algorithm)];
    let url = file.environments.get(task).map(|url| format!("environment_service.url={url}"));
    settings.extend(url);
    settings.extend(of(&file.settings));
    settings.extend(of(&variant.settings));
    settings.extend([
        format!("run.seed={seed}"),
        // A run that was made longer by itself may have its length here.
        "run.iterations=0".to_owned(),
        format!("run.env_steps={env_steps}"),
        format!("run.actors={}", file.actors),
        format!("learner.threads={}", file.threads),
    ]);
    let place = format!("{}, variant {} on {task}", file.path.display(), variant.name);
    let mut config = resolved(&settings, &place)?;
    if let Some(every) = adapted(&config, &place) {
        settings.push(format!("{EVERY_STEPS}={every}"));
        config = resolved(&settings, &place)?;
    }
    if config.learner.evaluation.every_steps == 0 {
        let why = format!("{place}: {EVERY_STEPS} must be above 0: evaluations are compared");
        return Err(Usage::new(why).into());
    }
    let (asked, task) = (task.to_owned(), config.resolved.text("task").to_owned());
    let folder = file.folder.join(format!("{task}-{}-seed{seed}", variant.name));
    let variant = variant.name.clone();
    Ok(PlannedRun { index: 0, asked, task, variant, seed, folder, settings, config })
}

fn resolved(settings: &[String], place: &str) -> anyhow::Result<RunConfig> {
    let mut request = Request::from_process(Vec::new(), settings.to_vec());
    request.settings_place = Some(place.to_owned());
    Ok(RunConfig::of(&request)?)
}

/// A shorter interval between evaluations for a run that is too short for the default one. `place` is the origin of what the
/// experiment's file sets; it may itself begin as the origins of defaults do.
fn adapted(config: &RunConfig, place: &str) -> Option<u64> {
    let origin = config.resolved.origin(EVERY_STEPS);
    let is_default = origin != place && origin.starts_with("configs/");
    let tenth = (config.env_steps() / EVALUATIONS).max(1);
    let every = config.learner.evaluation.every_steps;
    (is_default && tenth < every).then_some(tenth)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ConfigError;
    use crate::experiment::file::tests::SAMPLE;

    #[test]
    fn every_variant_runs_on_its_tasks_with_its_seeds_first_seeds_first() {
        let runs = plan(&toml::from_str(SAMPLE).unwrap()).unwrap();
        let names: Vec<String> = runs.iter().map(PlannedRun::name).collect();
        let expected = [
            "halfcheetah-2x3-happo-seed0",
            "ant-4x2-happo-seed0",
            "halfcheetah-2x3-near-seed5",
            "halfcheetah-2x3-happo-seed1",
            "ant-4x2-happo-seed1",
        ];
        assert_eq!(names, expected);
        assert_eq!(runs[2].config.resolved.text("observation.mode"), "k_nearest");
        assert_eq!((runs[0].config.run.seed, runs[0].config.env_steps()), (0, 8_000));
    }

    #[test]
    fn a_task_with_an_environment_of_its_own_runs_on_that_and_the_others_in_the_simulator() {
        let line = "environments.ant-4x2 = \"http://localhost:7\"";
        let runs = planned_with(line);
        let url = |run: &PlannedRun| run.config.environment.url.clone();
        assert_eq!(
            runs.iter().map(url).collect::<Vec<_>>(),
            ["", "http://localhost:7", "", "", "http://localhost:7"]
        );
    }

    #[test]
    fn a_setting_that_no_run_can_have_is_refused_with_its_place_in_the_file() {
        for (from, to, words) in [
            (
                "observation.mode",
                "observation.modus",
                "variant near on halfcheetah-2x3: unknown key `observation.modus`",
            ),
            (
                "every_steps = 4_000",
                "every_steps = 0",
                "variant happo on halfcheetah-2x3: evaluation.every_steps must be above 0",
            ),
            (
                "settings.evaluation.every_steps",
                "settings.maddpg.batch",
                "variant happo on halfcheetah-2x3: `maddpg.batch` has no effect in this run",
            ),
            ("\"ant-4x2\"", "\"ant-9x9\"", "variant happo on ant-9x9: unknown task `ant-9x9`"),
            (
                "algorithm = \"happo\"",
                "algorithm = \"hapo\"",
                "variant happo on halfcheetah-2x3: unknown algorithm `hapo`",
            ),
        ] {
            let file: ExperimentFile = toml::from_str(&SAMPLE.replacen(from, to, 1)).unwrap();
            let error = plan(&ExperimentFile { path: "a.toml".into(), ..file }).unwrap_err();
            let message = format!("{error:#}");
            assert!(message.starts_with(&format!("a.toml, {words}")), "{message}");
            assert!(error.is::<ConfigError>() || error.is::<Usage>(), "{message}");
        }
    }

    #[test]
    fn a_task_that_is_spelled_in_two_ways_is_refused_because_its_runs_would_share_a_folder() {
        let file: ExperimentFile = toml::from_str(SAMPLE).unwrap();
        let file = ExperimentFile { path: "a.toml".into(), ..file };
        let mut runs = plan(&file).unwrap();
        runs[0].asked = "a/hopper.toml".to_owned();
        runs.push(PlannedRun { asked: "./a/hopper.toml".to_owned(), ..runs[0].clone() });
        let line = demand_own_folders(&file, &runs).unwrap_err().to_string();
        let words = "a.toml: task \"a/hopper.toml\" with happo and task \"./a/hopper.toml\" with happo would share the folder \
                     halfcheetah-2x3-happo-seed0; leave one out, or rename a robot, partition or variant";
        assert_eq!(line, words);
    }

    fn planned_with(line: &str) -> Vec<PlannedRun> {
        let text = SAMPLE.replacen("settings.evaluation.every_steps = 4_000", line, 1);
        plan(&toml::from_str(&text).unwrap()).unwrap()
    }

    #[test]
    fn a_run_that_is_short_for_the_default_interval_is_evaluated_ten_times() {
        let runs = planned_with("");
        assert_eq!(runs[0].config.learner.evaluation.every_steps, 800);
        assert!(runs[0].settings.contains(&"evaluation.every_steps=800".to_owned()));
        assert!(remarks(&runs).is_empty());
        let long = SAMPLE.replacen("8_000", "8_000_000", 1).replacen("settings.eval", "# ", 1);
        let long = plan(&toml::from_str(&long).unwrap()).unwrap();
        assert_eq!(long[0].config.learner.evaluation.every_steps, 100_000);
    }

    #[test]
    fn an_interval_of_the_file_is_kept_and_remarked_on_if_it_is_too_long() {
        // A default's origin is below configs, too.
        for path in ["a.toml", "configs/a.toml"] {
            let file: ExperimentFile = toml::from_str(SAMPLE).unwrap();
            let runs = plan(&ExperimentFile { path: path.into(), ..file }).unwrap();
            assert_eq!(runs[0].config.learner.evaluation.every_steps, 4_000);
        }
        let lines = remarks(&plan(&toml::from_str(SAMPLE).unwrap()).unwrap());
        let happo = "note: happo has 2 evaluations after its start in 8,000 steps, too few for a curve; \
                     leave evaluation.every_steps out or set it to 800";
        assert_eq!((lines.len(), lines[0].as_str()), (2, happo));
    }

    fn indexes(selection: Selection) -> Vec<usize> {
        let runs = plan(&toml::from_str(SAMPLE).unwrap()).unwrap();
        selection.of(&runs).unwrap().iter().map(|run| run.index).collect()
    }

    #[test]
    fn the_shards_of_a_plan_contain_each_run_once() {
        let shard = |text: &str| indexes(Selection::Shard(text.parse().unwrap()));
        assert_eq!(indexes(Selection::All), [0, 1, 2, 3, 4]);
        assert_eq!((shard("0/2"), shard("1/2")), (vec![0, 2, 4], vec![1, 3]));
        assert_eq!(shard("6/7"), Vec::<usize>::new());
        assert_eq!(indexes(Selection::Only(3)), [3]);
    }

    #[test]
    fn a_shard_or_a_run_that_does_not_exist_is_refused_with_what_exists() {
        for (text, words) in
            [("4/4", "I of I/N must be in 0..=3"), ("1/0", "write I/N"), ("3", "write I/N")]
        {
            let error = text.parse::<Shard>().unwrap_err();
            assert!(error.contains(words), "{error}");
        }
        let runs = plan(&toml::from_str(SAMPLE).unwrap()).unwrap();
        let error = Selection::Only(5).of(&runs).unwrap_err().to_string();
        assert_eq!(error, "--only 5: the runs have the indexes 0..=4; --list shows them");
    }
}
