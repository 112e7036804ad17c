//! The topics of episodes, the same in trajectory logs, recordings and the live view.

mod geometry;
mod robot;
mod scene;

use std::collections::BTreeMap;

use prost::Message;
use proto::trajectory_log::{DESCRIPTORS, Share, ShareEnd};
use serde_json::json;
use sim::{Description, Feature, LinkShape, Pose};

use crate::error::RecordError;
use crate::share::LoggedStep;
use crate::sink::{Channel, Schema, Sink};
use robot::RobotChannels;

/// The channels `/share`, `/agents/I`, `/step` and `/share_end`, and those of a simulated robot.
pub(crate) struct ShareChannels {
    share: Channel,
    agents: Vec<Channel>,
    step: Channel,
    end: Channel,
    robot: Option<RobotChannels>,
}

impl ShareChannels {
    /// Creates the channels of the environment that `description` describes. `shapes` are those of its
    /// robot, empty without one.
    pub(crate) fn create(
        sink: &mut impl Sink,
        description: &Description,
        shapes: &[LinkShape],
    ) -> Result<Self, RecordError> {
        let mut agents = Vec::new();
        for (index, agent) in description.agents.iter().enumerate() {
            let about = [
                ("observation", names(&agent.observation)),
                ("action", json!(agent.joints).to_string()),
                ("action_unit", json!(agent.action.unit()).to_string()),
            ];
            agents.push(channel(sink, &format!("/agents/{index}"), "AgentStep", &about)?);
        }
        let about = [("state", names(&description.state))];
        Ok(Self {
            agents,
            robot: match shapes {
                [] => None,
                shapes => Some(RobotChannels::create(sink, shapes)?),
            },
            share: channel(sink, "/share", "Share", &[])?,
            step: channel(sink, "/step", "Step", &about)?,
            end: channel(sink, "/share_end", "ShareEnd", &[])?,
        })
    }

    /// Writes the start of a share.
    pub(crate) fn begin(&mut self, sink: &mut impl Sink, head: &Share) -> Result<(), RecordError> {
        sink.write(&mut self.share, &head.encode_to_vec())?;
        self.scene(sink)
    }

    /// Writes the shapes of the robot, if there is one.
    pub(crate) fn scene(&mut self, sink: &mut impl Sink) -> Result<(), RecordError> {
        self.robot.as_mut().map_or(Ok(()), |robot| robot.scene(sink))
    }

    /// Writes the pose of the robot, if there is one.
    pub(crate) fn pose(&mut self, sink: &mut impl Sink, pose: &Pose) -> Result<(), RecordError> {
        self.robot.as_mut().map_or(Ok(()), |robot| robot.pose(sink, pose))
    }

    /// Writes a step without its pose.
    pub(crate) fn step(
        &mut self,
        sink: &mut impl Sink,
        step: &LoggedStep,
    ) -> Result<(), RecordError> {
        for (channel, agent) in self.agents.iter_mut().zip(&step.agents) {
            sink.write(channel, &agent.encode_to_vec())?;
        }
        sink.write(&mut self.step, &step.step.encode_to_vec())
    }

    /// Writes the end of a share.
    pub(crate) fn end(&mut self, sink: &mut impl Sink, end: &ShareEnd) -> Result<(), RecordError> {
        sink.write(&mut self.end, &end.encode_to_vec())
    }
}

/// Names of features as a JSON array.
fn names(features: &[Feature]) -> String {
    json!(features.iter().map(|feature| &feature.name).collect::<Vec<_>>()).to_string()
}

/// Creates a channel for a message of this project; `about` is the channel's metadata.
fn channel(
    sink: &mut impl Sink,
    topic: &str,
    message: &str,
    about: &[(&str, String)],
) -> Result<Channel, RecordError> {
    let name = format!("s2mia.log.v1.{message}");
    let schema =
        Schema { name: &name, encoding: "protobuf", data: DESCRIPTORS, messages: "protobuf" };
    let about = about.iter().map(|(key, value)| ((*key).to_owned(), value.clone()));
    sink.channel(topic, &schema, &about.collect::<BTreeMap<_, _>>())
}
