//! The topics of episodes, the same in trajectory logs and recordings.

mod robot;
mod scene;

use std::collections::BTreeMap;

use prost::Message;
use proto::trajectory_log::DESCRIPTORS;
use proto::{EnvironmentSpec, FeatureSpec};
use serde_json::json;

use crate::error::RecordError;
use crate::mcap_file::{Channel, McapFile, Schema};
use crate::share::LoggedShare;
use robot::RobotChannels;
pub(crate) use scene::{DrivenShape, Scenery};

/// The channels `/share`, `/agents/I`, `/step` and `/share_end`, and those of a simulated robot.
pub(crate) struct ShareChannels {
    share: Channel,
    agents: Vec<Channel>,
    step: Channel,
    end: Channel,
    robot: Option<RobotChannels>,
}

impl ShareChannels {
    /// Creates the channels of the environment that `description` describes. `scenery` has its robot, if it has one.
    pub(crate) fn create(
        file: &mut McapFile,
        description: &EnvironmentSpec,
        scenery: Option<&Scenery>,
    ) -> Result<Self, RecordError> {
        let mut agents = Vec::new();
        for (index, agent) in description.agents.iter().enumerate() {
            let about = [
                ("observation", names(&agent.observation)),
                ("action", json!(agent.joints).to_string()),
                ("action_unit", json!(agent.action.unit()).to_string()),
            ];
            agents.push(channel(file, &format!("/agents/{index}"), "AgentStep", &about)?);
        }
        let terms = json!(description.reward_terms).to_string();
        let about = [("state", names(&description.state)), ("reward_terms", terms)];
        Ok(Self {
            agents,
            robot: scenery.map(|scenery| RobotChannels::create(file, scenery)).transpose()?,
            share: channel(file, "/share", "Share", &[])?,
            step: channel(file, "/step", "Step", &about)?,
            end: channel(file, "/share_end", "ShareEnd", &[])?,
        })
    }

    /// Writes a share, of which each step takes `dt_nanos` of simulated time.
    pub(crate) fn write(
        &mut self,
        file: &mut McapFile,
        share: &LoggedShare,
        dt_nanos: u64,
    ) -> Result<(), RecordError> {
        file.write(&mut self.share, &share.head.encode_to_vec())?;
        if let Some(robot) = &mut self.robot {
            robot.scene(file)?;
        }
        for step in &share.steps {
            if let Some(robot) = &mut self.robot {
                robot.pose(file, &step.pose, &step.efforts)?;
            }
            for (channel, agent) in self.agents.iter_mut().zip(&step.agents) {
                file.write(channel, &agent.encode_to_vec())?;
            }
            file.write(&mut self.step, &step.step.encode_to_vec())?;
            file.advance(dt_nanos);
        }
        file.write(&mut self.end, &share.end.encode_to_vec())
    }
}

/// Names of features as a JSON array.
fn names(features: &[FeatureSpec]) -> String {
    json!(features.iter().map(|feature| &feature.name).collect::<Vec<_>>()).to_string()
}

/// Creates a channel for a message of this project; `about` is the channel's metadata.
fn channel(
    file: &mut McapFile,
    topic: &str,
    message: &str,
    about: &[(&str, String)],
) -> Result<Channel, RecordError> {
    let name = format!("s2mia.log.v1.{message}");
    let schema =
        Schema { name: &name, encoding: "protobuf", data: DESCRIPTORS, messages: "protobuf" };
    let about = about.iter().map(|(key, value)| ((*key).to_owned(), value.clone()));
    file.channel(topic, &schema, &about.collect::<BTreeMap<_, _>>())
}
