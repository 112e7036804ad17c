//! A robot's shapes in the world, as they look from the side or from above.

use sim::Pose;

use crate::film::shapes::RobotShapes;

/// All points of the picture's plane within the radius of the line between the ends: a capsule from any side, or a ball
/// if the ends are equal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Solid {
    /// In the picture's plane, metres: x, and z or y.
    pub(super) ends: [[f32; 2]; 2],
    /// Metres.
    pub(super) radius: f32,
    /// Distance of the middle behind the plane, metres.
    pub(super) depth: f32,
    /// The agent that drives the joint of its link.
    pub(super) agent: Option<usize>,
}

/// Direction of view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum View {
    /// Along y.
    Side,
    /// Down along z.
    Above,
}

impl View {
    /// A point of the world in the picture's plane, metres.
    pub(super) fn plane(self, [x, y, z]: [f32; 3]) -> [f32; 2] {
        match self {
            Self::Side => [x, z],
            Self::Above => [x, y],
        }
    }

    /// Distance of a point behind the plane, metres.
    fn depth(self, [_, y, z]: [f32; 3]) -> f32 {
        match self {
            Self::Side => y,
            Self::Above => -z,
        }
    }
}

/// The solids of a pose, the farthest first.
pub(super) fn of_pose(robot: &RobotShapes, pose: &Pose, view: View) -> Vec<Solid> {
    let links = pose.links.iter().zip(&robot.drivers);
    let mut solids: Vec<Solid> = links
        .flat_map(|(link, &agent)| {
            let shapes = robot.shapes.iter().filter(|shape| shape.link == link.name);
            shapes.flat_map(|shape| shape.capsules()).map(move |capsule| {
                let ends = capsule.ends.map(|end| link.in_world(end));
                let (radius, depth) = (capsule.radius, ends.map(|end| view.depth(end)));
                let (ends, depth) = (ends.map(|end| view.plane(end)), (depth[0] + depth[1]) / 2.0);
                Solid { ends, radius, depth, agent }
            })
        })
        .collect();
    solids.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    solids
}
