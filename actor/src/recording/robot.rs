//! How a robot is shown: its links' frames, its joints, and its real shapes as a scene.

use std::io::{Seek, Write};

use foxglove::messages::{
    FrameTransform, FrameTransforms, JointState, JointStates, Quaternion, SceneUpdate, Vector3,
};
use sim::Pose;

use super::writer::{Channel, McapFile};
use super::{RecordError, scene};

/// The channels `/tf`, `/joint_states` and `/scene`.
pub(crate) struct RobotChannels {
    transforms: Channel,
    joints: Channel,
    scene: Channel,
}

impl RobotChannels {
    /// Declares the channels.
    pub(crate) fn create(file: &mut McapFile<impl Write + Seek>) -> Result<Self, RecordError> {
        Ok(Self {
            transforms: file.foxglove_channel::<FrameTransforms>("/tf")?,
            joints: file.foxglove_channel::<JointStates>("/joint_states")?,
            scene: file.foxglove_channel::<SceneUpdate>("/scene")?,
        })
    }

    /// The shapes, at an episode's start.
    pub(crate) fn scene(
        &mut self,
        file: &mut McapFile<impl Write + Seek>,
        task: &str,
    ) -> Result<(), RecordError> {
        let scene = scene::update(task, file.now())?;
        file.foxglove(&mut self.scene, &scene)
    }

    /// Where links and joints are.
    pub(crate) fn pose(
        &mut self,
        file: &mut McapFile<impl Write + Seek>,
        pose: &Pose,
    ) -> Result<(), RecordError> {
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
        file.foxglove(&mut self.transforms, &transforms)?;
        let joints =
            JointStates { timestamp: Some(now), joints: pose.joints.iter().map(joint).collect() };
        file.foxglove(&mut self.joints, &joints)
    }
}

pub(super) fn vector([x, y, z]: [f32; 3]) -> Vector3 {
    Vector3 { x: x.into(), y: y.into(), z: z.into() }
}

pub(super) fn quaternion([x, y, z, w]: [f32; 4]) -> Quaternion {
    Quaternion { x: x.into(), y: y.into(), z: z.into(), w: w.into() }
}
