//! Channels of a robot: frames of its links, joints, and shapes as a scene.

use foxglove::messages::{FrameTransform, FrameTransforms, JointState, JointStates, SceneUpdate};
use prost::Message as _;
use sim::{JointPose, LinkPose, Pose, WORLD};

use super::scene::{self, Scenery, quaternion, vector};
use crate::error::RecordError;
use crate::mcap_file::{Channel, McapFile};

/// The channels `/tf`, `/joint_states` and `/scene`.
pub(crate) struct RobotChannels {
    transforms: Channel,
    joints: Channel,
    scene: Channel,
    scenery: Scenery,
}

impl RobotChannels {
    /// Creates the channels of a robot.
    pub(crate) fn create(file: &mut McapFile, scenery: &Scenery) -> Result<Self, RecordError> {
        Ok(Self {
            scenery: scenery.clone(),
            transforms: file.foxglove_channel::<FrameTransforms>("/tf")?,
            joints: file.foxglove_channel::<JointStates>("/joint_states")?,
            scene: file.foxglove_channel::<SceneUpdate>("/scene")?,
        })
    }

    /// Writes the shapes at the start of a share.
    pub(crate) fn scene(&mut self, file: &mut McapFile) -> Result<(), RecordError> {
        let scene = scene::update(&self.scenery, file.now());
        file.write(&mut self.scene, &scene.encode_to_vec())
    }

    /// Writes the poses of links, as a tree, and joints before a step, and the efforts of the joints during the step.
    pub(crate) fn pose(
        &mut self,
        file: &mut McapFile,
        pose: &Pose,
        efforts: &[f32],
    ) -> Result<(), RecordError> {
        let now = file.now();
        let transform = |link: &LinkPose| {
            let parent = link.parent.map(|parent| &pose.links[parent]);
            let in_world = (link.position, link.quaternion);
            let (position, turn) = parent.map_or(in_world, |parent| link.seen_from(parent));
            FrameTransform {
                timestamp: Some(now),
                parent_frame_id: parent.map_or(WORLD, |parent| &parent.name).to_owned(),
                child_frame_id: link.name.clone(),
                translation: Some(vector(position)),
                rotation: Some(quaternion(turn)),
            }
        };
        let joint = |(joint, effort): (&JointPose, &f32)| JointState {
            name: joint.name.clone(),
            position: Some(joint.position.into()),
            velocity: Some(joint.velocity.into()),
            effort: Some((*effort).into()),
            ..JointState::default()
        };
        let transforms = FrameTransforms { transforms: pose.links.iter().map(transform).collect() };
        file.write(&mut self.transforms, &transforms.encode_to_vec())?;
        let joints = pose.joints.iter().zip(efforts).map(joint).collect();
        let joints = JointStates { timestamp: Some(now), joints };
        file.write(&mut self.joints, &joints.encode_to_vec())
    }
}
