//! The runs that an experiment file describes. All settings are checked before the first run starts.

use std::path::PathBuf;

use super::file::{ExperimentFile, Variant, assignments};
use crate::config::run_config::RunConfig;
use crate::config::{Request, layers};
use crate::errors::Usage;

/// One run of an experiment.
#[derive(Clone, Debug)]
pub(crate) struct PlannedRun {
    /// Task.
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
                runs.push(planned(file, variant, task, seed)?);
            }
        }
    }
    Ok(runs)
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
    settings.extend(of(&file.settings));
    settings.extend(of(&variant.settings));
    settings.extend([
        format!("run.seed={seed}"),
        format!("run.env_steps={env_steps}"),
        format!("run.actors={}", file.actors),
        format!("learner.threads={}", file.threads),
    ]);
    let place = format!("{}, variant {} on {task}", file.path.display(), variant.name);
    let mut request = Request::from_process(Vec::new(), settings.clone());
    request.settings_place = Some(place.clone());
    let config = RunConfig::build(layers::resolve(&request)?)?;
    if config.learner.evaluation.every_steps == 0 {
        let why =
            format!("{place}: evaluation.every_steps must be above 0: evaluations are compared");
        return Err(Usage::new(why).into());
    }
    let folder = file.folder.join(format!("{task}-{}-seed{seed}", variant.name));
    Ok(PlannedRun {
        task: task.to_owned(),
        variant: variant.name.clone(),
        seed,
        folder,
        settings,
        config,
    })
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
}
