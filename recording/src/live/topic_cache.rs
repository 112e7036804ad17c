//! Newest message of each topic of a live view, which new subscribers receive immediately.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{Context, FoxgloveError, PartialMetadata, RawChannel};
use tokio::runtime::Handle;

use crate::sink::Schema;

/// All topics with their newest messages.
#[derive(Default)]
pub(super) struct TopicCache {
    topics: Mutex<Vec<Topic>>,
}

struct Topic {
    channel: Arc<RawChannel>,
    /// Time (nanoseconds since 1970) and message.
    newest: Option<(u64, Vec<u8>)>,
}

impl TopicCache {
    /// Creates a topic and returns its index. The server announces a topic shortly before it accepts subscriptions to
    /// it. The topic is created on `network`, whose only thread also receives subscriptions, so that none can arrive in
    /// between.
    pub(super) fn add(
        self: &Arc<Self>,
        (context, network): (&Arc<Context>, &Handle),
        topic: &str,
        schema: &Schema<'_>,
        about: &BTreeMap<String, String>,
    ) -> Result<usize, FoxgloveError> {
        let own = foxglove::Schema::new(schema.name, schema.encoding, schema.data.to_vec());
        let channel = context.channel_builder(topic).message_encoding(schema.messages).schema(own);
        let channel = channel.metadata(about.clone());
        let cache = Arc::clone(self);
        let added = network.spawn(async move {
            let mut topics = cache.topics();
            topics.push(Topic { channel: channel.build_raw()?, newest: None });
            Ok(topics.len() - 1)
        });
        network.block_on(added).expect("the thread lives as long as the server")
    }

    /// Number of topics.
    pub(super) fn len(&self) -> usize {
        self.topics().len()
    }

    /// Whether the topic has subscribers.
    pub(super) fn is_watched(&self, place: usize) -> bool {
        self.topics()[place].channel.has_sinks()
    }

    /// Sends a message to all subscribers and stores it for later ones. Never blocks: a viewer loses messages that it
    /// does not read in time.
    pub(super) fn show(&self, place: usize, nanos: u64, message: &[u8]) {
        let topic = &mut self.topics()[place];
        topic.channel.log_with_meta(message, PartialMetadata::with_log_time(nanos));
        let (time, kept) = topic.newest.get_or_insert_default();
        *time = nanos;
        kept.clear();
        kept.extend_from_slice(message);
    }

    fn topics(&self) -> MutexGuard<'_, Vec<Topic>> {
        self.topics.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ServerListener for TopicCache {
    // The lock prevents a newer message from being sent before this one.
    fn on_subscribe(&self, viewer: Client, channel: ChannelView<'_>) {
        let topics = self.topics();
        let Some(topic) = topics.iter().find(|topic| topic.channel.id() == channel.id()) else {
            return;
        };
        if let Some((nanos, message)) = &topic.newest {
            let time = PartialMetadata::with_log_time(*nanos);
            topic.channel.log_with_meta_to_sink(message, time, viewer.sink_id());
        }
    }
}
