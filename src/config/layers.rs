//! Reads the layers of a configuration and lays them over each other. Later layers win; no layer may
//! bring a key that `configs/base.toml` does not have.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::error::ConfigError;
use super::keys;
use super::layer::{Layer, Source};
use super::own_task::OwnTask;
use super::presets::{self, Preset};
use super::resolved::Resolved;
use super::scalar::Scalar;

/// Prefix of the environment variables that are settings: `S2MIA__UPDATE__GAMMA` is `update.gamma`.
pub(crate) const ENVIRONMENT_PREFIX: &str = "S2MIA__";

/// Prefix of the variables among which one may be meant as a setting; others of them are other programs'.
const ALIKE_PREFIX: &str = "S2MIA_";

/// How the command line is called in messages.
const COMMAND_LINE: &str = "command line";

/// How an environment variable is called in messages.
const VARIABLE: &str = "environment variable";

/// Whether a setting of this origin was written for this command, and not in a file.
pub(crate) fn is_of_this_command(origin: &str) -> bool {
    origin == COMMAND_LINE || origin.starts_with(VARIABLE)
}

/// A configuration file larger than this is a mistake.
const FILE_LIMIT_BYTES: u64 = 1 << 20;

/// What the user asks for, in the order of the layers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Request {
    /// The resolved configuration of a run to go on with; stands in the place of the task's, preset's and
    /// algorithm's files.
    pub(crate) resumed: Option<PathBuf>,
    /// Files given with `--config`, later ones win.
    pub(crate) files: Vec<PathBuf>,
    /// Environment variables that begin with the program's name.
    pub(crate) environment: Vec<(String, String)>,
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
            .map(|(name, value)| (name, value.to_string_lossy().into_owned()))
            .collect();
        Self { files, environment, settings, ..Self::default() }
    }
}

/// What a file of `configs/presets` says, by what it says it for.
struct PresetParts {
    /// Its sections: for every task and algorithm.
    general: toml::Table,
    /// `task.NAME`: for one task.
    of_task: toml::Table,
    /// `algorithm.NAME.TASK`: for one algorithm on one task.
    of_algorithm: toml::Table,
}

impl PresetParts {
    fn of(preset: Preset, task: &str, algorithm: &str) -> Result<Self, ConfigError> {
        let mut general = parsed(preset.path, preset.text)?;
        let of_task = taken(&mut general, "task", &[task]);
        let of_algorithm = taken(&mut general, "algorithm", &[algorithm, task]);
        Ok(Self { general, of_task, of_algorithm })
    }
}

/// Takes the table called `name` out of `from`; what it holds under `path`, or nothing.
fn taken(from: &mut toml::Table, name: &str, path: &[&str]) -> toml::Table {
    let mut found = from.remove(name);
    for step in path {
        found = found.and_then(|mut inside| inside.as_table_mut()?.remove(*step));
    }
    found.and_then(|inside| inside.as_table().cloned()).unwrap_or_default()
}

/// The defaults: every key that exists, and the kind of its value.
type Schema = BTreeMap<String, Scalar>;

/// Lays all layers of a request over the defaults.
pub(crate) fn resolve(request: &Request) -> Result<Resolved, ConfigError> {
    let base = base_layer();
    let schema = base.values.clone();
    let asked = asked_layers(request, &schema)?;
    let own = OwnTask::of(&asked)?;
    let mut layers = vec![base];
    match &request.resumed {
        Some(file) => layers.push(run_layer(file, &schema)?),
        None => layers.extend(named_layers(&layers[0], &asked, own.as_ref(), &schema)?),
    }
    // What the run has already is not given again.
    let of_the_run = |layer| Layer { source: Source::Repeated, ..layer };
    match request.resumed {
        Some(_) => layers.extend(asked.into_iter().map(of_the_run)),
        None => layers.extend(asked),
    }
    layers.extend(own.map(|own| own.identity()));
    Ok(Resolved::laid_over(layers))
}

/// `configs/base.toml` alone.
pub(crate) fn defaults() -> Resolved {
    Resolved::laid_over(vec![base_layer()])
}

/// `configs/base.toml`; a test shows that it is well formed.
fn base_layer() -> Layer {
    let table: toml::Table = presets::BASE.text.parse().expect("configs/base.toml is TOML");
    let mut values = BTreeMap::new();
    for (key, value) in leaves(&table) {
        values.insert(key, Scalar::from_toml(value).expect("configs/base.toml holds scalars"));
    }
    Layer { place: presets::BASE.path.to_owned(), source: Source::Program, values }
}

/// The layers that the user wrote: files, environment, command line.
fn asked_layers(request: &Request, schema: &Schema) -> Result<Vec<Layer>, ConfigError> {
    let mut layers = Vec::new();
    for file in &request.files {
        layers.push(given_file(file, schema)?);
    }
    for (name, value) in &request.environment {
        let Some(key) = name.strip_prefix(ENVIRONMENT_PREFIX) else {
            refuse_if_meant(name, schema)?;
            continue;
        };
        let key = key.to_lowercase().replace("__", ".");
        layers.push(setting_layer(&format!("{VARIABLE} {name}"), &key, value, schema)?);
    }
    let place = request.settings_place.as_deref().unwrap_or(COMMAND_LINE);
    for (position, argument) in request.settings.iter().enumerate() {
        let (key, value) = match argument.split_once('=') {
            Some((key, value)) => (key.trim(), value.trim()),
            None if position == 0 => ("task", argument.as_str()),
            None => return Err(misplaced(argument)),
        };
        layers.push(setting_layer(place, key, value, schema)?);
    }
    Ok(layers)
}

/// Refuses a variable that spells a setting without being one, which would change nothing unnoticed.
fn refuse_if_meant(name: &str, schema: &Schema) -> Result<(), ConfigError> {
    let word = name[ALIKE_PREFIX.len()..].to_lowercase();
    let meant = keys::spelled(&word, schema.keys().map(String::as_str));
    if meant.is_empty() {
        return Ok(());
    }
    let variable =
        |key: &&str| format!("{ENVIRONMENT_PREFIX}{}", key.to_uppercase().replace('.', "__"));
    let meant = meant.iter().map(variable).collect::<Vec<_>>().join(" or ");
    Err(ConfigError::NoVariable { name: name.to_owned(), meant })
}

/// What an argument without a value is, that is not the first.
fn misplaced(argument: &str) -> ConfigError {
    match presets::find(presets::TASKS, argument) {
        Some(_) => ConfigError::TaskNotFirst(argument.to_owned()),
        None => ConfigError::NoSetting(argument.to_owned()),
    }
}

/// Name and settings of the task. An environment from outside has none unless a task is named: the default's would be
/// those of another robot.
fn task_layers(
    base: &Layer,
    asked: &[Layer],
    own: Option<&OwnTask>,
    schema: &Schema,
) -> Result<(String, Vec<Layer>), ConfigError> {
    let Some(own) = own else {
        if names_outside(asked) && !asked.iter().any(|layer| layer.values.contains_key("task")) {
            return Ok((String::new(), Vec::new()));
        }
        let task = chosen("task", presets::TASKS, base, asked)?;
        return Ok((task.name.to_owned(), vec![preset_layer(task, schema)?]));
    };
    let settings = laid_out(&own.place, &own.settings()?, schema)?;
    Ok((own.name.clone(), vec![Layer { source: Source::User, ..settings }]))
}

/// The files of the task, the preset and the algorithm that the other layers choose. What a preset says for one algorithm
/// on one task stands above the algorithm's file, everything else of it below.
fn named_layers(
    base: &Layer,
    asked: &[Layer],
    own: Option<&OwnTask>,
    schema: &Schema,
) -> Result<Vec<Layer>, ConfigError> {
    let (task, of_task) = task_layers(base, asked, own, schema)?;
    let algorithm = chosen("algorithm", presets::ALGORITHMS, base, asked)?;
    let preset = chosen("preset", presets::PRESETS, base, asked)?;
    let parts = PresetParts::of(preset, &task, algorithm.name)?;
    let part = |table: &toml::Table| laid_out(preset.path, table, schema);
    let mut layers = of_task;
    layers.extend([
        part(&parts.general)?,
        part(&parts.of_task)?,
        preset_layer(algorithm, schema)?,
        part(&parts.of_algorithm)?,
    ]);
    Ok(layers)
}

/// Whether the environment comes from outside.
fn names_outside(asked: &[Layer]) -> bool {
    let url = asked.iter().rev().find_map(|layer| layer.values.get(keys::URL));
    url.is_some_and(|url| *url != Scalar::Text(String::new()))
}

fn chosen(
    kind: &'static str,
    known: &[Preset],
    base: &Layer,
    asked: &[Layer],
) -> Result<Preset, ConfigError> {
    let layer = asked.iter().rev().find(|layer| layer.values.contains_key(kind)).unwrap_or(base);
    let Some(Scalar::Text(name)) = layer.values.get(kind) else {
        unreachable!("`{kind}` is text in configs/base.toml, and every layer is fitted to it")
    };
    presets::find(known, name).ok_or_else(|| {
        let names: Vec<&str> = known.iter().map(|preset| preset.name).collect();
        ConfigError::UnknownName {
            place: layer.place.clone(),
            kind,
            name: name.clone(),
            nearest: keys::nearest(name, names.iter().copied()).map(str::to_owned),
            known: names.join(", "),
        }
    })
}

fn preset_layer(preset: Preset, schema: &Schema) -> Result<Layer, ConfigError> {
    table_layer(preset.path, preset.text, schema)
}

/// The settings of a file that the user gives. A file of the program keeps its meaning, and one with every semantic key, as
/// `s2mia config` prints them and as runs keep them, repeats what the program would choose.
fn given_file(path: &Path, schema: &Schema) -> Result<Layer, ConfigError> {
    let (place, text) = read(path)?;
    let layer = table_layer(&place, &text, schema)?;
    let mut semantic = schema.keys().filter(|key| keys::is_semantic(key));
    let source = match semantic.all(|key| layer.values.contains_key(key)) {
        _ if presets::is_text_of_one(&text) => Source::Program,
        true => Source::Repeated,
        false => Source::User,
    };
    Ok(Layer { source, ..layer })
}

/// The name of a file for messages, and its text.
fn read(path: &Path) -> Result<(String, String), ConfigError> {
    let place = path.display().to_string();
    let unreadable = |detail: String| ConfigError::Unreadable { place: place.clone(), detail };
    let size = std::fs::metadata(path).map_err(|e| unreadable(e.to_string()))?.len();
    if size > FILE_LIMIT_BYTES {
        return Err(unreadable(format!("{size} bytes, the limit is {FILE_LIMIT_BYTES}")));
    }
    let text = std::fs::read_to_string(path).map_err(|e| unreadable(e.to_string()))?;
    Ok((place, text))
}

/// The settings of a run folder.
fn run_layer(path: &Path, schema: &Schema) -> Result<Layer, ConfigError> {
    let (place, text) = read(path)?;
    table_layer(&place, &text, schema)
}

fn table_layer(place: &str, text: &str, schema: &Schema) -> Result<Layer, ConfigError> {
    laid_out(place, &parsed(place, text)?, schema)
}

/// A table's values under their dotted keys, each of the default's kind.
fn laid_out(place: &str, table: &toml::Table, schema: &Schema) -> Result<Layer, ConfigError> {
    let mut values = BTreeMap::new();
    for (key, value) in leaves(table) {
        if value.is_table() && is_section(&key, schema) {
            continue;
        }
        let default = known(place, &key, schema)?;
        let fitted = Scalar::from_toml(value).and_then(|scalar| scalar.fitted(default));
        let fitted = fitted.ok_or_else(|| wrong_kind(place, &key, default, &value.to_string()))?;
        values.insert(key, fitted);
    }
    Ok(Layer { place: place.to_owned(), source: Source::Program, values })
}

fn setting_layer(
    place: &str,
    key: &str,
    text: &str,
    schema: &Schema,
) -> Result<Layer, ConfigError> {
    let default = known(place, key, schema)?;
    let value = Scalar::parse(text, default)
        .ok_or_else(|| wrong_kind(place, key, default, &format!("`{text}`")))?;
    let values = BTreeMap::from([(key.to_owned(), value)]);
    Ok(Layer { place: place.to_owned(), source: Source::User, values })
}

fn is_section(key: &str, schema: &Schema) -> bool {
    schema.keys().any(|known| known.strip_prefix(key).is_some_and(|rest| rest.starts_with('.')))
}

/// The default under `key`, which tells the kind of value that belongs there.
fn known<'a>(place: &str, key: &str, schema: &'a Schema) -> Result<&'a Scalar, ConfigError> {
    if let Some(default) = schema.get(key) {
        return Ok(default);
    }
    let (place, section) = (place.to_owned(), format!("{key}."));
    if let Some(inside) = schema.keys().find(|known| known.starts_with(&section)) {
        let expected = format!("a table with keys such as `{inside}`");
        return Err(ConfigError::WrongKind {
            place,
            key: key.to_owned(),
            expected,
            found: "a value".into(),
        });
    }
    let nearest = keys::nearest(key, schema.keys().map(String::as_str)).map(str::to_owned);
    Err(ConfigError::UnknownKey { place, key: key.to_owned(), nearest })
}

fn wrong_kind(place: &str, key: &str, default: &Scalar, found: &str) -> ConfigError {
    let found = found.split_whitespace().collect::<Vec<_>>().join(" ");
    let expected = default.kind().to_owned();
    ConfigError::WrongKind { place: place.to_owned(), key: key.to_owned(), expected, found }
}

fn parsed(place: &str, text: &str) -> Result<toml::Table, ConfigError> {
    text.parse().map_err(|error| not_toml(place, text, &error))
}

/// A parser's message in one line, with the line of the file.
fn not_toml(place: &str, text: &str, error: &toml::de::Error) -> ConfigError {
    let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
    let line = before.matches('\n').count() + 1;
    let detail = error.message().split_whitespace().collect::<Vec<_>>().join(" ");
    ConfigError::Unreadable { place: format!("{place}:{line}"), detail }
}

/// Every value that is not a table, with its dotted path, and every empty table.
fn leaves(table: &toml::Table) -> Vec<(String, &toml::Value)> {
    let mut found = Vec::new();
    for (key, value) in table {
        match value {
            toml::Value::Table(inner) if !inner.is_empty() => {
                found.extend(leaves(inner).into_iter().map(|(k, v)| (format!("{key}.{k}"), v)));
            }
            _ => found.push((key.clone(), value)),
        }
    }
    found
}

#[cfg(test)]
mod tests;
