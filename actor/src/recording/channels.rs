//! Channels of an episode and their messages after each step.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;

use serde_json::json;
use sim::{EnvironmentBatch, TaskConfig};

use super::robot::RobotChannels;
use super::sink::{Channel, Sink};
use super::writer::McapFile;
use super::{METADATA_NAME, RecordError};
use crate::evaluation::PlayedStep;

/// Channels on which episodes are written to a sink.
pub(crate) struct Channels<S> {
    pub(crate) sink: S,
    world: WorldChannels,
    episode: Channel,
    /// Channel and action size of each agent.
    actions: Vec<(Channel, usize)>,
    dt_nanos: u64,
}

/// Channels for the state of the world.
enum WorldChannels {
    Robot(RobotChannels),
    /// No robot: the channel `/state` and the names of the global state's features.
    Game(Channel, Vec<String>),
}

impl WorldChannels {
    fn create(sink: &mut impl Sink, world: &dyn EnvironmentBatch) -> Result<Self, RecordError> {
        if !world.pose(0).links.is_empty() {
            return Ok(Self::Robot(RobotChannels::create(sink)?));
        }
        let state = world.description().state.iter();
        let features: Vec<String> = state.map(|feature| feature.name.clone()).collect();
        Ok(Self::Game(sink.json_channel("/state", &state_schema(&features))?, features))
    }

    /// Writes the current state of the world.
    fn write_state(
        &mut self,
        sink: &mut impl Sink,
        world: &dyn EnvironmentBatch,
    ) -> Result<(), RecordError> {
        let (channel, features) = match self {
            Self::Robot(channels) => return channels.pose(sink, &world.pose(0)),
            Self::Game(channel, features) => (channel, features),
        };
        let mut state = vec![0.0; features.len()];
        world.state(0, &mut state);
        let fields = features.iter().cloned().zip(state.into_iter().map(|x| json!(x)));
        let text = serde_json::Value::Object(fields.collect()).to_string();
        sink.write(channel, text.as_bytes())
    }
}

impl<S: Sink> Channels<S> {
    /// Creates all channels with their schemas.
    pub(crate) fn create(mut sink: S, world: &dyn EnvironmentBatch) -> Result<Self, RecordError> {
        let description = world.description();
        let mut actions = Vec::new();
        for (index, agent) in description.agents.iter().enumerate() {
            let topic = format!("/agents/{index}/action");
            let schema = action_schema(&agent.joints);
            actions.push((sink.json_channel(&topic, &schema)?, agent.action.size));
        }
        Ok(Self {
            world: WorldChannels::create(&mut sink, world)?,
            episode: sink.json_channel("/episode", &episode_schema())?,
            actions,
            sink,
            dt_nanos: (description.dt_secs * 1e9).round() as u64,
        })
    }

    /// Writes the shapes and the world at the start of an episode.
    pub(crate) fn begin(&mut self, world: &dyn EnvironmentBatch) -> Result<(), RecordError> {
        if let WorldChannels::Robot(channels) = &mut self.world {
            channels.scene(&mut self.sink, &world.description().task)?;
        }
        self.world.write_state(&mut self.sink, world)
    }

    /// Writes a step of episode `episode`; `total` is the sum of its rewards so far.
    pub(crate) fn step(
        &mut self,
        step: &PlayedStep<'_>,
        episode: u32,
        total: f64,
    ) -> Result<(), RecordError> {
        self.sink.advance(self.dt_nanos);
        self.world.write_state(&mut self.sink, step.world)?;
        let mut from = 0;
        for (channel, size) in &mut self.actions {
            let text = json!({ "action": step.action[from..from + *size] }).to_string();
            self.sink.write(channel, text.as_bytes())?;
            from += *size;
        }
        let text = json!({
            "episode": episode,
            "step": step.step,
            "reward": step.outcome.reward,
            "return": total,
            "terminated": step.outcome.terminated,
            "truncated": step.outcome.truncated,
        });
        self.sink.write(&mut self.episode, text.to_string().as_bytes())
    }

    /// Advances simulated time before the next episode.
    pub(crate) fn pause(&mut self) {
        self.sink.pause();
    }
}

impl Channels<McapFile<BufWriter<File>>> {
    /// Writes the run and the policy, and the task's settings, if any.
    pub(super) fn describe(
        &mut self,
        task: Option<&TaskConfig>,
        metadata: &BTreeMap<String, String>,
    ) -> Result<(), RecordError> {
        self.sink.metadata(METADATA_NAME, metadata)?;
        let Some(task) = task else { return Ok(()) };
        self.sink.attach("task.json", "application/json", json!(task).to_string().as_bytes())
    }

    /// Flushes and closes the file; returns the number of its messages.
    pub(super) fn finish(self) -> Result<u64, RecordError> {
        self.sink.finish()
    }
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
