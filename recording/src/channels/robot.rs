//! Channels of a robot: frames of its links, joints, and shapes as a scene.

use foxglove::messages::{FrameTransform, FrameTransforms, JointState, JointStates, SceneUpdate};
use prost::Message as _;
use sim::{LinkShape, Pose};

use super::scene::{self, quaternion, vector};
use crate::error::RecordError;
use crate::mcap_file::{Channel, McapFile};

/// The channels `/tf`, `/joint_states` and `/scene`.
pub(crate) struct RobotChannels {
    transforms: Channel,
    joints: Channel,
    scene: Channel,
    shapes: Vec<LinkShape>,
}

impl RobotChannels {
    /// Creates the channels of a robot with these shapes.
    pub(crate) fn create(file: &mut McapFile, shapes: &[LinkShape]) -> Result<Self, RecordError> {
        Ok(Self {
            shapes: shapes.to_vec(),
            transforms: file.foxglove_channel::<FrameTransforms>("/tf")?,
            joints: file.foxglove_channel::<JointStates>("/joint_states")?,
            scene: file.foxglove_channel::<SceneUpdate>("/scene")?,
        })
    }

    /// Writes the shapes at the start of a share.
    pub(crate) fn scene(&mut self, file: &mut McapFile) -> Result<(), RecordError> {
        let scene = scene::update(&self.shapes, file.now());
        file.write(&mut self.scene, &scene.encode_to_vec())
    }

    /// Writes the poses of links and joints.
    pub(crate) fn pose(&mut self, file: &mut McapFile, pose: &Pose) -> Result<(), RecordError> {
        let now = file.now();
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
        file.write(&mut self.transforms, &transforms.encode_to_vec())?;
        let joints =
            JointStates { timestamp: Some(now), joints: pose.joints.iter().map(joint).collect() };
        file.write(&mut self.joints, &joints.encode_to_vec())
    }
}
