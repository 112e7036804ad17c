//! What stands on the topics of a live view now, so that whoever comes late sees it at once.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{Context, FoxgloveError, PartialMetadata, RawChannel};
use tokio::runtime::Handle;

use crate::recording::sink::Schema;

/// Every topic with its newest message.
#[derive(Default)]
pub(super) struct Shelf {
    topics: Mutex<Vec<Topic>>,
}

struct Topic {
    channel: Arc<RawChannel>,
    /// Time, nanoseconds since 1970, and message.
    newest: Option<(u64, Vec<u8>)>,
}

impl Shelf {
    /// Declares a topic; gives its place. The server tells viewers of a topic shortly before it takes subscriptions to
    /// it. On `network`, whose one thread hears them, no viewer can be faster.
    pub(super) fn add(
        self: &Arc<Self>,
        (context, network): (&Arc<Context>, &Handle),
        topic: &str,
        schema: &Schema<'_>,
    ) -> Result<usize, FoxgloveError> {
        let own = foxglove::Schema::new(schema.name, schema.encoding, schema.data.to_vec());
        let channel = context.channel_builder(topic).message_encoding(schema.messages).schema(own);
        let shelf = Arc::clone(self);
        let added = network.spawn(async move {
            let mut topics = shelf.topics();
            topics.push(Topic { channel: channel.build_raw()?, newest: None });
            Ok(topics.len() - 1)
        });
        network.block_on(added).expect("the thread lives as long as the server")
    }

    /// Topics so far.
    pub(super) fn len(&self) -> usize {
        self.topics().len()
    }

    /// Whether anybody looks at the topic.
    pub(super) fn is_watched(&self, place: usize) -> bool {
        self.topics()[place].channel.has_sinks()
    }

    /// Shows a message to all who look at the topic, and later to those who come. Nobody is waited for: what a viewer
    /// does not read in time is lost for it.
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

impl ServerListener for Shelf {
    // The lock keeps an older message from overtaking a newer one.
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
