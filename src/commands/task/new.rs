//! `s2mia task new`: a task file with its model to begin with.

use std::path::{Path, PathBuf};

use clap::Args;
use sim::TaskDefinition;

use crate::config::presets;
use crate::errors::Usage;
use crate::process::target::ForceArguments;
use crate::process::{output, shell, target};

/// `s2mia task new`
#[derive(Args, Debug)]
pub(crate) struct TaskNewArguments {
    /// Folder of the new files; it is made if necessary.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,
    /// Robot of the program, such as ant, or one of its tasks, whose settings but those of MADDPG are copied as well [default: a hopper].
    #[arg(long, value_name = "ROBOT | TASK")]
    pub(crate) from: Option<String>,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// Writes the example, or the copy.
pub(super) fn new(arguments: &TaskNewArguments) -> anyhow::Result<()> {
    if arguments.folder.to_str().is_none() {
        // No command could name the task.
        return Err(Usage::new(shell::not_text(&[arguments.folder.clone().into()])).into());
    }
    let definition = match &arguments.from {
        None => TaskDefinition::example(),
        Some(name) => copy(name)?,
    };
    let named = arguments.from.as_deref().unwrap_or_default();
    let partitions = definition.partitions()?;
    let own = partitions.iter().find(|partition| named.ends_with(&format!("-{partition}")));
    let partition = own.or(partitions.first()).filter(|_| partitions.len() > 1);
    let TaskDefinition { file, model } = definition;
    let model_name = TaskDefinition::model_of(&file)?;
    let texts = [(model_name.replace(".xml", ".toml"), file), (model_name, model)];
    let texts = texts.map(|(name, text)| (arguments.folder.join(name), text));
    let paths = texts.iter().map(|(path, _)| path.clone());
    target::demand_free("DIR", paths, arguments.force.existing())?;
    target::option_folder("DIR", &arguments.folder)?;
    for (path, text) in &texts {
        target::file(path, text.as_bytes())?;
    }
    let shown = texts[0].0.display();
    let task = match partition {
        Some(partition) => PathBuf::from(format!("{shown}:{partition}")),
        None => texts[0].0.clone(),
    };
    let (check, train) = (shell::path(&task), setting(&task));
    output::line(format!("{shown}: next `s2mia task check {check}`, then `s2mia train {train}`"));
    Ok(())
}

/// The file and model of a robot or task of the program, with the settings of the task.
fn copy(name: &str) -> anyhow::Result<TaskDefinition> {
    let mut copy =
        TaskDefinition::like(name).map_err(|error| Usage::new(format!("--from: {error}")))?;
    let settings = presets::find(presets::TASKS, name).map(|preset| preset.text.parse());
    let mut settings: toml::Table = settings.transpose()?.unwrap_or_default();
    // Settings of a task file count as the user's, and without its learning rule this section would be refused.
    settings.remove("maddpg");
    if !settings.is_empty() {
        let settings = toml::Table::from_iter([("settings".to_owned(), settings.into())]);
        copy.file += &format!("\n{settings}");
    }
    Ok(copy)
}

/// A path as the task of `s2mia train`, in which an argument with `=` is a setting.
fn setting(task: &Path) -> String {
    if task.to_string_lossy().contains('=') {
        shell::word(&format!("task={}", task.display()))
    } else {
        shell::path(task)
    }
}
