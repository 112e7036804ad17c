//! `s2mia config` and `s2mia inspect`: the settings that a run would have, and the contents of its newest valid
//! checkpoint.

use clap::Args;
use serde_json::json;

use crate::config::own_task::OwnTask;
use crate::config::run_config::RunConfig;
use crate::config::{effect, keys, layers, presets};
use crate::errors::Usage;
use crate::process::output;
use crate::run::chosen::ChosenArguments;
use crate::run::{SettingsArguments, pretrained, stored};

/// Prints TOML that `--config` can read again, or what the named keys mean.
pub(super) fn config(arguments: &SettingsArguments) -> anyhow::Result<()> {
    let mut arguments = arguments.clone();
    let keys: Vec<String> = arguments.settings.extract_if(.., |word| is_key(word)).collect();
    keys.iter().try_for_each(|key| layers::default_of(key).map(|_| ()))?;
    let config = RunConfig::of(&arguments.request())?;
    let explained = keys.iter().map(|key| explained(&config, key));
    let explained = explained.collect::<anyhow::Result<Vec<String>>>()?;
    if !explained.is_empty() {
        explained.iter().for_each(output::line);
        return Ok(());
    }
    config.demand_task()?;
    output::line(config.resolved.to_toml_with_origins(effect::remarks(&config)));
    output::line(format!("# config_sha256 = {}", policy::arrays::hex(&config.resolved.sha256())));
    Ok(())
}

/// Whether an argument of `s2mia config` names a key, and not a task or a value.
fn is_key(word: &str) -> bool {
    let dotted = word.contains('.') && !word.contains('=') && !OwnTask::is_path(word);
    dotted || layers::default_of(word).is_ok()
}

/// A setting's value and origin, its default and description, and whether it affects the result of a run.
fn explained(config: &RunConfig, key: &str) -> anyhow::Result<String> {
    let remark = effect::remarks(config)(key);
    let weight = match keys::weighted_term(key) {
        None => None,
        Some(_) if !remark.is_empty() => return Err(Usage::new(format!("{key}{remark}")).into()),
        Some(term) => {
            Some(config.task.weight_in_file(term).map_err(|why| Usage::new(why.to_string()))?)
        }
    };
    let of_weight = "weight of this term of the task's reward or cost";
    let (file, meaning) = presets::description(key).unwrap_or(("the task's file", of_weight));
    let default = match (weight, layers::default_of(key)) {
        (Some(weight), _) => weight.to_string(),
        (None, default) => default?.to_string(),
    };
    let (value, origin) = if config.resolved.entries.contains_key(key) {
        (config.resolved.shown(key), config.resolved.origin(key))
    } else if weight.is_some() {
        (default.clone(), file)
    } else if !remark.is_empty() {
        // The remark names what it needs.
        ("not set".to_owned(), "nothing")
    } else {
        ("not set".to_owned(), "nothing (a run has it only if it is given)")
    };
    let matters = keys::is_semantic(key) || config.resolved.semantic().any(|(it, _)| it == key);
    let effect = if key == keys::START {
        "the policies are part of config_sha256, by their SHA-256, not their place"
    } else if matters {
        "part of config_sha256: another value is another run"
    } else {
        "affects no result of the steps that are trained"
    };
    let lines = [
        format!("{key} = {value}"),
        format!("  set by   {origin}{remark}"),
        format!("  default  {default}"),
        format!("  meaning  {meaning}"),
        format!("  effect   {effect}"),
    ];
    Ok(lines.join("\n"))
}

/// `s2mia inspect`
#[derive(Args, Debug)]
#[command(mut_arg("run", |run| run.help("Run folder, or one of its checkpoints [default: the newest run in ./runs]")))]
pub(crate) struct InspectArguments {
    /// Policies.
    #[command(flatten)]
    pub(crate) of: ChosenArguments,
    /// Print one JSON object.
    #[arg(long)]
    pub(crate) json: bool,
}

/// Iteration, env steps and both hashes.
pub(super) fn inspect(arguments: &InspectArguments) -> anyhow::Result<()> {
    let run = arguments.of.path()?;
    if pretrained::named(&run)?.is_some() {
        let why = "is a trained team, which has no checkpoint; `s2mia eval` shows what it can do";
        return Err(Usage::new(format!("{} {why}", run.display())).into());
    }
    let loaded = stored::load(&run)?;
    // The hashes identify a checkpoint whatever the settings beside it are.
    if let Ok((file, config)) = stored::settings_of_run(&run)
        && let Err(why) = stored::demand_own_checkpoint(&run, &loaded, (&file, &config))
    {
        tracing::warn!("{why}");
    }
    let checkpoint = &loaded.checkpoint;
    let (weights, state) = (checkpoint.weights_sha256(), checkpoint.state_sha256());
    if arguments.json {
        let object = json!({
            "iteration": checkpoint.iteration,
            "env_steps": checkpoint.env_steps,
            "weights_sha256": weights,
            "state_sha256": state,
        });
        output::line(object);
        return Ok(());
    }
    output::line(format!("checkpoint     {}", loaded.path.display()));
    output::line(format!("iteration      {}", checkpoint.iteration));
    output::line(format!("env steps      {}", checkpoint.env_steps));
    output::line(format!("weights_sha256 {weights}"));
    output::line(format!("state_sha256   {state}"));
    Ok(())
}
