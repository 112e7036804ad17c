//! The section `environment_service`: the external program that offers the environment.

use actor::LogSettings;
use proto::Episodes;
use serde::Deserialize;
use sim::{ObservationConfig, ObservationNorm};

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
    pub(crate) fn validate(
        &self,
        observation: &ObservationConfig,
        log: LogSettings,
    ) -> Result<(), String> {
        if observation.norm == ObservationNorm::FeatureZ {
            return Err(
                "observation.norm must be none or running with environment_service.url, is feature_z: \
                        the simulator alone scales what it shows"
                    .to_owned(),
            );
        }
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
        assert_eq!(refused("observation.norm=running"), None);
        for (setting, key) in [
            ("observation.norm=feature_z", "observation.norm"),
            ("log.episodes=all", "log.episodes"),
        ] {
            let message = refused(setting).unwrap();
            assert!(message.contains(&format!("{key} must be none")), "{message}");
        }
    }
}
