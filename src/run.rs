//! Runs on this machine: starting, resuming, supervising, serving and verifying them. This file prepares the start of a learner
//! from the arguments of `train` and `learner`.

pub(crate) mod chosen;
pub(crate) mod offered;
pub(crate) mod pretrained;
pub(crate) mod recorded;
pub(crate) mod resume;
pub(crate) mod run_path;
pub(crate) mod session;
pub(crate) mod start;
pub(crate) mod stored;
pub(crate) mod supervisor;
pub(crate) mod verification;
pub(crate) mod warm_up;

use std::path::{Path, PathBuf};

use actor::Transport;
use clap::Args;
use learner::launch::Launch;
use learner::store::run_folder::{CONFIG, RunFolder};
use learner::store::{durable, plain_file};
use policy::RunSeed;
use proto::Digest;
use serde_json::{Value, json};

use crate::config::run_config::RunConfig;
use crate::config::{ConfigError, Request, keys, layers, message_steps};
use crate::errors::Usage;
use crate::process::shell;
use crate::run::offered::Offered;
use crate::run::run_path::{NewFolder, Others, demand_resumable};
use crate::run::stored::{own_settings, settings_of_run};

/// Version and commit of this program.
pub(crate) const BUILD: &str = concat!(env!("CARGO_PKG_VERSION"), "+", env!("S2MIA_GIT_COMMIT"));

/// Version and commit in a run's manifest or a line of its starts, as [`BUILD`] has them.
pub(crate) fn build_of(record: &Value) -> String {
    let recorded = |key: &str| record[key].as_str().unwrap_or("unknown");
    format!("{}+{}", recorded("version"), recorded("git_commit"))
}

/// Placeholder for the settings of a command in help texts.
pub(crate) const VALUE_NAME: &str = "TASK | KEY=VALUE";

/// Arguments that define the configuration.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct SettingsArguments {
    /// Task or path of a task file, followed by settings as key.path=value.
    #[arg(value_name = VALUE_NAME)]
    pub(crate) settings: Vec<String>,
    /// TOML file with settings. May be given several times; later files override earlier ones.
    #[arg(long = "config", value_name = "FILE")]
    pub(crate) files: Vec<PathBuf>,
    /// Train in the environment that an external program offers at this URL. TASK then only selects the settings.
    /// Short for environment_service.url=URL.
    #[arg(long, value_name = "URL", value_parser = clap::builder::NonEmptyStringValueParser::new())]
    pub(crate) environment: Option<String>,
}

impl SettingsArguments {
    /// All settings as key.path=value, including those given by a separate flag.
    pub(crate) fn written(&self) -> Vec<String> {
        let url = self.environment.iter().map(|url| format!("environment_service.url={url}"));
        self.settings.iter().cloned().chain(url).collect()
    }

    /// The request for these settings, with this process's environment variables.
    pub(crate) fn request(&self) -> Request {
        Request::from_process(self.files.clone(), self.written())
    }
}

/// Resume of an earlier run.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ResumeArguments {
    /// Resume the run in this folder from its newest valid checkpoint.
    #[arg(long, value_name = "RUN")]
    pub(crate) resume: Option<PathBuf>,
    /// Start a new run in run.dir although the folder contains other files.
    #[arg(long, conflicts_with = "resume")]
    pub(crate) force: bool,
}

/// A run that is ready to start.
pub(crate) struct PreparedRun {
    /// Its settings.
    pub(crate) config: RunConfig,
    /// Its folder.
    pub(crate) folder: PathBuf,
    /// Everything that the learner starts with.
    pub(crate) launch: Launch,
    /// The folder of a new run.
    pub(crate) new: Option<NewFolder>,
}

/// Checks the settings and the run folder; starts nothing and writes nothing but a new folder, or a copy of damaged settings.
/// `transport` limits the connection to an external environment.
pub(crate) fn prepare(
    settings: &SettingsArguments,
    resumed: &ResumeArguments,
    transport: &Transport,
) -> anyhow::Result<PreparedRun> {
    let config = configure(settings, resumed.resume.as_deref())?;
    let others = if resumed.force { Others::Accepted } else { Others::Refused };
    let prepared = prepare_config(config, resumed.resume.as_deref(), others, transport)?;
    let own = prepared.folder.join(CONFIG);
    if prepared.launch.resume {
        resume::warn_of_other_build(&prepared.folder);
        // The learner writes damaged settings again.
        if own_settings(&prepared.folder).is_err()
            && let Ok(damaged) = plain_file::read(&own)
        {
            durable::keep_damaged(&own, &damaged)?;
        }
    }
    Ok(prepared)
}

/// As [`prepare`], for settings that have been read: those of the run in the folder `resumed`, or of a new run.
pub(crate) fn prepare_config(
    mut config: RunConfig,
    resumed: Option<&Path>,
    others: Others,
    transport: &Transport,
) -> anyhow::Result<PreparedRun> {
    let offered = Offered::of(&config, transport)?;
    config.demand_suitable(Some(&offered.spec))?;
    let fingerprint = rollout::rollout_fingerprint();
    if resumed.is_some() || !config.environment.description.is_empty() {
        offered.demand_that_of(&config)?;
    }
    let (folder, new) = match resumed {
        Some(folder) => (folder.to_path_buf(), None),
        None => {
            let new = NewFolder::of(&config, &offered.spec.task, others)?;
            (new.path().to_path_buf(), Some(new))
        }
    };
    // The learner claims the folder later, after the actors have started.
    RunFolder::demand_free(&folder)?;
    RunFolder::demand_writable(&folder)?;
    config.resolved.set(keys::FILLED_IN, offered.description.as_str(), keys::URL);
    config.resolved.set("run.dir", folder.display().to_string(), "run folder");
    let mut launch = launch(&config, offered, &folder, fingerprint);
    // A run that ended before it wrote its manifest has done nothing and begins in its folder.
    let begun = resumed.filter(|folder| RunFolder::holds_run(folder));
    if let Some(folder) = begun {
        resume::demand_same_program(folder, fingerprint, launch.config_sha256)?;
    }
    launch.resume = begun.is_some();
    launch.start = start::policies(&config.resolved, resumed)?;
    if !launch.resume {
        message_steps::fit(&mut config, &mut launch)?;
    }
    launch.validate().map_err(|error| Usage::new(error.to_string()))?;
    Ok(PreparedRun { config, folder, launch, new })
}

/// As [`prepare`], but resumes the run in the configured folder if there is one, so that a learner can be restarted
/// with the same command.
pub(crate) fn prepare_or_resume(
    settings: &SettingsArguments,
    resumed: &ResumeArguments,
    transport: &Transport,
) -> anyhow::Result<PreparedRun> {
    let resume = match &resumed.resume {
        Some(folder) => Some(folder.clone()),
        None => run_in_place(settings)?,
    };
    prepare(settings, &ResumeArguments { resume, ..resumed.clone() }, transport)
}

/// The configured folder, if it contains a run, whose own settings then hold.
fn run_in_place(settings: &SettingsArguments) -> Result<Option<PathBuf>, ConfigError> {
    let resolved = layers::resolve(&settings.request())?;
    Ok(run_path::named(&resolved)?.filter(|folder| RunFolder::holds_run(folder)))
}

/// The settings of a new run, or those of `resumed` with permitted changes.
fn configure(settings: &SettingsArguments, resumed: Option<&Path>) -> anyhow::Result<RunConfig> {
    let mut request = settings.request();
    let Some(folder) = resumed else {
        return Ok(RunConfig::of(&request)?);
    };
    demand_resumable(folder)?;
    let (file, old) = settings_of_run(folder)?;
    request.resumed = Some(file);
    let new = RunConfig::of(&request)?;
    resume::check(&old, &new)?;
    refuse_other_folder(&new, &old, folder)?;
    Ok(new)
}

/// Refuses a given `run.dir` that is not the resumed run's `folder`. The run may have been moved since `old` was written.
fn refuse_other_folder(new: &RunConfig, old: &RunConfig, folder: &Path) -> Result<(), ConfigError> {
    let given = run_path::named(&new.resolved)?;
    let real = |path: &Path| path.canonicalize().ok();
    let is_same = given.as_deref().is_some_and(|given| real(given) == real(folder));
    if is_same || given == run_path::named(&old.resolved)? {
        return Ok(());
    }
    let detail = format!("a resumed run stays in its folder, {}; omit run.dir", folder.display());
    Err(ConfigError::refused(&new.resolved, &["run.dir"], &detail))
}

/// The start of a new run of `config`.
fn launch(config: &RunConfig, offered: Offered, folder: &Path, fingerprint: Digest) -> Launch {
    Launch {
        config: config.learner.clone(),
        training: config.training.clone(),
        observations: config.observations(),
        policy: config.policy.clone(),
        manifest: manifest(config, &offered),
        environment: offered.spec,
        task_settings: offered.task_settings,
        states: offered.decoder,
        divergence_remedy: divergence_remedy(config).to_owned(),
        seed: RunSeed(config.run.seed),
        iterations: config.iterations(),
        until: config.iterations(),
        run_id: run_path::name(folder),
        folder: folder.to_path_buf(),
        config_toml: config.resolved.to_toml(),
        command: command(config, folder),
        config_sha256: Digest(config.resolved.sha256()),
        build: BUILD.to_owned(),
        rollout_fingerprint: fingerprint,
        resume: false,
        start: None,
        evaluations: None,
    }
}

/// Field of a run's manifest: names of the agents of another program's environment.
pub(crate) const AGENTS: &str = "agents";

/// The command that begins a run with the settings of the one in `folder`: with those that differ from its task's, preset's
/// and algorithm's, or for a task of the user's own, whose file may have changed, with the run's own file. Policies from which
/// the run started are those that the folder keeps.
pub(crate) fn command(config: &RunConfig, folder: &Path) -> String {
    let mut resolved = config.resolved.clone();
    start::take_kept(&mut resolved, folder);
    let task = resolved.text("task");
    let [preset, algorithm] =
        ["preset", "algorithm"].map(|key| format!("{key}={}", resolved.text(key)));
    let usual = match RunConfig::with(&[task, &preset, &algorithm]) {
        Ok(usual) if config.task.definition.is_none() => usual.resolved,
        _ => return format!("s2mia train --config {}", shell::path(&folder.join(CONFIG))),
    };
    let mut words = vec!["s2mia train".to_owned(), task.to_owned()];
    for (key, entry) in &resolved.entries {
        let value = &entry.value;
        let differs = match key.as_str() {
            "task" | "run.dir" | keys::START_SHA256 => false,
            "preset" | "algorithm" => layers::default_of(key).is_ok_and(|usual| usual != value),
            _ => usual.entries.get(key).is_none_or(|usual| usual.value != *value),
        };
        if differs {
            words.push(shell::word(&format!("{key}={}", resolved.plain(key))));
        }
    }
    words.join(" ")
}

/// What helps if the simulated robot diverges; empty for the environment of another program.
fn divergence_remedy(config: &RunConfig) -> &'static str {
    match (&config.task.definition, config.environment.url.is_empty()) {
        (_, false) => "",
        (Some(_), true) => {
            "lower `timestep` in the <option> of the model (and raise frame_skip in the task file, so that a step stays as \
             long), or set integration = \"runge_kutta\" in its [physics]; check the gear, kp and kv of the actuators and the \
             stiffness, damping and armature of the joints; `s2mia task check` shows the masses and torques"
        }
        (None, true) => {
            "this robot has no setting for its physics; a run whose episodes all end early does not learn the task: try \
             another seed or a smaller update.learning_rate, and report the settings of the run"
        }
    }
}

/// The fields of the manifest besides the learner's own.
fn manifest(config: &RunConfig, offered: &Offered) -> serde_json::Value {
    let mut manifest = json!({
        "program": "s2mia",
        "version": env!("CARGO_PKG_VERSION"),
        "git_commit": env!("S2MIA_GIT_COMMIT"),
        "rustc": env!("S2MIA_RUSTC"),
        "task": offered.spec.task,
        "environment_states": offered.states,
        "algorithm": config.resolved.text("algorithm"),
        "preset": config.resolved.text("preset"),
        "seed": config.run.seed,
    });
    if !config.environment.url.is_empty() {
        // No other file has the names, and the other program need not run.
        let names = offered.spec.agents.iter().map(|agent| agent.name.as_str());
        manifest[AGENTS] = names.collect();
    }
    manifest
}
