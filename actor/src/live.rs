//! What is shown to Foxglove while it happens, over its WebSocket protocol: episodes on the topics of a recording
//! ([`crate::recording`]), and whatever else is put on topics beside them.
//!
//! Viewers come and go and can only look. One that comes late gets the newest message of every topic at once; one that
//! is slow loses the oldest ones that wait for it. Nobody is ever waited for.

mod shelf;
mod sink;

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::ops::{ControlFlow, Range};
use std::sync::Arc;

use foxglove::{AppUrl, Context, FoxgloveError, WebSocketServerHandle};
use policy::{Key, PolicySnapshot};
use serde_json::{Value, json};
use sim::EnvironmentBatch;
use thiserror::Error;
use tokio::runtime::Runtime;

use crate::evaluation::Episode;
use crate::recording::channels::Channels;
use crate::recording::sink::{Channel, Sink as _};
use crate::recording::{RecordError, show_episode};
use shelf::Shelf;
use sink::{LiveSink, now_nanos};

/// Messages that wait for a slow viewer at most: half a second of the robot with the most topics and the shortest steps.
const BACKLOG: usize = 512;

/// Why nothing can be shown.
#[derive(Debug, Error)]
pub enum LiveError {
    /// Something else has the port, or the address is not this machine's.
    #[error(transparent)]
    Listen(std::io::Error),
    /// The network's thread does not start.
    #[error("cannot start the network thread: {0}")]
    Thread(std::io::Error),
    /// The server does not start.
    #[error(transparent)]
    Server(FoxgloveError),
}

/// Where viewers come in. It serves them on one thread of its own, until it is dropped.
pub struct LiveServer {
    context: Arc<Context>,
    shelf: Arc<Shelf>,
    address: SocketAddr,
    _server: WebSocketServerHandle,
    network: Runtime,
}

impl LiveServer {
    /// Listens at `address`, port 0 being any free one; viewers see `name`.
    ///
    /// # Errors
    /// If the port is taken or the thread cannot be started. Panics inside another runtime.
    pub fn open(address: SocketAddr, name: &str) -> Result<Self, LiveError> {
        let network = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("viewers")
            .enable_all()
            .build()
            .map_err(LiveError::Thread)?;
        let (context, shelf) = (Context::new(), Arc::new(Shelf::default()));
        let server = context
            .websocket_server()
            .name(name)
            .bind(host(address.ip()), address.port())
            .message_backlog_size(BACKLOG)
            .listener(shelf.clone());
        let server = network.block_on(server.start()).map_err(|error| match error {
            FoxgloveError::Bind(why) => LiveError::Listen(why),
            other => LiveError::Server(other),
        })?;
        let address = SocketAddr::new(address.ip(), server.port());
        Ok(Self { context, shelf, address, _server: server, network })
    }

    /// What is entered under "Open connection" in Foxglove; on this machine, where it is served on every address.
    #[must_use]
    pub fn url(&self) -> String {
        let here = match self.address.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => IpAddr::V4(Ipv4Addr::LOCALHOST),
            IpAddr::V6(ip) if ip.is_unspecified() => IpAddr::V6(Ipv6Addr::LOCALHOST),
            ip => ip,
        };
        format!("ws://{}", SocketAddr::new(here, self.address.port()))
    }

    /// A link that opens Foxglove with this connection.
    #[must_use]
    pub fn link(&self) -> String {
        AppUrl::new().with_websocket(self.url()).to_string()
    }

    /// A topic of JSON objects; `schema` is a JSON schema with a title.
    ///
    /// # Errors
    /// If the topic is refused. Panics inside a runtime.
    pub fn topic(&self, topic: &str, schema: &Value) -> Result<LiveTopic, RecordError> {
        let channel = self.sink().json_channel(topic, schema)?;
        Ok(LiveTopic { shelf: Arc::clone(&self.shelf), place: channel.id().into() })
    }

    /// A stage for episodes in worlds like `world`.
    ///
    /// # Errors
    /// If a topic is refused. Panics inside a runtime.
    pub fn scene(&self, world: &dyn EnvironmentBatch) -> Result<LiveScene, RecordError> {
        let first = self.shelf.len();
        let mut sink = self.sink();
        let run = sink.json_channel("/run", &run_schema())?;
        let channels = Channels::create(sink, world)?;
        let shelf = Arc::clone(&self.shelf);
        Ok(LiveScene { channels, run, places: first..shelf.len(), shelf })
    }

    fn sink(&self) -> LiveSink {
        let network = self.network.handle().clone();
        LiveSink::new(Arc::clone(&self.context), network, Arc::clone(&self.shelf))
    }
}

/// A topic beside those of the episodes.
pub struct LiveTopic {
    shelf: Arc<Shelf>,
    place: usize,
}

impl LiveTopic {
    /// Whether anybody looks at it.
    #[must_use]
    pub fn is_watched(&self) -> bool {
        self.shelf.is_watched(self.place)
    }

    /// Shows a message, which takes the place of the one before.
    pub fn show(&self, message: &Value) {
        self.shelf.show(self.place, now_nanos(), message.to_string().as_bytes());
    }
}

/// Where episodes are shown.
pub struct LiveScene {
    channels: Channels<LiveSink>,
    run: Channel,
    shelf: Arc<Shelf>,
    places: Range<usize>,
}

impl LiveScene {
    /// Whether anybody looks at any of its topics.
    #[must_use]
    pub fn is_watched(&self) -> bool {
        is_watched(&self.shelf, &self.places)
    }

    /// Says on `/run` which run and policy is shown.
    ///
    /// # Errors
    /// If the message is refused.
    pub fn describe(&mut self, words: &BTreeMap<String, String>) -> Result<(), RecordError> {
        self.channels.sink.set_clock();
        self.channels.sink.write(&mut self.run, json!(words).to_string().as_bytes())
    }

    /// Shows environment 0 of `world` as it stands.
    ///
    /// # Errors
    /// If a message cannot be encoded.
    pub fn stand(&mut self, world: &dyn EnvironmentBatch) -> Result<(), RecordError> {
        self.channels.sink.set_clock();
        self.channels.begin(world)
    }

    /// Plays episode `index` from a start drawn with `key`, in real time, to its end or until nobody looks any more;
    /// then a second passes. `after_step` is called after each step.
    ///
    /// # Errors
    /// If the episode breaks down, or a message cannot be encoded.
    pub fn play(
        &mut self,
        (world, policy): (&mut dyn EnvironmentBatch, &PolicySnapshot),
        (index, key): (u32, Key),
        mut after_step: impl FnMut(),
    ) -> Result<Episode, RecordError> {
        world.reset(0, 0, world.description().episode_steps, key.0)?;
        self.channels.sink.set_clock();
        show_episode((world, policy), index, &mut self.channels, || {
            after_step();
            match is_watched(&self.shelf, &self.places) {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            }
        })
    }
}

fn is_watched(shelf: &Shelf, places: &Range<usize>) -> bool {
    places.clone().any(|place| shelf.is_watched(place))
}

/// As it stands before a port.
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
