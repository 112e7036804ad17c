//! Shapes that are so close that they may touch. Nothing is kept between steps, so the pairs depend only on the poses.

use rapier3d::math::{Pose, Vector};

use crate::scene::Shape;

/// Rounding of positions, m.
const ROUNDING: f32 = 1e-4;

/// A box around a shape.
#[derive(Clone, Copy)]
pub(super) enum Bounds {
    /// Everything below z = 0 of the collider's frame.
    Plane,
    /// A box with its centre at this pose in the collider's frame, and half its sizes, m.
    Box(Pose, Vector),
}

/// The bounds of a shape in the world.
struct Placed {
    shape: usize,
    part: usize,
    centre: Vector,
    axes: [Vector; 3],
    /// Half sizes along the axes, with the distance at which contacts become active, m.
    half: Vector,
    is_plane: bool,
    /// Ends along the axes of the world, m.
    low: Vector,
    high: Vector,
}

/// The bounds of all shapes in a step.
#[derive(Default)]
pub(super) struct Near {
    placed: Vec<Placed>,
}

impl Bounds {
    /// Bounds of a shape with the pose `pose` in the frame of its collider; the collider of a sphere is at its centre.
    pub(super) fn of_shape(shape: &Shape, pose: &Pose) -> Self {
        let [middle, half_sizes] = shape.bounding_box().map(Vector::from_array);
        match shape {
            Shape::Sphere { .. } => Self::Box(Pose::IDENTITY, half_sizes),
            _ => Self::Box(*pose * Pose::from_translation(middle), half_sizes),
        }
    }
}

impl Near {
    pub(super) fn clear(&mut self) {
        self.placed.clear();
    }

    /// Adds a shape whose collider is at `frame` and that touches what is nearer than `reach`, m. Shapes of the same part are
    /// never near.
    pub(super) fn add(
        &mut self,
        [shape, part]: [usize; 2],
        bounds: &Bounds,
        frame: &Pose,
        reach: f32,
    ) {
        let reach = Vector::splat(reach + ROUNDING);
        let (pose, half) = match bounds {
            Bounds::Plane => (*frame, reach),
            Bounds::Box(inside, half) => (*frame * *inside, *half + reach),
        };
        let axes = [Vector::X, Vector::Y, Vector::Z].map(|axis| pose.rotation * axis);
        let is_plane = matches!(bounds, Bounds::Plane);
        let extent = if is_plane {
            Vector::splat(f32::INFINITY)
        } else {
            axes[0].abs() * half.x + axes[1].abs() * half.y + axes[2].abs() * half.z
        };
        let centre = pose.translation;
        let (low, high) = (centre - extent, centre + extent);
        self.placed.push(Placed { shape, part, centre, axes, half, is_plane, low, high });
    }

    /// Calls `found` with the shapes of all pairs of different parts whose bounds overlap, in any order.
    pub(super) fn pairs(&mut self, mut found: impl FnMut([usize; 2])) {
        self.placed.sort_unstable_by(|one, other| {
            one.low.x.total_cmp(&other.low.x).then(one.shape.cmp(&other.shape))
        });
        for (index, one) in self.placed.iter().enumerate() {
            let later = self.placed[index + 1..].iter();
            for other in later.take_while(|other| other.low.x <= one.high.x) {
                if one.part != other.part && one.overlaps(other) {
                    found([one.shape, other.shape]);
                }
            }
        }
    }
}

impl Placed {
    fn overlaps(&self, other: &Self) -> bool {
        let is_beside =
            |axis: usize| self.low[axis] > other.high[axis] || other.low[axis] > self.high[axis];
        if is_beside(1) || is_beside(2) {
            return false;
        }
        match (self.is_plane, other.is_plane) {
            (true, _) => other.reaches_below(self),
            (_, true) => self.reaches_below(other),
            _ => self.axes_meet(other) && other.axes_meet(self),
        }
    }

    fn reaches_below(&self, plane: &Self) -> bool {
        let up = plane.axes[2];
        up.dot(self.centre - plane.centre) <= self.extent(up) + plane.half.z
    }

    /// Whether no face of this box separates it from another.
    fn axes_meet(&self, other: &Self) -> bool {
        let between = other.centre - self.centre;
        let halves = self.half.to_array();
        let mut axes = self.axes.iter().zip(halves);
        axes.all(|(axis, half)| axis.dot(between).abs() <= half + other.extent(*axis))
    }

    /// Half the length of the box along an axis, m.
    fn extent(&self, axis: Vector) -> f32 {
        let parts = self.axes.iter().zip(self.half.to_array());
        parts.fold(0.0, |sum, (own, half)| sum + own.dot(axis).abs() * half)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_shapes_of_different_parts_are_near() {
        let bounds = Bounds::Box(Pose::IDENTITY, Vector::splat(1.0));
        let mut near = Near::default();
        for (shape, part) in [0, 0, 1].into_iter().enumerate() {
            near.add([shape, part], &bounds, &Pose::from_translation(Vector::X), 0.0);
        }
        let mut found = Vec::new();
        near.pairs(|pair| found.push(pair));
        assert_eq!(found, [[0, 2], [1, 2]]);
    }
}
