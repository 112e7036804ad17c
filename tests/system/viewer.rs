//! A live-view client that uses Foxglove's WebSocket protocol.

use std::collections::BTreeMap;
use std::net::TcpStream;
use std::time::Duration;

use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

/// WebSocket subprotocol of Foxglove.
const PROTOCOL: &str = "foxglove.sdk.v1";
/// Header size of a data message: opcode, subscription id and time, bytes.
const HEAD: usize = 1 + 4 + 8;

/// A connected viewer.
pub(crate) struct Viewer {
    socket: WebSocket<TcpStream>,
    /// The server's advertised channels by topic.
    pub(crate) topics: BTreeMap<String, Value>,
    /// Topics by subscription id.
    subscribed: Vec<String>,
}

impl Viewer {
    /// Connects to `url`.
    pub(crate) fn connect(url: &str) -> Self {
        let stream = TcpStream::connect(url.strip_prefix("ws://").unwrap()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let mut request = url.into_client_request().unwrap();
        request.headers_mut().insert("sec-websocket-protocol", PROTOCOL.parse().unwrap());
        let (socket, answer) = tungstenite::client(request, stream).unwrap();
        assert_eq!(answer.headers()["sec-websocket-protocol"], PROTOCOL);
        Self { socket, topics: BTreeMap::new(), subscribed: Vec::new() }
    }

    /// Waits until a topic is advertised.
    pub(crate) fn wait_for(&mut self, topic: &str) {
        while !self.topics.contains_key(topic) {
            self.read();
        }
    }

    /// Subscribes to topics as soon as they are advertised.
    pub(crate) fn subscribe(&mut self, topics: &[&str]) {
        topics.iter().for_each(|topic| self.wait_for(topic));
        let first = self.subscribed.len();
        self.subscribed.extend(topics.iter().map(|topic| (*topic).to_owned()));
        let wanted = topics.iter().enumerate().map(
            |(index, topic)| json!({ "id": first + index, "channelId": self.topics[*topic]["id"] }),
        );
        let wanted = wanted.collect::<Vec<_>>();
        let text = json!({ "op": "subscribe", "subscriptions": wanted }).to_string();
        self.socket.send(Message::text(text)).unwrap();
    }

    /// The next message: its topic, time and bytes.
    pub(crate) fn next(&mut self) -> (String, u64, Vec<u8>) {
        loop {
            if let Some(found) = self.read() {
                return found;
            }
        }
    }

    /// The next message on a topic.
    pub(crate) fn next_on(&mut self, topic: &str) -> Vec<u8> {
        loop {
            let (found, _, bytes) = self.next();
            if found == topic {
                return bytes;
            }
        }
    }

    /// The next JSON object on a topic.
    pub(crate) fn json_on(&mut self, topic: &str) -> Value {
        serde_json::from_slice(&self.next_on(topic)).unwrap()
    }

    fn read(&mut self) -> Option<(String, u64, Vec<u8>)> {
        match self.socket.read().unwrap() {
            Message::Text(text) => {
                let message: Value = serde_json::from_str(&text).unwrap();
                let channels = message["channels"].as_array().cloned().unwrap_or_default();
                for channel in channels {
                    self.topics.insert(channel["topic"].as_str().unwrap().to_owned(), channel);
                }
                None
            }
            Message::Binary(bytes) => {
                assert_eq!(bytes[0], 1, "not a data message");
                let number = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                let nanos = u64::from_le_bytes(bytes[5..HEAD].try_into().unwrap());
                let topic = self.subscribed[number as usize].clone();
                Some((topic, nanos, bytes[HEAD..].to_vec()))
            }
            _ => None,
        }
    }
}
