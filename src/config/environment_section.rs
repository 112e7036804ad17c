//! The section `environment_service`: the external program that offers the environment.

use proto::Episodes;
use recording::trajectory_log::LogSettings;
use serde::Deserialize;

/// The section `environment_service`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct EnvironmentSection {
    /// URL of the program that offers the environment; empty: the simulator.
    pub(crate) url: String,
    /// SHA-256 of that program's description of the environment; empty without a program and before the start.
    pub(crate) description: String,
}

impl EnvironmentSection {
    /// Arguments that give an actor process the URL.
    pub(crate) fn arguments(&self) -> Vec<String> {
        match self.url.as_str() {
            "" => Vec::new(),
            url => vec!["--environment".to_owned(), url.to_owned()],
        }
    }

    /// Refuses settings that only the simulator supports.
    pub(crate) fn validate(&self, log: LogSettings) -> Result<(), String> {
        if log.episodes != Episodes::None {
            return Err("log.episodes must be none with environment_service.url: \
                        the simulator's episodes alone are logged"
                .to_owned());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::config::run_config::RunConfig;
    use crate::config::{Request, layers};

    fn refused(more: &str) -> Option<String> {
        let settings =
            vec!["environment_service.url=http://localhost:7".to_owned(), more.to_owned()];
        let resolved = layers::resolve(&Request { settings, ..Request::default() }).unwrap();
        RunConfig::build(resolved).err().map(|error| error.to_string())
    }

    #[test]
    fn what_the_simulator_alone_can_do_is_refused_for_an_environment_from_outside() {
        for norm in ["running", "feature_z", "none"] {
            assert_eq!(refused(&format!("observation.norm={norm}")), None);
        }
        let message = refused("log.episodes=all").unwrap();
        assert!(message.contains("log.episodes must be none"), "{message}");
    }
}
