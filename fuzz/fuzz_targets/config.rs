//! Settings as a user writes them: files, a resumed run's file, environment variables and arguments. What is refused is
//! refused in one line; what is taken can be written and read again.
#![no_main]
#![expect(dead_code, reason = "the command line's modules also hold what only its commands call")]

/// As `src/config.rs` has them; the command line is no library.
#[path = "."]
mod config {
    #[path = "../../src/config/conditions.rs"]
    pub(crate) mod conditions;
    #[path = "../../src/config/effect.rs"]
    pub(crate) mod effect;
    #[path = "../../src/config/keys.rs"]
    pub(crate) mod keys;
    #[path = "../../src/config/known.rs"]
    pub(crate) mod known;
    #[path = "../../src/config/layers.rs"]
    pub(crate) mod layers;
    #[path = "../../src/config/message_steps.rs"]
    pub(crate) mod message_steps;
    #[path = "../../src/config/own_task.rs"]
    pub(crate) mod own_task;
    #[path = "../../src/config/presets.rs"]
    pub(crate) mod presets;
    #[path = "../../src/config/resolved.rs"]
    pub(crate) mod resolved;
    #[path = "../../src/config/rules.rs"]
    pub(crate) mod rules;
    #[path = "../../src/config/run_config.rs"]
    pub(crate) mod run_config;

    pub(crate) use layers::Request;
    pub(crate) use resolved::{ConfigError, Resolved};
}

#[path = "../../src/errors.rs"]
mod errors;
#[path = "."]
mod process {
    #[path = "../../src/process/shell.rs"]
    pub(crate) mod shell;
}

/// Settings under test start from no policies: those would be read from the files of another run.
mod run {
    pub(crate) mod start {
        use crate::config::ConfigError;
        use crate::config::run_config::RunConfig;

        pub(crate) fn identify(config: &mut RunConfig) -> Result<(), ConfigError> {
            config.resolved.remove_start();
            Ok(())
        }
    }
}

use std::path::{Path, PathBuf};

use config::run_config::RunConfig;
use config::{ConfigError, Request, Resolved, layers};
use libfuzzer_sys::fuzz_target;
use tempfile::TempDir;

thread_local! {
    static FOLDER: TempDir = tempfile::tempdir().expect("a folder for the file under test");
}

fuzz_target!(|data: &[u8]| {
    let Some((kind, bytes)) = data.split_first() else { return };
    let file = FOLDER.with(|folder| folder.path().join("settings.toml"));
    match resolved(kind % 4, bytes, &file) {
        Err(error) => is_one_line(&error),
        Ok(settings) => {
            survives(&settings, &file);
            build(settings);
        }
    }
});

fn resolved(kind: u8, bytes: &[u8], file: &Path) -> Result<Resolved, ConfigError> {
    let lines = String::from_utf8_lossy(bytes).lines().map(str::to_owned).collect::<Vec<_>>();
    let variable = |line: &String| {
        let (name, value) = line.split_once('=')?;
        Some((format!("{}{name}", layers::ENVIRONMENT_PREFIX), value.to_owned()))
    };
    layers::resolve(&match kind {
        0 => Request { files: vec![written(file, bytes)], ..Request::default() },
        1 => Request { resumed: Some(written(file, bytes)), ..Request::default() },
        2 => Request {
            environment: lines.iter().filter_map(variable).collect(),
            ..Request::default()
        },
        _ => Request { settings: lines, ..Request::default() },
    })
}

fn written(file: &Path, bytes: &[u8]) -> PathBuf {
    std::fs::write(file, bytes).expect("the temporary folder takes a file");
    file.to_owned()
}

fn is_one_line(error: &ConfigError) {
    let line = error.to_string();
    assert!(!line.is_empty() && !line.contains('\n'), "{line:?}");
}

fn survives(settings: &Resolved, file: &Path) {
    let resumed = Some(written(file, settings.to_toml().as_bytes()));
    let again = layers::resolve(&Request { resumed, ..Request::default() });
    let again = again.expect("resolved settings can be read again");
    assert_eq!(again.to_toml(), settings.to_toml());
    assert_eq!(again.sha256(), settings.sha256());
}

fn build(settings: Resolved) {
    match RunConfig::build(settings) {
        Ok(config) => {
            assert!(config.iterations() > 0 && config.env_steps() > 0 && config.actors() > 0);
        }
        Err(error) => is_one_line(&error),
    }
}
