//! Where an actor's environments come from: the simulator, or a program that offers them.

use proto::{EnvironmentSpec, RunDescription};
use sim::{EnvironmentBatch, TaskConfig};

use crate::config::Config;
use crate::error::ActorError;
use crate::identity::environment_spec;
use crate::outside::EnvironmentService;

/// Where environments come from.
pub(crate) enum Source {
    /// Built from the run's own settings.
    Simulator(TaskConfig),
    /// Stepped by another program.
    Service(Box<EnvironmentService>),
}

impl Source {
    /// What `config` says, for `run`.
    pub(crate) async fn of(config: &Config, run: &RunDescription) -> Result<Self, ActorError> {
        if let Some(url) = &config.environment {
            return Ok(Self::Service(Box::new(EnvironmentService::connect(url).await?)));
        }
        if run.task_settings.is_empty() {
            return Err(ActorError::Task(format!(
                "{} is offered by another program: pass --environment with its URL",
                run.environment.task
            )));
        }
        let task = serde_json::from_str(&run.task_settings);
        Ok(Self::Simulator(task.map_err(|error| ActorError::Task(error.to_string()))?))
    }

    /// The simulator's task, if it is one of those: only these can be logged.
    pub(crate) fn task(&self) -> Option<&TaskConfig> {
        match self {
            Self::Simulator(task) => Some(task),
            Self::Service(_) => None,
        }
    }

    /// What is presented to the learner.
    pub(crate) fn spec(&self) -> Result<EnvironmentSpec, ActorError> {
        match self {
            Self::Simulator(task) => Ok(environment_spec(simulated(task, 1)?.description())),
            Self::Service(service) => Ok(service.spec().clone()),
        }
    }

    /// `count` environments.
    pub(crate) fn open(&self, count: usize) -> Result<Box<dyn EnvironmentBatch>, ActorError> {
        Ok(match self {
            Self::Simulator(task) => simulated(task, count)?,
            Self::Service(service) => Box::new(service.environments(count)),
        })
    }
}

fn simulated(task: &TaskConfig, count: usize) -> Result<Box<dyn EnvironmentBatch>, ActorError> {
    sim::environments(task, count).map_err(|error| ActorError::Task(error.to_string()))
}
