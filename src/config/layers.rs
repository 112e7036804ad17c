//! Reads the layers of a configuration and lays them over each other. Later layers win; no layer may
//! bring a key that neither `configs/base.toml` nor an algorithm's file has.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use toml::{Table, Value};

use super::keys;
use super::known::{
    DEFAULTS, Values, first_inside, known, names, own_section, spelled, tip, wrong_kind,
};
use super::own_task::OwnTask;
use super::presets::{self, Preset};
use super::resolved::{ConfigError, Resolved, line_and_message};

/// Prefix of the environment variables that are settings: `S2MIA__UPDATE__GAMMA` is `update.gamma`.
pub(crate) const ENVIRONMENT_PREFIX: &str = "S2MIA__";

/// Prefix of the variables among which one may be meant as a setting; others of them are other programs'.
const ALIKE_PREFIX: &str = "S2MIA_";

/// How the command line is called in messages.
const COMMAND_LINE: &str = "command line";

/// How an environment variable is called in messages.
pub(crate) const VARIABLE: &str = "environment variable";

/// Whether a setting of this origin was written for this command, and not in a file.
pub(crate) fn is_of_this_command(origin: &str) -> bool {
    origin == COMMAND_LINE || origin.starts_with(VARIABLE)
}

/// A configuration file larger than this is a mistake. That of a run has the model of its task, of 4 MiB at most, with escapes.
const FILE_LIMIT_BYTES: u64 = 12 << 20;

/// Values of one place.
pub(super) struct SettingsLayer {
    /// The place, as messages and `s2mia config` name it.
    pub(super) place: String,
    /// Who chose the values.
    pub(super) source: Source,
    /// Each of the default's kind.
    pub(super) values: Values,
}

/// Who chose the values of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// The program, or the run that is resumed.
    Program,
    /// The user.
    User,
    /// The user, by repeating a whole configuration; values that equal those of the layers below are not the user's choice.
    Repeated,
}

/// What the user asks for, in the order of the layers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Request {
    /// The resolved configuration of a run to resume, instead of the task's, preset's and algorithm's files.
    pub(crate) resumed: Option<PathBuf>,
    /// Files given with `--config`, later ones win.
    pub(crate) files: Vec<PathBuf>,
    /// Environment variables that begin with the program's name.
    pub(crate) environment: Vec<(String, OsString)>,
    /// Arguments `key.path=value`; a first one without `=` is the task.
    pub(crate) settings: Vec<String>,
    /// Where `settings` are written, if not on the command line.
    pub(crate) settings_place: Option<String>,
}

impl Request {
    /// A request with this process's environment variables.
    pub(crate) fn from_process(files: Vec<PathBuf>, settings: Vec<String>) -> Self {
        let environment = std::env::vars_os()
            .filter_map(|(name, value)| Some((name.into_string().ok()?, value)))
            .filter(|(name, _)| name.starts_with(ALIKE_PREFIX))
            .collect();
        Self { files, environment, settings, ..Self::default() }
    }
}

/// Lays all layers of a request over the defaults.
pub(crate) fn resolve(request: &Request) -> Result<Resolved, ConfigError> {
    let mut asked = asked_layers(request)?;
    let own = OwnTask::of(&asked)?;
    let mut layers = vec![base_layer()];
    layers.extend(named_sections(&asked));
    match &request.resumed {
        Some(file) => {
            let (place, text) = read(file)?;
            layers.push(table_layer(&place, &text)?);
            // What the run has already is not given again.
            asked.iter_mut().for_each(|layer| layer.source = Source::Repeated);
        }
        None => layers.extend(named_layers(&asked, own.as_ref())?),
    }
    layers.extend(asked);
    layers.extend(own.map(|own| own.identity()));
    Ok(Resolved::laid_over(layers))
}

/// `configs/base.toml` alone.
fn base_layer() -> SettingsLayer {
    let place = presets::BASE.path.to_owned();
    let values = DEFAULTS.clone();
    SettingsLayer { place, source: Source::Program, values }
}

/// The sections of algorithms of which the layers name a setting, which is then read and refused as any other.
fn named_sections(asked: &[SettingsLayer]) -> impl Iterator<Item = SettingsLayer> {
    let is_named = |key: &String| asked.iter().any(|layer| layer.values.contains_key(key));
    presets::ALGORITHMS.iter().filter_map(move |algorithm| {
        let (place, values) = (algorithm.path.to_owned(), own_section(*algorithm));
        let layer = SettingsLayer { place, source: Source::Program, values };
        layer.values.keys().any(is_named).then_some(layer)
    })
}

/// The layers that the user wrote: files, environment, command line.
fn asked_layers(request: &Request) -> Result<Vec<SettingsLayer>, ConfigError> {
    let mut layers = Vec::new();
    for file in &request.files {
        layers.push(given_file(file)?);
    }
    for (name, value) in &request.environment {
        let Some(key) = name.strip_prefix(ENVIRONMENT_PREFIX) else {
            refuse_if_meant(name)?;
            continue;
        };
        let key = key.to_lowercase().replace("__", ".");
        let place = format!("{VARIABLE} {name}");
        let not_text = || ConfigError::at(&place, "it is not UTF-8 text");
        layers.push(setting_layer(&place, &key, value.to_str().ok_or_else(not_text)?)?);
    }
    let place = request.settings_place.as_deref().unwrap_or(COMMAND_LINE);
    for (position, argument) in request.settings.iter().enumerate() {
        let (key, value) = match argument.split_once('=') {
            Some((key, value)) => (key.trim(), value.trim()),
            None if position == 0 => ("task", argument.as_str()),
            None => return Err(misplaced(argument)),
        };
        layers.push(setting_layer(place, key, value)?);
    }
    Ok(layers)
}

/// Refuses a variable that spells a setting without being one, which would change nothing unnoticed.
fn refuse_if_meant(name: &str) -> Result<(), ConfigError> {
    let word = name[ALIKE_PREFIX.len()..].to_lowercase();
    let weight = word.split_once('_').map(|(section, term)| format!("{section}.{term}"));
    let weight = weight.filter(|key| keys::weighted_term(key).is_some());
    let meant: Vec<String> = spelled(&word).into_iter().map(str::to_owned).chain(weight).collect();
    if meant.is_empty() {
        return Ok(());
    }
    let variable =
        |key: &String| format!("{ENVIRONMENT_PREFIX}{}", key.to_uppercase().replace('.', "__"));
    let meant = meant.iter().map(variable).collect::<Vec<_>>().join(" or ");
    Err(ConfigError::Other(format!("environment variable {name} is no setting; write {meant}")))
}

/// What an argument without a value is, that is not the first.
fn misplaced(argument: &str) -> ConfigError {
    let is_task_file = || argument.ends_with(".toml") && Path::new(argument).is_file();
    ConfigError::Other(match presets::find(presets::TASKS, argument) {
        None if is_task_file() => format!(
            "`{argument}` is a task file, and the task comes first, before all settings; a resumed run keeps its task"
        ),
        Some(_) => format!("`{argument}` is a task, and the task comes first, before all settings"),
        None => {
            format!("`{argument}` is no setting; write key.path=value, for example run.seed=7")
        }
    })
}

/// The files of the task, the preset and the algorithm that the other layers choose. What a preset says for one algorithm
/// on one task (`algorithm.NAME.TASK`) is above the algorithm's file, everything else of it below.
fn named_layers(
    asked: &[SettingsLayer],
    own: Option<&OwnTask>,
) -> Result<Vec<SettingsLayer>, ConfigError> {
    let (task, mut layers) = task_layers(asked, own)?;
    let algorithm = chosen("algorithm", presets::ALGORITHMS, asked)?;
    let preset = chosen("preset", presets::PRESETS, asked)?;
    let mut general = parsed(preset.path, preset.text)?;
    let of_task = taken(&mut general, "task", &[&task]);
    let of_algorithm = taken(&mut general, "algorithm", &[algorithm.name, &task]);
    layers.push(laid_out(preset.path, &general)?);
    layers.push(laid_out(preset.path, &of_task)?);
    for file in presets::of_algorithm(algorithm.name) {
        layers.push(preset_layer(file)?);
    }
    layers.push(laid_out(preset.path, &of_algorithm)?);
    Ok(layers)
}

/// Takes the table called `name` out of `from`; what it holds under `path`, or nothing.
fn taken(from: &mut Table, name: &str, path: &[&str]) -> Table {
    let mut found = from.remove(name);
    for step in path {
        found = found.and_then(|mut inside| inside.as_table_mut()?.remove(*step));
    }
    found.and_then(|inside| inside.as_table().cloned()).unwrap_or_default()
}

/// Name and settings of the task. An environment from outside has none unless a task is named: the default's would be
/// those of another robot.
fn task_layers(
    asked: &[SettingsLayer],
    own: Option<&OwnTask>,
) -> Result<(String, Vec<SettingsLayer>), ConfigError> {
    let Some(own) = own else {
        if names_outside(asked) && !asked.iter().any(|layer| layer.values.contains_key("task")) {
            return Ok((String::new(), Vec::new()));
        }
        let task = chosen("task", presets::TASKS, asked)?;
        return Ok((task.name.to_owned(), vec![preset_layer(task)?]));
    };
    let settings = laid_out(&own.place, &own.settings()?)?;
    let settings = SettingsLayer { source: Source::User, ..settings };
    Ok((own.name.clone(), vec![settings]))
}

/// Whether the environment comes from outside.
fn names_outside(asked: &[SettingsLayer]) -> bool {
    let url = asked.iter().rev().find_map(|layer| layer.values.get(keys::URL)?.as_str());
    url.is_some_and(|url| !url.is_empty())
}

fn chosen(
    kind: &'static str,
    known: &[Preset],
    asked: &[SettingsLayer],
) -> Result<Preset, ConfigError> {
    let given = asked.iter().rev().find(|layer| layer.values.contains_key(kind));
    let (place, values) = match given {
        Some(layer) => (layer.place.as_str(), &layer.values),
        None => (presets::BASE.path, &*DEFAULTS),
    };
    let name = values[kind].as_str().expect("every layer is fitted to base.toml, where it is text");
    presets::find(known, name).ok_or_else(|| {
        if kind == "task" && Path::new(name).is_dir() {
            return ConfigError::at(place, format!("`{name}` is a folder; name a task file in it"));
        }
        let section = format!("{name}.");
        if let Some(key) = names().find(|key| key.starts_with(&section)) {
            let why =
                format!("`{name}` is a section of settings, no {kind}; name a key such as {key}");
            return ConfigError::at(place, why);
        }
        let names: Vec<&str> = known.iter().map(|preset| preset.name).collect();
        let tip = tip(name, names.iter().copied());
        let known = names.join(", ");
        ConfigError::at(place, format!("unknown {kind} `{name}`{tip}; known: {known}"))
    })
}

fn preset_layer(preset: Preset) -> Result<SettingsLayer, ConfigError> {
    table_layer(preset.path, preset.text)
}

/// The settings of a file that the user gives. A file of the program keeps its meaning, and one with every semantic key, as
/// `s2mia config` prints them and as runs keep them, repeats what the program would choose.
fn given_file(path: &Path) -> Result<SettingsLayer, ConfigError> {
    let (place, text) = read(path)?;
    let layer = table_layer(&place, &text)?;
    let mut semantic = DEFAULTS.keys().filter(|key| keys::is_semantic(key));
    let source = if presets::is_text_of_one(&text) {
        Source::Program
    } else if semantic.all(|key| layer.values.contains_key(key)) {
        Source::Repeated
    } else {
        Source::User
    };
    Ok(SettingsLayer { source, ..layer })
}

/// The name of a file for messages, and its text.
fn read(path: &Path) -> Result<(String, String), ConfigError> {
    let place = path.display().to_string();
    let unreadable = |error| ConfigError::at(&place, error);
    let file = File::open(path).map_err(unreadable)?;
    let mut bytes = Vec::new();
    // The size of a pipe or a device is unknown.
    file.take(FILE_LIMIT_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > FILE_LIMIT_BYTES {
        let detail = format!("it has more than {FILE_LIMIT_BYTES} bytes");
        return Err(ConfigError::at(place, detail));
    }
    match String::from_utf8(bytes) {
        Ok(text) => Ok((place, text)),
        Err(_) => Err(ConfigError::at(place, "it is not UTF-8 text")),
    }
}

fn table_layer(place: &str, text: &str) -> Result<SettingsLayer, ConfigError> {
    laid_out(place, &parsed(place, text)?)
}

/// A table's values under their dotted keys, each of the default's kind.
fn laid_out(place: &str, table: &Table) -> Result<SettingsLayer, ConfigError> {
    let mut values = BTreeMap::new();
    for (key, value) in keys::leaves(table) {
        // An empty section.
        if value.is_table() && (first_inside(&key).is_some() || keys::is_weights(&key)) {
            continue;
        }
        let default = known(place, &key)?;
        let fitted = keys::fitted(value.clone(), default);
        let wrong = || wrong_kind(place, &key, keys::kind(default), &value.to_string());
        let fitted = fitted.ok_or_else(wrong)?;
        values.insert(key, fitted);
    }
    Ok(SettingsLayer { place: place.to_owned(), source: Source::Program, values })
}

fn setting_layer(place: &str, key: &str, text: &str) -> Result<SettingsLayer, ConfigError> {
    let default = known(place, key)?;
    let value = keys::parsed(text, default)
        .ok_or_else(|| wrong_kind(place, key, keys::kind(default), &format!("`{text}`")))?;
    let values = BTreeMap::from([(key.to_owned(), value)]);
    Ok(SettingsLayer { place: place.to_owned(), source: Source::User, values })
}

/// The default under `key`, which the user names instead of a value.
///
/// # Errors
/// If there is no such setting.
pub(crate) fn default_of(key: &str) -> Result<&'static Value, ConfigError> {
    known(COMMAND_LINE, key)
}

fn parsed(place: &str, text: &str) -> Result<Table, ConfigError> {
    text.parse().map_err(|error| {
        let (line, detail) = line_and_message(text, &error);
        ConfigError::at(format!("{place}:{line}"), detail)
    })
}

#[cfg(test)]
mod tests;
