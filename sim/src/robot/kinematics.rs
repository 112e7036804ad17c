//! Positions and velocities of bodies and fixed points, as functions of a state's coordinates and velocities.

use rapier3d::glamx::{DQuat, DVec3};
use rapier3d::math::{Pose, Rotation, Vector};

use super::Robot;
use super::blueprint::{JointPlan, LinkPlan, Motion};
use super::frame::about;
use super::layout::JointMap;

/// A body or a fixed point, with the joints between the world and it.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    /// From the world to the place.
    joints: Vec<PlacedJoint>,
    /// Its frame in the link of the last joint, or in the world without joints.
    inside: Frame,
}

/// Motion of a place in the axes of the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaceMotion {
    /// Of the origin, m.
    pub(crate) position: DVec3,
    pub(crate) rotation: DQuat,
    /// Of the origin, m/s.
    pub(crate) velocity: DVec3,
    /// Angular velocity, rad/s.
    pub(crate) spin: DVec3,
}

#[derive(Clone, Copy, Debug)]
struct Frame {
    position: DVec3,
    rotation: DQuat,
}

/// A joint with the frame of its link at coordinates of 0 in the link before.
#[derive(Clone, Copy, Debug)]
struct PlacedJoint {
    rest: Frame,
    /// Its first coordinate and its first velocity in a state.
    first: [usize; 2],
    motion: JointMotion,
}

#[derive(Clone, Copy, Debug)]
enum JointMotion {
    Fixed,
    /// Along x and z, and about y.
    Planar,
    /// Coordinates and velocities are those of the link in the world.
    Free,
    /// About an axis through an anchor, both in the frame of the link.
    Turn {
        axis: DVec3,
        anchor: DVec3,
    },
    /// About all axes through an anchor in the frame of the link.
    Ball {
        anchor: DVec3,
    },
    /// Along an axis in the frame of the link.
    Slide {
        axis: DVec3,
    },
}

impl Robot {
    /// The body with this index in [`Robot::bodies`].
    pub(crate) fn place(&self, body: usize) -> Place {
        let (link, inside) = &self.blueprint.homes[body];
        let mut joints = Vec::new();
        let mut next = *link;
        while let Some(index) = next {
            let (plan, map) = (&self.blueprint.links[index], &self.layout.joints[index]);
            joints.push(PlacedJoint::new(plan, map));
            next = plan.parent;
        }
        joints.reverse();
        Place { joints, inside: Frame::of(inside) }
    }

    /// The root's body, if its axes are not those of the world in the rest pose.
    pub(crate) fn tilted_root(&self) -> Option<Place> {
        let (root, bodies) = (self.layout.root, &self.blueprint.homes);
        let body = bodies.iter().position(|(link, _)| *link == Some(root))?;
        let turned = self.blueprint.links[root].rest.rotation * bodies[body].1.rotation;
        (turned != Rotation::IDENTITY).then(|| self.place(body))
    }
}

impl Place {
    /// Whether it is fixed to the world.
    pub(crate) fn is_fixed(&self) -> bool {
        self.joints.iter().all(|joint| matches!(joint.motion, JointMotion::Fixed))
    }

    /// Whether the same joints move both places: parts of one link, or both fixed to the world.
    pub(crate) fn moves_with(&self, other: &Self) -> bool {
        self.moving().eq(other.moving())
    }

    /// First coordinate and first velocity of each joint that moves the place.
    fn moving(&self) -> impl Iterator<Item = [usize; 2]> {
        let moving = |joint: &&PlacedJoint| !matches!(joint.motion, JointMotion::Fixed);
        self.joints.iter().filter(moving).map(|joint| joint.first)
    }

    /// A point that is fixed to the world, m.
    pub(crate) fn point(at: [f32; 3]) -> Self {
        let position = DVec3::from_array(at.map(f64::from));
        Self { joints: Vec::new(), inside: Frame { position, rotation: DQuat::IDENTITY } }
    }

    /// Its motion at coordinates `[nq]` relative to the rest pose, and velocities `[nv]`.
    pub(crate) fn motion(&self, coordinates: &[f32], velocities: &[f32]) -> PlaceMotion {
        let world = PlaceMotion {
            position: DVec3::ZERO,
            rotation: DQuat::IDENTITY,
            velocity: DVec3::ZERO,
            spin: DVec3::ZERO,
        };
        let along = |base: PlaceMotion, joint: &PlacedJoint| {
            let [coordinate, velocity] = joint.first;
            let at = |k: usize| f64::from(coordinates[coordinate + k]);
            let speed = |k: usize| f64::from(velocities[velocity + k]);
            joint.moved(&base, at, speed)
        };
        self.joints.iter().fold(world, along).carry(&self.inside)
    }
}

impl PlaceMotion {
    /// Motion of a frame that is fixed in this one.
    fn carry(&self, frame: &Frame) -> Self {
        let arm = self.rotation * frame.position;
        Self {
            position: self.position + arm,
            rotation: self.rotation * frame.rotation,
            velocity: self.velocity + self.spin.cross(arm),
            spin: self.spin,
        }
    }

    /// Motion of a link with this frame at rest, after a rotation about an anchor in it, with this additional angular velocity.
    fn turned(&self, anchor: DVec3, rotation: DQuat, spin: DVec3) -> Self {
        let joint = self.carry(&Frame { position: anchor, rotation });
        let (arm, spin) = (joint.rotation * -anchor, joint.spin + spin);
        Self {
            position: joint.position + arm,
            rotation: joint.rotation,
            velocity: joint.velocity + spin.cross(arm),
            spin,
        }
    }
}

impl Frame {
    fn of(pose: &Pose) -> Self {
        let rotation = pose.rotation.as_dquat();
        Self { position: pose.translation.as_dvec3(), rotation }
    }
}

impl PlacedJoint {
    fn new(plan: &LinkPlan, map: &JointMap) -> Self {
        let motion = match &plan.joint {
            JointPlan::Fixed => JointMotion::Fixed,
            JointPlan::Planar(_) => JointMotion::Planar,
            JointPlan::Free(_) | JointPlan::Floating(_) => JointMotion::Free,
            JointPlan::Ball(ball) => JointMotion::Ball { anchor: ball.anchor.as_dvec3() },
            JointPlan::Hinge(hinge) => {
                let mut unit = Vector::ZERO;
                unit[hinge.axis.free] = hinge.axis.sign;
                let axis = (hinge.axis.frame * unit).as_dvec3();
                match hinge.motion {
                    Motion::Rotation | Motion::Ball => {
                        JointMotion::Turn { axis, anchor: hinge.anchor.as_dvec3() }
                    }
                    Motion::Translation => JointMotion::Slide { axis },
                }
            }
        };
        Self { rest: Frame::of(&plan.rest), first: [map.coordinate, map.velocity], motion }
    }

    /// Motion of the link, given that of the link before, the joint's coordinates and its velocities.
    fn moved(
        &self,
        base: &PlaceMotion,
        at: impl Fn(usize) -> f64,
        speed: impl Fn(usize) -> f64,
    ) -> PlaceMotion {
        let rest = base.carry(&self.rest);
        match self.motion {
            JointMotion::Fixed => rest,
            JointMotion::Free => PlaceMotion {
                position: DVec3::new(at(0), at(1), at(2)),
                rotation: DQuat::from_xyzw(at(4), at(5), at(6), at(3)),
                velocity: DVec3::new(speed(0), speed(1), speed(2)),
                spin: DVec3::new(speed(3), speed(4), speed(5)),
            },
            JointMotion::Planar => PlaceMotion {
                position: rest.position + rest.rotation * DVec3::new(at(0), 0.0, at(1)),
                rotation: rest.rotation * turn(DVec3::Y, at(2)),
                velocity: rest.rotation * DVec3::new(speed(0), 0.0, speed(1)),
                spin: rest.rotation * DVec3::Y * speed(2),
            },
            JointMotion::Turn { axis, anchor } => {
                let spin = rest.rotation * axis * speed(0);
                rest.turned(anchor, turn(axis, at(0)), spin)
            }
            JointMotion::Ball { anchor } => {
                let rotation = DQuat::from_xyzw(at(1), at(2), at(3), at(0));
                let spin = DVec3::new(speed(0), speed(1), speed(2));
                rest.turned(anchor, rotation, rest.rotation * (rotation * spin))
            }
            JointMotion::Slide { axis } => {
                let moved = Frame { position: axis * at(0), rotation: DQuat::IDENTITY };
                let mut link = rest.carry(&moved);
                link.velocity += rest.rotation * axis * speed(0);
                link
            }
        }
    }
}

fn turn(axis: DVec3, angle: f64) -> DQuat {
    DQuat::from_array(about(axis.to_array(), angle))
}
