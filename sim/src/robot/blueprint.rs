//! Description of a robot's world, independent of file formats: links, joints, motors, what the world contains.

mod contacts;

use proto::ActivationKind;
use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::prelude::MassProperties;

use super::activation::Activation;
use super::coupling::{Combination, ConnectionPlan, EqualityPlan, TendonPlan, Thrust};
use super::fluid::Fluid;
use super::softness::{ImplicitForces, Integration, Softness, SoftnessOverride};
use super::surface::{ContactOverride, Surface};
use crate::scene::Shape;
pub(crate) use contacts::{Cone, ContactRules, GroundForm, GroundPlan, HeightField, Law, PairPlan};

/// Description of a robot and of the fixed shapes that it can touch.
#[derive(Debug)]
pub(crate) struct Blueprint {
    /// Seconds of one physics step.
    pub(crate) timestep_secs: f64,
    /// Gravity in the world, m/s^2.
    pub(crate) gravity: Vector,
    /// MuJoCo's integrator for the model.
    pub(crate) integration: Integration,
    pub(crate) implicit: ImplicitForces,
    /// A fluid that acts on the bodies.
    pub(crate) fluid: Option<Fluid>,
    /// Shapes that are fixed to the world and can touch the robot, in the order of the model.
    pub(crate) grounds: Vec<GroundPlan>,
    pub(crate) contacts: ContactRules,
    /// What enforces contacts and joint limits.
    pub(crate) law: Law,
    /// Links, parents before children. Each tree has a link without a parent, or whose parent is the base.
    pub(crate) links: Vec<LinkPlan>,
    /// Motors in the order of the model's actuators.
    pub(crate) motors: Vec<MotorPlan>,
    /// Fixed tendons in the order of the model.
    pub(crate) tendons: Vec<TendonPlan>,
    pub(crate) equalities: Vec<EqualityPlan>,
    pub(crate) connections: Vec<ConnectionPlan>,
    /// Keyframes in the order of the model.
    pub(crate) keyframes: Vec<Keyframe>,
    /// Names of the model's bodies in its order, the world first. Bodies without a joint are part of a link.
    pub(crate) bodies: Vec<String>,
    /// For each body, the child of the world that it is or is in; the world's is the world.
    pub(crate) tops: Vec<usize>,
    /// The link of each body, none for the world, and the body's frame in it.
    pub(crate) homes: Vec<(Option<usize>, Pose)>,
    /// What MuJoCo simulates and this simulator leaves out, one sentence each.
    pub(crate) left_out: Vec<String>,
}

/// A state that the model names, in MuJoCo's coordinates. Each list may be empty, or have a wrong length.
#[derive(Clone, Debug)]
pub(crate) struct Keyframe {
    /// Its name; its index without one.
    pub(crate) name: String,
    /// m and rad; quaternions w x y z.
    pub(crate) positions: Vec<f64>,
    /// m/s and rad/s; of a free joint's rotation in the axes of its body.
    pub(crate) velocities: Vec<f64>,
    /// Controls of the actuators.
    pub(crate) controls: Vec<f64>,
    /// Activations of the actuators that have one.
    pub(crate) activations: Vec<f64>,
}

/// A link. Bodies without a joint are merged into the link of their parent.
#[derive(Debug)]
pub(crate) struct LinkPlan {
    pub(crate) name: String,
    /// Index of the parent link; `None` for the first of a tree.
    pub(crate) parent: Option<usize>,
    /// Rest pose in the frame of the parent link, or in the world without one.
    pub(crate) rest: Pose,
    pub(crate) joint: JointPlan,
    pub(crate) mass: MassProperties,
    /// Share of its weight that acts on it: 1 without MuJoCo's `gravcomp`.
    pub(crate) gravity_scale: f32,
    /// Whether MuJoCo counts the whole inverse mass in the softness of its constraints, not a mean over three directions:
    /// one body that slides along axes of its inertia, without children and on nothing that moves.
    pub(crate) is_slider: bool,
    pub(crate) shapes: Vec<ShapePlan>,
}

/// A shape in its link's frame.
#[derive(Debug)]
pub(crate) struct ShapePlan {
    /// Its name in the model, or nothing.
    pub(crate) name: String,
    pub(crate) shape: Shape,
    pub(crate) pose: Pose,
    /// Its contact properties; `None` if it touches nothing.
    pub(crate) surface: Option<Surface>,
    /// Index of its body in the model.
    pub(crate) body: usize,
    /// Mass centre of its body, in the link's frame, m.
    pub(crate) mass_centre: Vector,
}

/// Motion of a link relative to its parent.
#[derive(Debug)]
pub(crate) enum JointPlan {
    /// None: the base of a robot that is fixed to the world.
    Fixed,
    /// Translation along x and z and rotation about y, relative to the world.
    Planar(Planar),
    /// All six degrees of freedom, relative to the world. The link's mass centre is at its origin: rapier moves a root
    /// without a joint about its origin.
    Free(FreeJoint),
    /// As `Free`, with the mass centre anywhere.
    Floating(FreeJoint),
    /// One rotation or translation relative to the parent link.
    Hinge(Hinge),
    /// All rotations about a point of the parent link. Its terms are those of each of the three rotations about the axes of
    /// the link; its range is that of the angle from the rest pose, from 0.
    Ball(Hinge),
}

/// A free joint.
#[derive(Clone, Debug)]
pub(crate) struct FreeJoint {
    pub(crate) name: String,
    /// Damping of each of the six speeds, N s / m and N m s / rad.
    pub(crate) damping: f32,
    /// Inertia added to each of the six speeds, kg and kg m^2.
    pub(crate) armature: f32,
    /// Largest dry friction of each of the six speeds, N and N m; of the rotation about the axes of the link.
    pub(crate) friction: f32,
    pub(crate) friction_softness: Softness,
}

/// Joint names of the planar root (x, z, rotation about y) and offsets to the model's own coordinates.
#[derive(Debug)]
pub(crate) struct Planar {
    pub(crate) names: [String; 3],
    pub(crate) reference: [f32; 3],
}

/// Motion that a hinge or slide allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Motion {
    Rotation,
    Translation,
    /// One of the three rotations of a ball joint.
    Ball,
}

/// A hinge with its passive terms, or a slide, whose units are metres and newtons instead of radians and newton metres.
#[derive(Clone, Debug)]
pub(crate) struct Hinge {
    pub(crate) name: String,
    /// Position in the frame of the child link, m.
    pub(crate) anchor: Vector,
    pub(crate) axis: HingeAxis,
    pub(crate) motion: Motion,
    /// Offset from this crate's coordinate, which is zero in the rest pose, to the model's, rad.
    pub(crate) reference: f32,
    /// rad.
    pub(crate) range: Option<[f32; 2]>,
    /// Distance from the range's ends at which they push, rad.
    pub(crate) margin: f32,
    /// Softness of the range's ends.
    pub(crate) limit: Softness,
    /// N m / rad.
    pub(crate) stiffness: f32,
    /// Rest angle of the spring, rad.
    pub(crate) spring_rest: f32,
    /// Time constant, s, and damping ratio that give stiffness and damping with the inertia of the rest pose.
    pub(crate) spring_damper: Option<[f32; 2]>,
    /// N m s / rad.
    pub(crate) damping: f32,
    /// kg m^2.
    pub(crate) armature: f32,
    /// Largest torque of dry friction, N m.
    pub(crate) friction: f32,
    /// Softness of dry friction.
    pub(crate) friction_softness: Softness,
    /// Range of the sum of the motors' torques, N m.
    pub(crate) torque_range: Option<[f32; 2]>,
    /// Whether the gravity compensation of links counts as a torque of motors.
    pub(crate) compensates_gravity: bool,
}

/// Axis of a hinge, as an axis of the joint's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HingeAxis {
    /// 0, 1 or 2 for x, y or z of the joint's frame.
    pub(crate) free: usize,
    /// -1 if the model's axis points in the opposite direction.
    pub(crate) sign: f32,
    /// Orientation of the joint's frame in both links.
    pub(crate) frame: Rotation,
}

impl HingeAxis {
    /// Frame for a hinge axis. An axis of the link keeps the frame unrotated, because a rotated frame causes round-off
    /// in tangents along which a planar robot cannot move, and this reduces its friction. For other axes, the frame's x
    /// axis is rotated to them.
    pub(crate) fn along(axis: Vector) -> Self {
        let axis = axis.normalize();
        let units = axis.to_array();
        match units.iter().position(|component| component.abs() == 1.0) {
            Some(free) => Self { free, sign: units[free], frame: Rotation::IDENTITY },
            None => {
                Self { free: 0, sign: 1.0, frame: Rotation::from_rotation_arc(Vector::X, axis) }
            }
        }
    }
}

/// A motor: torque = gear x force.
#[derive(Clone, Debug)]
pub(crate) struct MotorPlan {
    /// Name of the actuator; that of its joint, with the kind of actuator if the joint has several, unless stated.
    pub(crate) name: String,
    /// Name of the hinge, tendon or site on which it acts.
    pub(crate) joint: String,
    /// The hinges that it moves; none if it acts on a site.
    pub(crate) moved: Combination,
    /// Where and along what it acts, if that is a site.
    pub(crate) thrust: Option<Thrust>,
    /// Index of its tendon among all tendons, if it drives one.
    pub(crate) tendon: Option<usize>,
    /// N m per unit of force; on a site N, or N m if it exerts a torque alone.
    pub(crate) gear: f32,
    /// Range of the control.
    pub(crate) range: [f32; 2],
    /// `None` if the force is the control.
    pub(crate) servo: Option<Servo>,
    /// What replaces the control in the force, if it has a state of its own.
    pub(crate) activation: Option<Activation>,
}

/// Force of a motor with feedback: `gain c + bias . (1, q, v)`, where `q` and `v` are `gear` times the position and speed of
/// what it moves, within its range.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Servo {
    pub(crate) gain: f32,
    /// The first number is for this crate's coordinate, which is zero in the rest pose. A positive third number of a servo of
    /// the position is its damping ratio, until [`Layout`](super::Layout) gives the joint's inertia.
    pub(crate) bias: [f32; 3],
    /// The first number for the coordinate as agents observe it, which is the joint's `ref` in the rest pose.
    pub(crate) observed_constant: f32,
    pub(crate) range: Option<[f32; 2]>,
}

impl MotorPlan {
    /// Whether the force follows from the sum of all controls.
    pub(crate) fn integrates(&self) -> bool {
        self.activation.is_some_and(|own| own.kind == ActivationKind::Integrator)
    }

    /// The motor with `strength` times its torque at every control and motion.
    pub(crate) fn strengthened(&self, strength: f32) -> Self {
        let mut motor = self.clone();
        match &mut motor.servo {
            None => motor.gear *= strength,
            Some(servo) => {
                servo.gain *= strength;
                servo.bias = servo.bias.map(|part| part * strength);
                servo.range = servo.range.map(|range| range.map(|end| end * strength));
            }
        }
        motor
    }
}

impl Hinge {
    /// Whether it is one of the rotations of a ball joint.
    pub(crate) fn turns_ball(&self) -> bool {
        self.motion == Motion::Ball
    }

    /// Whether it is a slide.
    pub(crate) fn is_slide(&self) -> bool {
        self.motion == Motion::Translation
    }
}

impl LinkPlan {
    /// The hinge or slide of the link, if that is its joint.
    pub(crate) fn hinge(&self) -> Option<&Hinge> {
        match &self.joint {
            JointPlan::Hinge(hinge) => Some(hinge),
            JointPlan::Fixed
            | JointPlan::Planar(_)
            | JointPlan::Free(_)
            | JointPlan::Floating(_)
            | JointPlan::Ball(_) => None,
        }
    }
}

impl LinkPlan {
    /// The ball joint of the link, if that is its joint.
    pub(crate) fn ball(&self) -> Option<&Hinge> {
        match &self.joint {
            JointPlan::Ball(ball) => Some(ball),
            _ => None,
        }
    }
}

impl Blueprint {
    /// Notes the order of accuracy of Runge-Kutta steps if it differs from MuJoCo's.
    pub(crate) fn note_integration(&mut self) {
        let turns = |link: &LinkPlan| {
            matches!(link.joint, JointPlan::Free(_) | JointPlan::Floating(_) | JointPlan::Ball(_))
        };
        let count = self.links.iter().filter(|link| turns(link)).count();
        let is_constrained = self.law == Law::Constraints;
        if is_constrained && self.integration == Integration::RungeKutta && count > 0 {
            self.left_out.push(format!(
                "the Runge-Kutta step of rotations in space has an error of second order, MuJoCo's of fourth: {count} \
                 free and ball joints"
            ));
        }
    }

    /// Replaces what a task states of the softness and margin of all contacts and limits.
    pub(crate) fn soften(&mut self, contacts: ContactOverride, limits: &SoftnessOverride) {
        let step_secs = self.timestep_secs;
        for pair in &mut self.contacts.pairs {
            pair.contact.softness = pair.contact.softness.with(&contacts.softness, step_secs);
            let own =
                pair.contact.friction_softness.map(|own| own.with(&contacts.softness, step_secs));
            pair.contact.friction_softness = own;
            pair.contact.margin = contacts.margin.unwrap_or(pair.contact.margin);
        }
        self.contacts.stated = contacts;
        for link in &mut self.links {
            if let JointPlan::Hinge(hinge) | JointPlan::Ball(hinge) = &mut link.joint {
                hinge.limit = hinge.limit.with(limits, step_secs);
            }
        }
    }

    /// First link of the tree that a link belongs to. The base is a tree of its own.
    pub(crate) fn tree_of(&self, link: usize) -> usize {
        let parent = self.links[link].parent.filter(|parent| !self.links[*parent].is_base());
        parent.map_or(link, |parent| self.tree_of(parent))
    }

    /// Whether two shapes of links are parts of one robot: of links of a tree, or of a link and the fixed bodies that are in the
    /// same child of the world, its base.
    pub(crate) fn are_of_one_robot(&self, one: &ShapePlan, other: &ShapePlan) -> bool {
        let links = [one, other].map(|shape| self.link_of_shape(shape));
        if links.iter().any(|link| self.links[*link].is_base()) {
            self.tops[one.body] == self.tops[other.body]
        } else {
            self.tree_of(links[0]) == self.tree_of(links[1])
        }
    }

    /// The link of a shape.
    pub(crate) fn link_of_shape(&self, shape: &ShapePlan) -> usize {
        self.homes[shape.body].0.expect("the body of a link's shape is a part of the link")
    }

    /// Whether more than one tree moves.
    pub(crate) fn has_several_trees(&self) -> bool {
        let moving = (0..self.links.len()).filter(|link| !self.links[*link].is_base());
        moving.filter(|link| self.tree_of(*link) == *link).count() > 1
    }

    /// The links that a motor moves: those of its hinges, or that of its site.
    pub(crate) fn links_of<'a>(&'a self, motor: &'a MotorPlan) -> impl Iterator<Item = usize> + 'a {
        let hinges = motor.moved.0.iter().filter_map(|(hinge, _)| self.link_of(*hinge));
        hinges.chain(motor.thrust.map(|thrust| thrust.link))
    }

    /// The robot's root: the first link of the first tree with a motor, or of the first tree.
    pub(crate) fn root(&self) -> usize {
        let driven = self.motors.iter().flat_map(|motor| self.links_of(motor)).min();
        let link = driven.or((0..self.links.len()).find(|link| !self.links[*link].is_base()));
        link.map_or(0, |link| self.tree_of(link))
    }

    /// Link of a rotation or translation by its index among all: those of hinges, then three of each ball joint.
    fn link_of(&self, hinge: usize) -> Option<usize> {
        let has_hinge = |link: &usize| self.links[*link].hinge().is_some();
        let has_ball = |link: &usize| self.links[*link].ball().is_some();
        let links = 0..self.links.len();
        let turned = links.clone().filter(has_ball).flat_map(|link| [link; 3]);
        links.filter(has_hinge).chain(turned).nth(hinge)
    }

    /// All shapes of the links, in order.
    pub(crate) fn shapes(&self) -> impl Iterator<Item = &ShapePlan> {
        self.links.iter().flat_map(|link| &link.shapes)
    }
}
