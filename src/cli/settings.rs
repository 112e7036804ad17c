//! The arguments that define a run's configuration.

use std::path::PathBuf;

use clap::Args;

/// Placeholder for the settings of a command in help texts.
pub(super) const VALUE_NAME: &str = "TASK | KEY=VALUE";

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
    #[arg(long, value_name = "URL")]
    pub(crate) environment: Option<String>,
}

impl SettingsArguments {
    /// All settings as key.path=value, including those given by a separate flag.
    pub(crate) fn written(&self) -> Vec<String> {
        let url = self.environment.iter().map(|url| format!("environment_service.url={url}"));
        self.settings.iter().cloned().chain(url).collect()
    }
}
