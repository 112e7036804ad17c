//! A robot's shapes in the world, as they look from the side.

use sim::Pose;

use crate::film::Cast;

/// Every point of the picture's plane that is no farther than the radius from the line between the ends: that is
/// what a capsule looks like from any side, and with equal ends a ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Solid {
    /// x and z in the world, metres.
    pub(super) ends: [[f32; 2]; 2],
    /// Metres.
    pub(super) radius: f32,
    /// y of the middle in the world, metres; the viewer stands at the smallest.
    pub(super) depth: f32,
    /// Who drives the joint of its link.
    pub(super) agent: Option<usize>,
}

/// The solids of a pose, the farthest first.
pub(super) fn of_pose(cast: &Cast, pose: &Pose) -> Vec<Solid> {
    let links = pose.links.iter().zip(&cast.drivers);
    let mut solids: Vec<Solid> = links
        .flat_map(|(link, &agent)| {
            let shapes = cast.shapes.iter().filter(|shape| shape.link == link.name);
            shapes.map(move |shape| {
                let [low, high] = shape.ends(link);
                let ends = [[low[0], low[2]], [high[0], high[2]]];
                let (radius, depth) = (shape.shape.radius(), (low[1] + high[1]) / 2.0);
                Solid { ends, radius, depth, agent }
            })
        })
        .collect();
    solids.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    solids
}
