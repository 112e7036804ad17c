//! The arguments that decide a run's configuration.

use std::path::PathBuf;

use clap::Args;

/// How help calls the settings of a command that takes some.
pub(super) const VALUE_NAME: &str = "TASK | KEY=VALUE";

/// What decides the configuration.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct SettingsArguments {
    /// Task, then settings as key.path=value.
    #[arg(value_name = VALUE_NAME)]
    pub(crate) settings: Vec<String>,
    /// TOML file with settings; may be given several times, later ones win.
    #[arg(long = "config", value_name = "FILE")]
    pub(crate) files: Vec<PathBuf>,
    /// Train in the environment that a program offers there; TASK then only says whose settings to take. Short for
    /// environment_service.url=URL.
    #[arg(long, value_name = "URL")]
    pub(crate) environment: Option<String>,
}

impl SettingsArguments {
    /// All settings as key.path=value, those with a flag of their own among them.
    pub(crate) fn written(&self) -> Vec<String> {
        let url = self.environment.iter().map(|url| format!("environment_service.url={url}"));
        self.settings.iter().cloned().chain(url).collect()
    }
}
