//! Prepares the start of a learner from the arguments of `train` and `learner`.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use actor::Transport;
use learner::Launch;
use learner::run_folder::RunFolder;
use policy::RunSeed;
use proto::Digest;
use serde_json::json;

use crate::cli::{ResumeArguments, SettingsArguments};
use crate::config::run_config::RunConfig;
use crate::config::run_settings::settings_of_run;
use crate::config::{ConfigError, Request, keys, layers};
use crate::errors::Usage;
use crate::run::fingerprints::{BUILD, Fingerprints};
use crate::run::offered::Offered;
use crate::run::run_path::demand_run;
use crate::run::{resume, run_path};

/// A run that is ready to start.
pub(crate) struct Prepared {
    /// Its settings.
    pub(crate) config: RunConfig,
    /// Its folder.
    pub(crate) folder: PathBuf,
    /// Everything that the learner starts with.
    pub(crate) launch: Launch,
}

/// Checks the settings and the run folder; starts and writes nothing. `transport` limits the connection to an external
/// environment.
pub(crate) fn prepare(
    settings: &SettingsArguments,
    resumed: &ResumeArguments,
    transport: &Transport,
) -> anyhow::Result<Prepared> {
    let mut config = configure(settings, resumed.resume.as_deref())?;
    let offered = Offered::of(&config, transport)?;
    let folder = match &resumed.resume {
        Some(folder) => {
            offered.demand_that_of(&config)?;
            folder.clone()
        }
        None => new_folder(&config, &offered.spec.task)?,
    };
    // The learner claims the folder later, after the actors have started.
    RunFolder::demand_free(&folder)?;
    config.resolved.set_text(keys::FILLED_IN, &offered.description, "environment_service.url");
    config.resolved.set_text("run.dir", &folder.display().to_string(), "run folder");
    let fingerprints = Fingerprints::measure();
    let mut launch = launch(&config, offered, &folder, &fingerprints);
    if let Some(folder) = &resumed.resume {
        launch.config_sha256 = Digest(config.resolved.sha256_as(&recorded_hash(folder)));
        fingerprints.demand_those_of(folder, launch.config_sha256)?;
    }
    launch.resume = resumed.resume.is_some();
    launch.fault = resumed.die_at;
    Ok(Prepared { config, folder, launch })
}

/// The hash of the settings that the run's manifest records, or its newest checkpoint without one; empty without either.
fn recorded_hash(folder: &Path) -> String {
    RunFolder::recorded_config_sha256(folder).unwrap_or_else(|| {
        let newest = learner::checkpoint::load_newest(folder);
        newest.map_or_else(|_| String::new(), |loaded| loaded.manifest.config_sha256)
    })
}

/// As [`prepare`], but resumes the run in the configured folder if there is one, so that a learner can be restarted
/// with the same command.
pub(crate) fn prepare_or_resume(
    settings: &SettingsArguments,
    resumed: &ResumeArguments,
    transport: &Transport,
) -> anyhow::Result<Prepared> {
    let resume = match &resumed.resume {
        Some(folder) => Some(folder.clone()),
        None => run_in_place(&configure(settings, None)?),
    };
    prepare(settings, &ResumeArguments { resume, ..resumed.clone() }, transport)
}

/// The configured folder, if it contains a run.
fn run_in_place(config: &RunConfig) -> Option<PathBuf> {
    let folder = Path::new(&config.run.dir);
    let there = !config.run.dir.is_empty() && RunFolder::holds_run(folder);
    there.then(|| folder.to_path_buf())
}

/// The settings of a new run, or those of `resumed` with permitted changes.
fn configure(settings: &SettingsArguments, resumed: Option<&Path>) -> anyhow::Result<RunConfig> {
    let mut request = Request::from_process(settings.files.clone(), settings.written());
    let Some(folder) = resumed else {
        return Ok(RunConfig::build(layers::resolve(&request)?)?);
    };
    demand_run(folder)?;
    let (file, old) = settings_of_run(folder)?;
    request.resumed = Some(file);
    let new = RunConfig::build(layers::resolve(&request)?)?;
    resume::check(&old, &new)?;
    refuse_other_folder(&new, &old)?;
    Ok(new)
}

/// Refuses another `run.dir` than that of the resumed run.
fn refuse_other_folder(new: &RunConfig, old: &RunConfig) -> Result<(), ConfigError> {
    if new.run.dir == old.run.dir {
        return Ok(());
    }
    Err(ConfigError::Refused {
        place: new.resolved.origin("run.dir").to_owned(),
        key: "run.dir".to_owned(),
        detail: "a resumed run stays in its folder".to_owned(),
    })
}

/// The folder of a new run; refuses one that holds a run already.
fn new_folder(config: &RunConfig, task: &str) -> anyhow::Result<PathBuf> {
    let run = &config.run;
    let folder = match run.dir.as_str() {
        "" if layers::is_of_this_command(config.resolved.origin("run.dir")) => {
            return Err(ConfigError::Refused {
                place: config.resolved.origin("run.dir").to_owned(),
                key: "run.dir".to_owned(),
                detail: "it is empty; without it the run gets a new folder in `runs`".to_owned(),
            }
            .into());
        }
        "" => {
            let algorithm = config.resolved.text("algorithm");
            let now = SystemTime::now();
            run_path::default_folder(task, algorithm, run.seed, now)
        }
        given => PathBuf::from(given),
    };
    if folder.exists() && !folder.is_dir() {
        let why = format!("{} is no folder; run.dir names the run's folder", folder.display());
        return Err(Usage::new(why).into());
    }
    if RunFolder::holds_run(&folder) {
        let shown = folder.display();
        let why = format!(
            "{shown} already contains a run; resume it with `s2mia train --resume {shown}`"
        );
        return Err(Usage::new(why).into());
    }
    Ok(folder)
}

/// The start of a new run of `config`.
fn launch(
    config: &RunConfig,
    offered: Offered,
    folder: &Path,
    fingerprints: &Fingerprints,
) -> Launch {
    Launch {
        config: config.learner.clone(),
        training: config.training.clone(),
        observations: config.observations(),
        policy: config.policy.clone(),
        manifest: manifest(config, &offered),
        environment: offered.spec,
        task_settings: offered.task_settings,
        seed: RunSeed(config.run.seed),
        iterations: config.iterations(),
        run_id: run_path::name(folder),
        folder: folder.to_path_buf(),
        config_toml: config.resolved.to_toml(),
        config_sha256: Digest(config.resolved.sha256()),
        build: BUILD.to_owned(),
        rollout_fingerprint: fingerprints.rollout,
        learner_fingerprint: fingerprints.learner,
        resume: false,
        fault: None,
    }
}

/// The fields of the manifest besides the learner's own.
fn manifest(config: &RunConfig, offered: &Offered) -> serde_json::Value {
    json!({
        "program": "s2mia",
        "version": env!("CARGO_PKG_VERSION"),
        "git_commit": env!("S2MIA_GIT_COMMIT"),
        "rustc": env!("S2MIA_RUSTC"),
        "task": offered.spec.task,
        "environment_states": offered.states,
        "algorithm": config.resolved.text("algorithm"),
        "preset": config.resolved.text("preset"),
        "seed": config.run.seed,
    })
}
