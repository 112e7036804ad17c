//! A run's environment: what the simulator builds from its settings, or what another program offers.

use actor::{EnvironmentService, Transport};
use anyhow::Context as _;
use proto::EnvironmentSpec;
use sim::EnvironmentBatch;
use tokio::runtime::Runtime;

use crate::commands::{Usage, runtime};
use crate::config::ConfigError;
use crate::run_config::RunConfig;

/// The setting that names the program.
const URL: &str = "environment_service.url";

/// What every actor of a run must step.
pub(crate) struct Offered {
    /// As learner and actors agree on it.
    pub(crate) spec: EnvironmentSpec,
    /// JSON from which actors build it; empty if another program steps it.
    pub(crate) task_settings: String,
    /// The setting `environment_service.description`: empty for the simulator, whose settings say everything.
    pub(crate) description: String,
    /// How an episode is brought back in another slot: `encoded` by the simulator, or as that program can.
    pub(crate) states: &'static str,
}

impl Offered {
    /// Builds the simulator's, or asks the program that offers it over what `transport` allows.
    pub(crate) fn of(config: &RunConfig, transport: &Transport) -> anyhow::Result<Self> {
        match config.environment.url.as_str() {
            "" => simulated(config),
            url => runtime()?.block_on(outside(url, transport)),
        }
    }

    /// Refuses another environment than the one with which the run of `config` began.
    pub(crate) fn demand_that_of(&self, config: &RunConfig) -> Result<(), ConfigError> {
        let (before, now) = (&config.environment.description, &self.description);
        if before == now {
            return Ok(());
        }
        let shown = |sha256: &str| match sha256 {
            "" => "the simulator's".to_owned(),
            sha256 => format!("one with the description {sha256}"),
        };
        Err(ConfigError::Refused {
            place: config.resolved.origin(URL).to_owned(),
            key: URL.to_owned(),
            detail: format!("the run's environment is {}, this is {}", shown(before), shown(now)),
        })
    }
}

fn simulated(config: &RunConfig) -> anyhow::Result<Offered> {
    let world = sim::environments(&config.task, 1).context("cannot build the task")?;
    let task_settings =
        serde_json::to_string(&config.task).context("cannot write the task's settings")?;
    let spec = actor::environment_spec(world.description());
    Ok(Offered { spec, task_settings, description: String::new(), states: "encoded" })
}

async fn outside(url: &str, transport: &Transport) -> anyhow::Result<Offered> {
    demand_allowed(url, transport)?;
    let service = EnvironmentService::connect(url).await.context("no environment to train in")?;
    Ok(offered_by(&service))
}

/// Nothing is encrypted on the way to that program.
fn demand_allowed(url: &str, transport: &Transport) -> Result<(), Usage> {
    let allowed = actor::config::check_environment(url, transport);
    allowed.map_err(|error| Usage::new(format!("{URL}: {error}")))
}

fn offered_by(service: &EnvironmentService) -> Offered {
    let (spec, states) = (service.spec().clone(), service.states().name());
    let description = spec.digest().to_string();
    Offered { spec, task_settings: String::new(), description, states }
}

/// One environment of a run, to be played here.
pub(crate) struct Stage {
    /// It.
    pub(crate) environment: Box<dyn EnvironmentBatch>,
    /// The network's threads, if it needs any.
    _network: Option<Runtime>,
}

impl Stage {
    /// Builds it, or connects to the program that offers it; refuses another one than the run's.
    pub(crate) fn of(config: &RunConfig) -> anyhow::Result<Self> {
        let url = config.environment.url.as_str();
        if url.is_empty() {
            let environment =
                sim::environments(&config.task, 1).context("cannot build the task")?;
            return Ok(Self { environment, _network: None });
        }
        demand_allowed(url, &Transport::PlainTextOnLoopback)?;
        let network = runtime()?;
        let environment = network.block_on(async {
            let service = EnvironmentService::connect(url).await?;
            offered_by(&service).demand_that_of(config)?;
            anyhow::Ok(service.environments(1))
        });
        let environment = Box::new(environment.context("no environment to play in")?);
        Ok(Self { environment, _network: Some(network) })
    }
}
