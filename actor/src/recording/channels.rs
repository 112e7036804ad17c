//! The file's channels, and the simulated clock that stamps their messages.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{Seek, Write};

use foxglove::Encode;
use foxglove::messages::{
    FrameTransform, FrameTransforms, JointState, JointStates, Quaternion, SceneUpdate, Timestamp,
    Vector3,
};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};
use serde_json::json;
use sim::{Environments, TaskConfig};

use super::{METADATA_NAME, RecordError};
use crate::evaluation::PlayedStep;

/// Simulated time between two episodes, nanoseconds.
const PAUSE_NANOS: u64 = 1_000_000_000;
/// Bytes of a chunk before it is compressed.
const CHUNK_BYTES: u64 = 1 << 20;

#[derive(Clone, Debug)]
struct Channel {
    id: u16,
    topic: String,
    sequence: u32,
}

/// An MCAP file in the making.
pub(super) struct Channels<W: Write + Seek> {
    writer: Writer<W>,
    show: Show,
    episode: Channel,
    /// For each agent its channel and how many numbers of the joint action are its own.
    actions: Vec<(Channel, usize)>,
    dt_nanos: u64,
    nanos: u64,
    messages: u64,
    buffer: Vec<u8>,
}

/// How the world is shown.
struct Show {
    /// Of a robot those of transforms, joints and scene; of a game the one of its state.
    channels: Vec<Channel>,
    /// Of a game the names of its global state's features.
    features: Option<Vec<String>>,
}

const TRANSFORMS: usize = 0;
const JOINTS: usize = 1;
const SCENE: usize = 2;
const STATE: usize = 0;

impl Show {
    fn create(
        writer: &mut Writer<impl Write + Seek>,
        world: &Environments,
    ) -> Result<Self, RecordError> {
        if world.pose(0).links.is_empty() {
            let state = world.description().state.iter();
            let features: Vec<String> = state.map(|feature| feature.name.clone()).collect();
            let channels = vec![json_channel(writer, "/state", &state_schema(&features))?];
            return Ok(Self { channels, features: Some(features) });
        }
        let channels = vec![
            message_channel::<FrameTransforms>(writer, "/tf")?,
            message_channel::<JointStates>(writer, "/joint_states")?,
            message_channel::<SceneUpdate>(writer, "/scene")?,
        ];
        Ok(Self { channels, features: None })
    }
}

impl<W: Write + Seek> Channels<W> {
    /// Declares every channel, schemas embedded.
    pub(super) fn create(target: W, world: &Environments) -> Result<Self, RecordError> {
        let options = WriteOptions::new().library("s2mia").chunk_size(Some(CHUNK_BYTES));
        let mut writer = options.create(target)?;
        let description = world.description();
        let mut actions = Vec::new();
        for (index, agent) in description.agents.iter().enumerate() {
            let topic = format!("/agents/{index}/action");
            let schema = action_schema(&agent.joints);
            actions.push((json_channel(&mut writer, &topic, &schema)?, agent.action.size));
        }
        Ok(Self {
            show: Show::create(&mut writer, world)?,
            episode: json_channel(&mut writer, "/episode", &episode_schema())?,
            actions,
            writer,
            dt_nanos: (description.dt_secs * 1e9).round() as u64,
            nanos: 0,
            messages: 0,
            buffer: Vec::new(),
        })
    }

    /// Which run and policy the file shows, and the task's settings.
    pub(super) fn describe(
        &mut self,
        task: &TaskConfig,
        metadata: &BTreeMap<String, String>,
    ) -> Result<(), RecordError> {
        let record = Metadata { name: METADATA_NAME.to_owned(), metadata: metadata.clone() };
        self.writer.write_metadata(&record)?;
        let data = json!(task).to_string().into_bytes();
        self.writer.attach(&Attachment {
            log_time: 0,
            create_time: 0,
            name: "task.json".to_owned(),
            media_type: "application/json".to_owned(),
            data: Cow::Owned(data),
        })?;
        Ok(())
    }

    /// Simulated time.
    pub(super) fn now(&self) -> Timestamp {
        Timestamp::new((self.nanos / 1_000_000_000) as u32, (self.nanos % 1_000_000_000) as u32)
    }

    /// Whether the world has links to show.
    pub(super) fn shows_links(&self) -> bool {
        self.show.features.is_none()
    }

    /// The shapes, at an episode's start.
    pub(super) fn scene(&mut self, scene: &SceneUpdate) -> Result<(), RecordError> {
        self.message(|channels| &mut channels.show.channels[SCENE], scene)
    }

    /// The world as it stands.
    pub(super) fn stand(&mut self, world: &Environments) -> Result<(), RecordError> {
        let Some(features) = &self.show.features else { return self.pose(world) };
        let mut state = vec![0.0; features.len()];
        world.state(0, &mut state);
        let fields = features.iter().cloned().zip(state.into_iter().map(|x| json!(x)));
        let text = serde_json::Value::Object(fields.collect()).to_string();
        self.write(|channels| &mut channels.show.channels[STATE], text.as_bytes())
    }

    /// Where links and joints are.
    fn pose(&mut self, world: &Environments) -> Result<(), RecordError> {
        let (now, pose) = (self.now(), world.pose(0));
        let transform = |link: &sim::LinkPose| FrameTransform {
            timestamp: Some(now),
            parent_frame_id: "world".to_owned(),
            child_frame_id: link.name.clone(),
            translation: Some(vector(link.position)),
            rotation: Some(quaternion(link.quaternion)),
        };
        let joint = |joint: &sim::JointPose| JointState {
            name: joint.name.clone(),
            position: Some(joint.position.into()),
            velocity: Some(joint.velocity.into()),
            ..JointState::default()
        };
        let transforms = FrameTransforms { transforms: pose.links.iter().map(transform).collect() };
        self.message(|channels| &mut channels.show.channels[TRANSFORMS], &transforms)?;
        let joints =
            JointStates { timestamp: Some(now), joints: pose.joints.iter().map(joint).collect() };
        self.message(|channels| &mut channels.show.channels[JOINTS], &joints)
    }

    /// A step of episode `episode` whose rewards add up to `total` so far.
    pub(super) fn step(
        &mut self,
        step: &PlayedStep<'_>,
        episode: u32,
        total: f64,
    ) -> Result<(), RecordError> {
        self.nanos += self.dt_nanos;
        self.stand(step.world)?;
        let mut from = 0;
        for agent in 0..self.actions.len() {
            let to = from + self.actions[agent].1;
            let text = json!({ "action": step.action[from..to] }).to_string();
            self.write(|channels| &mut channels.actions[agent].0, text.as_bytes())?;
            from = to;
        }
        let text = json!({
            "episode": episode,
            "step": step.step,
            "reward": step.outcome.reward,
            "return": total,
            "terminated": step.outcome.terminated,
            "truncated": step.outcome.truncated,
        });
        self.write(|channels| &mut channels.episode, text.to_string().as_bytes())
    }

    /// Lets simulated time pass before the next episode.
    pub(super) fn pause(&mut self) {
        self.nanos += PAUSE_NANOS;
    }

    fn message<M: Encode>(
        &mut self,
        channel: impl Fn(&mut Self) -> &mut Channel,
        message: &M,
    ) -> Result<(), RecordError> {
        let mut buffer = std::mem::take(&mut self.buffer);
        buffer.clear();
        let encoded = message.encode(&mut buffer);
        let topic = channel(self).topic.clone();
        encoded.map_err(|error| RecordError::Message { topic, why: error.to_string() })?;
        let written = self.write(channel, &buffer);
        self.buffer = buffer;
        written
    }

    fn write(
        &mut self,
        channel: impl Fn(&mut Self) -> &mut Channel,
        data: &[u8],
    ) -> Result<(), RecordError> {
        let nanos = self.nanos;
        let channel = channel(self);
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.sequence,
            log_time: nanos,
            publish_time: nanos,
        };
        channel.sequence += 1;
        self.writer.write_to_known_channel(&header, data)?;
        self.messages += 1;
        Ok(())
    }
}

impl Channels<std::io::BufWriter<std::fs::File>> {
    /// Closes the file, on the disk, and gives the number of its messages.
    pub(super) fn finish(mut self) -> Result<u64, RecordError> {
        self.writer.finish()?;
        let file =
            self.writer.into_inner().into_inner().map_err(std::io::IntoInnerError::into_error)?;
        file.sync_all()?;
        Ok(self.messages)
    }
}

pub(super) fn vector([x, y, z]: [f32; 3]) -> Vector3 {
    Vector3 { x: x.into(), y: y.into(), z: z.into() }
}

pub(super) fn quaternion([x, y, z, w]: [f32; 4]) -> Quaternion {
    Quaternion { x: x.into(), y: y.into(), z: z.into(), w: w.into() }
}

fn message_channel<M: Encode>(
    writer: &mut Writer<impl Write + Seek>,
    topic: &str,
) -> Result<Channel, RecordError> {
    let missing = || RecordError::Message { topic: topic.to_owned(), why: "no schema".to_owned() };
    let schema = M::get_schema().ok_or_else(missing)?;
    let schema = writer.add_schema(&schema.name, &schema.encoding, &schema.data)?;
    let encoding = M::get_message_encoding();
    let id = writer.add_channel(schema, topic, &encoding, &BTreeMap::new())?;
    Ok(Channel { id, topic: topic.to_owned(), sequence: 0 })
}

fn json_channel(
    writer: &mut Writer<impl Write + Seek>,
    topic: &str,
    schema: &serde_json::Value,
) -> Result<Channel, RecordError> {
    let name = schema["title"].as_str().unwrap_or_default();
    let schema = writer.add_schema(name, "jsonschema", schema.to_string().as_bytes())?;
    let id = writer.add_channel(schema, topic, "json", &BTreeMap::new())?;
    Ok(Channel { id, topic: topic.to_owned(), sequence: 0 })
}

fn action_schema(joints: &[String]) -> serde_json::Value {
    json!({
        "title": "s2mia.Action",
        "type": "object",
        "properties": { "action": {
            "type": "array",
            "items": { "type": "number" },
            "description": format!("before clamping, one number per joint: {}", joints.join(", ")),
        } },
    })
}

fn state_schema(features: &[String]) -> serde_json::Value {
    let number = |name: &String| (name.clone(), json!({ "type": "number" }));
    let properties: serde_json::Map<_, _> = features.iter().map(number).collect();
    json!({ "title": "s2mia.State", "type": "object", "properties": properties })
}

fn episode_schema() -> serde_json::Value {
    json!({
        "title": "s2mia.Episode",
        "type": "object",
        "properties": {
            "episode": { "type": "integer" },
            "step": { "type": "integer", "description": "steps done" },
            "reward": { "type": "number", "description": "extrinsic, of this step" },
            "return": { "type": "number", "description": "sum of the episode's rewards so far" },
            "terminated": { "type": "boolean" },
            "truncated": { "type": "boolean" },
        },
    })
}
