//! A robot's shapes in the world, as they look from the side.

use sim::{LinkPose, Pose, Shape};

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
                let axis = rotated(shape.quaternion, [0.0, 0.0, 1.0]);
                let (half, radius) = measures(shape.shape);
                let end = |along: f32| {
                    in_world(link, [0, 1, 2].map(|i| shape.position[i] + along * axis[i]))
                };
                let (low, high) = (end(-half), end(half));
                let ends = [[low[0], low[2]], [high[0], high[2]]];
                Solid { ends, radius, depth: (low[1] + high[1]) / 2.0, agent }
            })
        })
        .collect();
    solids.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    solids
}

/// Half the length of a shape's straight part, and its radius, metres.
fn measures(shape: Shape) -> (f32, f32) {
    match shape {
        Shape::Capsule { half_length, radius } => (half_length, radius),
        Shape::Sphere { radius } => (0.0, radius),
    }
}

/// A point of a link in the world, metres.
fn in_world(link: &LinkPose, point_in_link: [f32; 3]) -> [f32; 3] {
    let turned = rotated(link.quaternion, point_in_link);
    [0, 1, 2].map(|i| link.position[i] + turned[i])
}

/// `v + 2 w (u x v) + 2 u x (u x v)`: a vector turned by the unit quaternion `(u, w)`.
pub(super) fn rotated([x, y, z, w]: [f32; 4], vector: [f32; 3]) -> [f32; 3] {
    let once = cross([x, y, z], vector);
    let twice = cross([x, y, z], once);
    [0, 1, 2].map(|i| vector[i] + 2.0 * (w * once[i] + twice[i]))
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_turn_about_y_takes_z_to_x() {
        let half = core::f32::consts::FRAC_1_SQRT_2;
        let turned = rotated([0.0, half, 0.0, half], [0.0, 0.0, 1.0]);
        let error = turned.iter().zip([1.0, 0.0, 0.0]).map(|(a, b)| (a - b).abs()).sum::<f32>();
        assert!(error < 1e-6, "{turned:?}");
    }
}
