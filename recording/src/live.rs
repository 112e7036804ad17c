//! Live view for Foxglove over its WebSocket protocol: episodes on the topics of a trajectory log
//! ([`crate::trajectory_log`]) and additional topics.
//!
//! Viewers can only read. A new subscriber receives the newest message of its topic immediately. A slow viewer loses
//! the oldest queued messages. The server never waits for viewers.

mod sink;
mod topic_cache;

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::ops::{ControlFlow, Range};
use std::sync::Arc;

use foxglove::{AppUrl, Context, FoxgloveError, WebSocketServerHandle};
use policy::PolicySnapshot;
use proto::trajectory_log::Share;
use proto::{ActionChoice, WeightsName};
use rollout::{Episode, EvaluationEpisode, PlayedStep, play_while};
use serde_json::{Value, json};
use sim::{EnvironmentBatch, Robot};
use thiserror::Error;
use tokio::runtime::Runtime;

use crate::channels::ShareChannels;
use crate::error::RecordError;
use crate::sink::{Channel, Sink as _};
use crate::step_reader::StepReader;
use crate::trajectory_log::evaluation_head;
use sink::{LiveSink, now_nanos};
use topic_cache::TopicCache;

/// Capacity of a viewer's queue, messages: half a second of the robot with the most topics and the shortest steps.
const BACKLOG: usize = 512;

/// Why the live view cannot start.
#[derive(Debug, Error)]
pub enum LiveError {
    /// The port is in use, or the address does not belong to this machine.
    #[error(transparent)]
    Listen(std::io::Error),
    /// The network thread cannot be started.
    #[error("cannot start the network thread: {0}")]
    Thread(std::io::Error),
    /// The server cannot be started.
    #[error(transparent)]
    Server(FoxgloveError),
}

/// Server of the live view. It runs on a separate thread until it is dropped.
pub struct LiveServer {
    context: Arc<Context>,
    cache: Arc<TopicCache>,
    address: SocketAddr,
    _server: WebSocketServerHandle,
    network: Runtime,
}

impl LiveServer {
    /// Listens on `address`; port 0 selects a free port. Viewers see `name`.
    ///
    /// # Errors
    /// If the port is in use or the thread cannot be started. Panics inside another runtime.
    pub fn open(address: SocketAddr, name: &str) -> Result<Self, LiveError> {
        let network = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("viewers")
            .enable_all()
            .build()
            .map_err(LiveError::Thread)?;
        let (context, cache) = (Context::new(), Arc::new(TopicCache::default()));
        let server = context
            .websocket_server()
            .name(name)
            .bind(host(address.ip()), address.port())
            .message_backlog_size(BACKLOG)
            .listener(cache.clone());
        let server = network.block_on(server.start()).map_err(|error| match error {
            FoxgloveError::Bind(why) => LiveError::Listen(why),
            other => LiveError::Server(other),
        })?;
        let address = SocketAddr::new(address.ip(), server.port());
        Ok(Self { context, cache, address, _server: server, network })
    }

    /// URL for "Open connection" in Foxglove; with the loopback address if the server listens on all addresses.
    #[must_use]
    pub fn url(&self) -> String {
        let here = match self.address.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => IpAddr::V4(Ipv4Addr::LOCALHOST),
            IpAddr::V6(ip) if ip.is_unspecified() => IpAddr::V6(Ipv6Addr::LOCALHOST),
            ip => ip,
        };
        format!("ws://{}", SocketAddr::new(here, self.address.port()))
    }

    /// Link that opens Foxglove with this connection.
    #[must_use]
    pub fn link(&self) -> String {
        AppUrl::new().with_websocket(self.url()).to_string()
    }

    /// Creates a topic of JSON objects; `schema` is a JSON schema with a title.
    ///
    /// # Errors
    /// If the topic cannot be created. Panics inside a runtime.
    pub fn topic(&self, topic: &str, schema: &Value) -> Result<LiveTopic, RecordError> {
        let channel = self.sink().json_channel(topic, schema)?;
        Ok(LiveTopic { cache: Arc::clone(&self.cache), place: channel.id().into() })
    }

    /// Creates the topics for episodes in environments like `world`.
    ///
    /// # Errors
    /// If a topic cannot be created. Panics inside a runtime.
    pub fn scene(&self, world: &dyn EnvironmentBatch) -> Result<LiveScene, RecordError> {
        let first = self.cache.len();
        let mut sink = self.sink();
        let run = sink.json_channel("/run", &run_schema())?;
        let description = world.description();
        let shapes = world.robot().map(Robot::shapes).unwrap_or_default();
        let channels = ShareChannels::create(&mut sink, description, &shapes)?;
        let dt_nanos = (description.dt_secs * 1e9).round() as u64;
        let cache = Arc::clone(&self.cache);
        let places = first..cache.len();
        Ok(LiveScene { sink, channels, run, dt_nanos, cache, places })
    }

    fn sink(&self) -> LiveSink {
        let network = self.network.handle().clone();
        LiveSink::new(Arc::clone(&self.context), network, Arc::clone(&self.cache))
    }
}

/// An additional topic of JSON messages.
pub struct LiveTopic {
    cache: Arc<TopicCache>,
    place: usize,
}

impl LiveTopic {
    /// Whether the topic has subscribers.
    #[must_use]
    pub fn is_watched(&self) -> bool {
        self.cache.is_watched(self.place)
    }

    /// Sends a message, which replaces the previous one.
    pub fn show(&self, message: &Value) {
        self.cache.show(self.place, now_nanos(), message.to_string().as_bytes());
    }
}

/// Topics on which episodes are shown.
pub struct LiveScene {
    sink: LiveSink,
    channels: ShareChannels,
    run: Channel,
    dt_nanos: u64,
    cache: Arc<TopicCache>,
    places: Range<usize>,
}

impl LiveScene {
    /// Whether any topic has subscribers.
    #[must_use]
    pub fn is_watched(&self) -> bool {
        is_watched(&self.cache, &self.places)
    }

    /// Sends the run and the policy on `/run`.
    ///
    /// # Errors
    /// If the message cannot be sent.
    pub fn describe(&mut self, words: &BTreeMap<String, String>) -> Result<(), RecordError> {
        self.sink.set_clock();
        self.sink.write(&mut self.run, json!(words).to_string().as_bytes())
    }

    /// Shows the current state of environment 0 of `world`.
    ///
    /// # Errors
    /// If a message cannot be encoded.
    pub fn stand(&mut self, world: &dyn EnvironmentBatch) -> Result<(), RecordError> {
        self.sink.set_clock();
        self.channels.scene(&mut self.sink)?;
        self.channels.pose(&mut self.sink, &world.pose(0))
    }

    /// Plays an evaluation episode of the policy with mean actions, in real time, until it ends or no topic has
    /// subscribers, and then pauses for a second. `after_step` is called after each step.
    ///
    /// # Errors
    /// If the episode fails, or a message cannot be encoded.
    pub fn play(
        &mut self,
        world: &mut dyn EnvironmentBatch,
        (policy, weights): (&PolicySnapshot, WeightsName),
        episode: EvaluationEpisode,
        mut after_step: impl FnMut(),
    ) -> Result<Episode, RecordError> {
        world.reset(0, 0, world.description().episode_steps, episode.key().0)?;
        let state = world.encode(0)?;
        let head = evaluation_head(episode, weights, 0);
        self.sink.set_clock();
        self.channels.begin(&mut self.sink, &Share { environment_state: state, ..head })?;
        self.channels.pose(&mut self.sink, &world.pose(0))?;
        let (mut reader, mut shown) = (StepReader::new(world), Ok(()));
        let acting = (policy, ActionChoice::Mean);
        let played = play_while(world, acting, &mut |step: &PlayedStep<'_>| {
            shown = self.show(&mut reader, step);
            after_step();
            match shown.is_ok() && self.is_watched() {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            }
        })?;
        shown?;
        self.channels.end(&mut self.sink, &reader.end())?;
        self.sink.pause();
        Ok(played)
    }

    /// Shows a step and the robot after it.
    fn show(&mut self, reader: &mut StepReader, step: &PlayedStep<'_>) -> Result<(), RecordError> {
        self.channels.step(&mut self.sink, &reader.read(step))?;
        self.sink.advance(self.dt_nanos);
        self.channels.pose(&mut self.sink, &step.world.pose(0))
    }
}

fn is_watched(cache: &TopicCache, places: &Range<usize>) -> bool {
    places.clone().any(|place| cache.is_watched(place))
}

/// Formats an address for use before a port.
fn host(address: IpAddr) -> String {
    match address {
        IpAddr::V4(four) => four.to_string(),
        IpAddr::V6(six) => format!("[{six}]"),
    }
}

fn run_schema() -> Value {
    let words = ["task", "algorithm", "seed", "iteration", "env_steps", "config_sha256"];
    let properties = words.map(|word| (word.to_owned(), json!({ "type": "string" })));
    let properties = properties.into_iter().collect::<serde_json::Map<_, _>>();
    json!({ "title": "s2mia.Run", "type": "object", "properties": properties })
}
