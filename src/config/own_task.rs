//! A task that the settings name by the path of its file. The texts of the file and of its model, with all files that the
//! model names, become settings, so that they take part in the hash of the settings and travel with the run.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use learner::store::plain_file;
use proto::name;
use sim::TaskDefinition;
use toml::Value;

use crate::process::shell;

use super::layers::{SettingsLayer, Source};
use super::resolved::ConfigError;

/// Text of the task file; empty for a task of the program.
pub(crate) const FILE: &str = "task_file.text";
/// Text of the model that the file names.
pub(crate) const MODEL: &str = "task_file.model";

/// Largest task file.
const FILE_BYTES: u64 = 256 << 10;
/// Largest model as one document, which is part of every `config.toml` of the run and twice in its description for actors.
const MODEL_BYTES: u64 = 4 << 20;
/// Largest file that a model names.
const MODEL_FILE_BYTES: u64 = 64 << 20;

/// A task that is not part of the program.
#[derive(Clone, Debug)]
pub(crate) struct OwnTask {
    /// File that defines it, for messages.
    pub(crate) place: String,
    /// Name of the task.
    pub(crate) name: String,
    /// Texts of the file and of its model.
    pub(crate) definition: TaskDefinition,
}

impl OwnTask {
    /// The task that these layers define: by the path of its file, or with its texts, as the settings of a run do.
    pub(super) fn of(asked: &[SettingsLayer]) -> Result<Option<Self>, ConfigError> {
        let text = |key: &str| {
            asked.iter().rev().find_map(|layer| match layer.values.get(key) {
                Some(Value::String(text)) if !text.is_empty() => Some((text.clone(), &layer.place)),
                _ => None,
            })
        };
        let Some((name, place)) = text("task") else { return Ok(None) };
        if let Some(read) = Self::read(&name) {
            return read.map(Some);
        }
        let (Some((file, _)), Some((model, _))) = (text(FILE), text(MODEL)) else {
            return Ok(None);
        };
        let definition = TaskDefinition { file, model };
        Self { place: place.clone(), name, definition }.checked().map(Some)
    }

    /// The settings that define the task, in the place of the path of its file.
    pub(super) fn identity(&self) -> SettingsLayer {
        let TaskDefinition { file, model } = &self.definition;
        let texts = [("task", &self.name), (FILE, file), (MODEL, model)];
        let values = texts.map(|(key, text)| (key.to_owned(), Value::from(text.as_str())));
        let values = BTreeMap::from(values);
        SettingsLayer { place: self.place.clone(), source: Source::Program, values }
    }

    /// Reads the file that `task` names: `FILE.toml`, or `FILE.toml:PARTITION` if the file has several partitions. `None`
    /// if `task` is no path.
    pub(crate) fn read(task: &str) -> Option<Result<Self, ConfigError>> {
        let (path, partition) = match task.rsplit_once(".toml:") {
            Some((path, partition)) => (format!("{path}.toml"), Some(partition)),
            None => (task.to_owned(), None),
        };
        Self::is_path(task).then(|| {
            let whole = shell::expanded(Path::new(&path)).map_err(|error| refused(&path, error))?;
            Self::of_file(&whole, partition)
        })
    }

    /// Whether `task` is the path of a file, with or without a partition. A model is refused as one.
    pub(crate) fn is_path(task: &str) -> bool {
        [".toml", ".xml"].iter().any(|ending| task.ends_with(ending))
            || task.contains(".toml:")
            || task.contains(std::path::is_separator)
    }

    fn of_file(path: &Path, partition: Option<&str>) -> Result<Self, ConfigError> {
        let place = path.display().to_string();
        let file = text(path)?;
        if file.trim_start_matches('\u{feff}').trim_start().starts_with('<') {
            let why = "is a model (XML), not a task file; pass the TOML file that names it as `model`; `s2mia task new DIR` writes an example";
            return Err(refused(&place, why));
        }
        let model = TaskDefinition::model_of(&file).map_err(|error| refused(&place, error))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let model = one_document(folder, &model).map_err(|error| refused(&place, error))?;
        let definition = TaskDefinition { file, model };
        let names = definition.task_names().map_err(|error| refused(&place, error))?;
        let partitions = definition.partitions().map_err(|error| refused(&place, error))?;
        let name = match (partition, names.as_slice()) {
            (None, [name]) => Some(name),
            (None, _) => None,
            (Some(partition), names) => {
                partitions.iter().position(|known| known == partition).map(|index| &names[index])
            }
        };
        let Some(name) = name else {
            let known = partitions.iter().map(|partition| format!("{place}:{partition}"));
            let known = known.collect::<Vec<_>>().join(", ");
            return Err(refused(&place, format!("name one of its partitions: {known}")));
        };
        Self { name: name.clone(), place, definition }.checked()
    }

    /// Builds the task once.
    fn checked(self) -> Result<Self, ConfigError> {
        let refuse = |error: &dyn std::fmt::Display| refused(&self.place, error);
        for name in self.definition.check(&self.name).map_err(|error| refuse(&error))? {
            let why = |error| refuse(&format!("the name {name:?} in the model {error}"));
            name::check(&name, name::LONGEST).map_err(why)?;
        }
        Ok(self)
    }

    /// The table `settings` of the file.
    pub(crate) fn settings(&self) -> Result<toml::Table, ConfigError> {
        let text = self.definition.settings().map_err(|error| refused(&self.place, error))?;
        let table: toml::Table = text.parse().map_err(|error| refused(&self.place, error))?;
        let chosen = ["task", "algorithm", "preset", "task_file"];
        match chosen.into_iter().find(|key| table.contains_key(*key)) {
            None => Ok(table),
            Some(key) => {
                let why = "is chosen on the command line, not in a task file";
                Err(refused(&self.place, format!("settings.{key}: `{key}` {why}")))
            }
        }
    }
}

fn text(path: &Path) -> Result<String, ConfigError> {
    let place = path.display().to_string();
    plain_file::named_text(path, FILE_BYTES).map_err(|error| match error.kind() {
        ErrorKind::NotFound => {
            refused(&place, "there is no such task file; `s2mia task new DIR` writes one")
        }
        _ => refused(&place, error),
    })
}

/// Text of the model `document` in `folder`, with all files that it needs.
fn one_document(folder: &Path, document: &str) -> Result<String, String> {
    let read = |path: &str| {
        let bytes = inside(folder, path).and_then(|file| {
            plain_file::named(&file, MODEL_FILE_BYTES).map_err(|error| error.to_string())
        });
        bytes.map_err(|error| format!("{path}: {error}"))
    };
    let text = sim::one_document(document, read).map_err(|error| error.to_string())?;
    match text.len() as u64 {
        0..=MODEL_BYTES => Ok(text),
        size => Err(format!(
            "the model {document} has {size} bytes as one document, at most {MODEL_BYTES} travel with a run: remove what it \
             does not need, and use meshes with fewer corners and height fields with fewer heights"
        )),
    }
}

/// Place of a file of the model. Its content travels with the run, so a link must not lead out of the folder.
fn inside(folder: &Path, path: &str) -> Result<PathBuf, String> {
    let resolved = |path: &Path| {
        path.canonicalize().map_err(|error| match error.kind() {
            ErrorKind::NotFound => format!("{error}; add it, or correct the name"),
            _ => error.to_string(),
        })
    };
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let (folder, file) = (resolved(folder)?, resolved(&folder.join(path))?);
    if !file.starts_with(&folder) {
        return Err("it is a link that leaves the task file's folder; copy the file".to_owned());
    }
    Ok(file)
}

fn refused(place: &str, error: impl std::fmt::Display) -> ConfigError {
    // What cannot be built of a model is listed line by line.
    let lines: Vec<String> = error.to_string().lines().map(name::printable).collect();
    ConfigError::at(place, lines.join("\n  "))
}
