//! The environment of a run: the simulator's, or one that an external program offers.

use actor::{EnvironmentService, Transport};
use anyhow::Context as _;
use learner::lease::end_states::StateReader;
use proto::EnvironmentSpec;
use sim::{Disturbances, EnvironmentBatch, State};
use tokio::runtime::Runtime;

use crate::config::ConfigError;
use crate::config::keys::URL;
use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::process::runtime;

/// The environment that every actor of a run must step.
pub(crate) struct Offered {
    /// Description that learner and actors compare.
    pub(crate) spec: EnvironmentSpec,
    /// JSON from which actors build the environment; empty for an external program.
    pub(crate) task_settings: String,
    /// The setting `environment_service.description`; empty for the simulator, which its settings describe.
    pub(crate) description: String,
    /// Decodes the environment's states.
    pub(crate) decoder: StateReader,
    /// How an episode continues in another slot: `encoded` for the simulator, else as the external program supports.
    pub(crate) states: &'static str,
}

impl Offered {
    /// Builds the simulator's environment, or queries the external program over what `transport` permits.
    pub(crate) fn of(config: &RunConfig, transport: &Transport) -> anyhow::Result<Self> {
        match config.environment.url.as_str() {
            "" => simulated(config),
            url => runtime()?.block_on(outside(url, config, transport)),
        }
    }

    /// Refuses another environment than the one with which the run of `config` started.
    pub(crate) fn demand_that_of(&self, config: &RunConfig) -> Result<(), ConfigError> {
        let before = &config.environment.description;
        let now = &self.description;
        if before == now {
            return Ok(());
        }
        let shown = |sha256: &str| match sha256 {
            "" => "the simulator's".to_owned(),
            sha256 => format!("one with the description {sha256}"),
        };
        let detail = format!(
            "the run's environment is {}, this is {}; start the program with that of the run",
            shown(before),
            shown(now)
        );
        Err(ConfigError::refused(&config.resolved, &[URL], &detail))
    }
}

fn simulated(config: &RunConfig) -> anyhow::Result<Offered> {
    let world = config.environments(1)?;
    let own = config.task.definition.as_ref().and_then(|_| world.robot());
    let left_out = own.map(sim::Robot::left_out).unwrap_or_default();
    left_out.iter().for_each(|what| tracing::warn!("left out: {what}"));
    // The user cannot change the tasks of the program.
    let warnings = own.map(|_| world.warnings()).unwrap_or_default();
    warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    let task_settings =
        serde_json::to_string(&config.task).context("cannot write the task's settings")?;
    let spec = world.description().clone();
    let bounds = world.state_bounds().cloned();
    let bounds = bounds.expect("robots and games have bounds of their states");
    let decoder = StateReader::new(move |state| match State::from_bytes(state, &bounds) {
        Ok(state) => Ok(state.position),
        Err(error) => Err(error.to_string()),
    });
    Ok(Offered { spec, task_settings, description: String::new(), decoder, states: "encoded" })
}

async fn outside(url: &str, config: &RunConfig, transport: &Transport) -> anyhow::Result<Offered> {
    demand_allowed(url, transport)?;
    let service =
        EnvironmentService::connect(url).await.context("cannot use the training environment")?;
    Ok(offered_by(&service.scaled(config.task.observation.norm)))
}

/// Checks that `transport` permits the connection, which is not encrypted.
fn demand_allowed(url: &str, transport: &Transport) -> Result<(), Usage> {
    let allowed = actor::config::check_environment(url, transport);
    allowed.map_err(|error| Usage::new(format!("{URL}: {error}")))
}

fn offered_by(service: &EnvironmentService) -> Offered {
    let (spec, states) = (service.spec.clone(), service.states.name());
    let description = spec.digest().to_string();
    let decode = service.state_decoder();
    let decoder = StateReader::new(move |state| decode(state).map_err(|error| error.to_string()));
    Offered { spec, task_settings: String::new(), description, decoder, states }
}

/// One environment of a run in this process.
pub(crate) struct RunEnvironment {
    /// The environment.
    pub(crate) environment: Box<dyn EnvironmentBatch>,
    /// The network threads of an external environment.
    _network: Option<Runtime>,
}

impl RunEnvironment {
    /// Builds the environment or connects to the external program; refuses another environment than the run's. Its episodes
    /// are those of evaluations.
    pub(crate) fn of(config: &RunConfig) -> anyhow::Result<Self> {
        let url = config.environment.url.as_str();
        if url.is_empty() {
            let mut environment = config.environments(1)?;
            environment.set_disturbances(Disturbances::AsInEvaluations);
            return Ok(Self { environment, _network: None });
        }
        demand_allowed(url, &Transport::PlainTextOnLoopback)?;
        let network = runtime()?;
        let environment = network.block_on(async {
            let service = EnvironmentService::connect(url).await?;
            let service = service.scaled(config.task.observation.norm);
            offered_by(&service).demand_that_of(config)?;
            anyhow::Ok(service.environments(1))
        });
        let environment = Box::new(environment.context("cannot use the environment of the run")?);
        Ok(Self { environment, _network: Some(network) })
    }
}
