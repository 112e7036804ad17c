//! Source of an actor's environments: the simulator or an external program.

use proto::RunDescription;
use sim::{EnvironmentBatch, ObservationNorm, SimError, TaskConfig};

use crate::config::ActorConfig;
use crate::error::ActorError;
use crate::outside::EnvironmentService;

/// Source of environments.
#[derive(Clone)]
pub(crate) enum EnvironmentSource {
    /// The simulator, with the run's settings.
    Simulator(TaskConfig),
    /// An external program.
    Service(Box<EnvironmentService>),
}

impl EnvironmentSource {
    /// Source that `config` selects for `run`.
    pub(crate) async fn of(config: &ActorConfig, run: &RunDescription) -> Result<Self, ActorError> {
        if let Some(url) = &config.environment {
            let norm = if run.environment.feature_z {
                ObservationNorm::FeatureZ
            } else {
                ObservationNorm::None
            };
            let service = EnvironmentService::connect(url).await?.scaled(norm);
            return Ok(Self::Service(Box::new(service)));
        }
        if run.task_settings.is_empty() {
            return Err(ActorError::Task(format!(
                "{} is an external environment; pass --environment with its URL",
                run.environment.task
            )));
        }
        let task = serde_json::from_str(&run.task_settings);
        Ok(Self::Simulator(task.map_err(|error| ActorError::Task(error.to_string()))?))
    }

    /// Task of the simulator; `None` for external environments, which cannot be logged.
    pub(crate) fn task(&self) -> Option<&TaskConfig> {
        match self {
            Self::Simulator(task) => Some(task),
            Self::Service(_) => None,
        }
    }

    /// Opens `count` environments. Call it inside a tokio runtime.
    pub(crate) fn open(&self, count: usize) -> Result<Box<dyn EnvironmentBatch>, SimError> {
        match self {
            Self::Simulator(task) => sim::environments(task, count),
            Self::Service(service) => Ok(Box::new(service.environments(count))),
        }
    }
}
