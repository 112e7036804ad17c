//! Channels of a robot: frames of its links, joints, and shapes as a scene.

use foxglove::messages::{FrameTransform, FrameTransforms, JointState, JointStates, SceneUpdate};
use sim::{LinkShape, Pose};

use super::geometry::{quaternion, vector};
use super::scene;
use crate::error::RecordError;
use crate::sink::{Channel, Sink};

/// The channels `/tf`, `/joint_states` and `/scene`.
pub(crate) struct RobotChannels {
    transforms: Channel,
    joints: Channel,
    scene: Channel,
    shapes: Vec<LinkShape>,
}

impl RobotChannels {
    /// Creates the channels of a robot with these shapes.
    pub(crate) fn create(sink: &mut impl Sink, shapes: &[LinkShape]) -> Result<Self, RecordError> {
        Ok(Self {
            shapes: shapes.to_vec(),
            transforms: sink.foxglove_channel::<FrameTransforms>("/tf")?,
            joints: sink.foxglove_channel::<JointStates>("/joint_states")?,
            scene: sink.foxglove_channel::<SceneUpdate>("/scene")?,
        })
    }

    /// Writes the shapes at the start of a share.
    pub(crate) fn scene(&mut self, sink: &mut impl Sink) -> Result<(), RecordError> {
        let scene = scene::update(&self.shapes, sink.now());
        sink.foxglove(&mut self.scene, &scene)
    }

    /// Writes the poses of links and joints.
    pub(crate) fn pose(&mut self, sink: &mut impl Sink, pose: &Pose) -> Result<(), RecordError> {
        let now = sink.now();
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
        sink.foxglove(&mut self.transforms, &transforms)?;
        let joints =
            JointStates { timestamp: Some(now), joints: pose.joints.iter().map(joint).collect() };
        sink.foxglove(&mut self.joints, &joints)
    }
}
