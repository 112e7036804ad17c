//! A finished run shared by the tests of one file, and its environment.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use sim::EnvironmentBatch;

use crate::runs::{Runs, train};

/// The run's folder. The first call trains it, with a setting such as `run.iterations=2`.
pub(crate) fn folder(iterations: &str) -> &'static Path {
    static RUN: OnceLock<(Runs, PathBuf)> = OnceLock::new();
    let (_, folder) = RUN.get_or_init(|| {
        let runs = Runs::new();
        let folder = runs.folder("trained");
        train(&folder, &[iterations]);
        (runs, folder)
    });
    folder
}

/// The environment of a run.
pub(crate) fn world(folder: &Path) -> Box<dyn EnvironmentBatch> {
    let settings = std::fs::read_to_string(folder.join("config.toml")).unwrap();
    let settings: toml::Table = settings.parse().unwrap();
    let task = sim::TaskConfig {
        task: settings["task"].as_str().unwrap().to_owned(),
        definition: None,
        observation: settings["observation"].clone().try_into().unwrap(),
    };
    sim::environments(&task, 1).unwrap()
}
