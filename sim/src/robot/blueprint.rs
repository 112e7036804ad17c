//! Description of a robot's world, independent of file formats: links, joints, motors, what stands in the world.

use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::prelude::MassProperties;

use super::coupling::{Combination, ConnectionPlan, EqualityPlan, TendonPlan};
use super::softness::{Integration, Softness, SoftnessOverride};
use super::surface::{ContactOverride, ContactPlan, Surface};
use crate::scene::Shape;

/// Description of a robot and of the fixed shapes that it can touch.
#[derive(Debug)]
pub(crate) struct Blueprint {
    /// Seconds of one physics step.
    pub(crate) timestep_secs: f64,
    /// Gravity in the world, m/s^2.
    pub(crate) gravity: Vector,
    /// MuJoCo's integrator for the model.
    pub(crate) integration: Integration,
    /// Shapes that are fixed to the world and can touch the robot, in the order of the model.
    pub(crate) grounds: Vec<GroundPlan>,
    pub(crate) contacts: ContactRules,
    /// What enforces contacts and joint limits.
    pub(crate) law: Law,
    /// Links, parents before children. The first is the root.
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
    /// What MuJoCo simulates and this simulator leaves out, one sentence each.
    pub(crate) left_out: Vec<String>,
}

/// What enforces contacts and joint limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Law {
    /// MuJoCo's soft constraints, solved for all contacts and limits together:
    /// [`Constraints`](crate::world::Constraints).
    Constraints,
    /// The engine's solver, contact after contact, which applies this part of the contacts' compliance in units of
    /// their inverse mass; [`ContactLaw`](crate::world::ContactLaw) applies the rest from the impulses of the last
    /// step. The published robots have it.
    Engine { compliance: f32 },
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
}

/// A shape that is fixed to the world.
#[derive(Debug)]
pub(crate) struct GroundPlan {
    /// Its name in the model, or nothing.
    pub(crate) name: String,
    pub(crate) form: GroundForm,
    pub(crate) pose: Pose,
    pub(crate) surface: Surface,
    /// Index of its body in the model.
    pub(crate) body: usize,
}

/// Form of a shape that is fixed to the world.
#[derive(Debug)]
pub(crate) enum GroundForm {
    /// A half-space below the plane z = 0.
    Plane,
    Solid(Shape),
}

/// Rules for contacts of a whole model.
#[derive(Clone, Debug)]
pub(crate) struct ContactRules {
    pub(crate) cone: Cone,
    /// Ratio of the compliance of a contact's normal to that of its friction.
    pub(crate) impratio: f64,
    /// What a task states in place of the model's numbers.
    pub(crate) stated: ContactOverride,
    /// Shapes that touch by rules of their own, in the order of their shapes.
    pub(crate) pairs: Vec<PairPlan>,
    /// Bodies that do not touch, the one with the smaller index first.
    pub(crate) excluded: Vec<[usize; 2]>,
    /// Whether links touch each other and the base.
    pub(crate) links_touch: bool,
}

/// Two shapes that touch by rules of their own.
#[derive(Clone, Debug)]
pub(crate) struct PairPlan {
    /// Their indices among the shapes of all links, then the fixed shapes, the smaller first.
    pub(crate) shapes: [usize; 2],
    pub(crate) contact: ContactPlan,
}

/// Limit of a contact's friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Cone {
    /// A pyramid with its edges along the tangents.
    Pyramidal,
    Elliptic,
}

/// A link. Bodies without a joint are merged into the link of their parent.
#[derive(Debug)]
pub(crate) struct LinkPlan {
    pub(crate) name: String,
    /// Index of the parent link; `None` for the root.
    pub(crate) parent: Option<usize>,
    /// Rest pose in the frame of the parent link, or in the world for the root.
    pub(crate) rest: Pose,
    pub(crate) joint: JointPlan,
    pub(crate) mass: MassProperties,
    /// Share of its weight that acts on it: 1 without MuJoCo's `gravcomp`.
    pub(crate) gravity_scale: f32,
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
    /// Name of the hinge or tendon that it drives.
    pub(crate) joint: String,
    /// The hinges that it moves.
    pub(crate) moved: Combination,
    /// Index of its tendon among all tendons, if it drives one.
    pub(crate) tendon: Option<usize>,
    /// N m per unit of force.
    pub(crate) gear: f32,
    /// Range of the control.
    pub(crate) range: [f32; 2],
    /// `None` if the force is the control.
    pub(crate) servo: Option<Servo>,
}

/// Force of a motor with feedback: `gain c + bias . (1, q, v)`, where `q` and `v` are `gear` times the position and speed of
/// what it moves, within its range.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Servo {
    pub(crate) gain: f32,
    /// The first number is for this crate's coordinate, which is zero in the rest pose. A positive third number of a servo of
    /// the position is its damping ratio, until [`Layout`](super::Layout) gives the joint's inertia.
    pub(crate) bias: [f32; 3],
    pub(crate) range: Option<[f32; 2]>,
}

impl MotorPlan {
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
            | JointPlan::Floating(_) => None,
        }
    }
}

impl Blueprint {
    /// Replaces what a task states of the softness and margin of all contacts and limits.
    pub(crate) fn soften(&mut self, contacts: ContactOverride, limits: &SoftnessOverride) {
        for pair in &mut self.contacts.pairs {
            pair.contact.softness = pair.contact.softness.with(&contacts.softness);
            pair.contact.margin = contacts.margin.unwrap_or(pair.contact.margin);
        }
        self.contacts.stated = contacts;
        for link in &mut self.links {
            if let JointPlan::Hinge(hinge) = &mut link.joint {
                hinge.limit = hinge.limit.with(limits);
            }
        }
    }

    /// Sets whether links touch each other and the base. If not, this is noted as left out.
    pub(crate) fn let_links_touch(&mut self, links_touch: bool) {
        self.contacts.links_touch = links_touch;
        let shapes: Vec<(usize, &ShapePlan)> = (0..self.links.len())
            .flat_map(|link| self.links[link].shapes.iter().map(move |shape| (link, shape)))
            .collect();
        let meet = |(a, one): &(usize, &ShapePlan), (b, other): &(usize, &ShapePlan)| {
            let surfaces = one.surface.zip(other.surface);
            let bodies = [one.body.min(other.body), one.body.max(other.body)];
            a != b
                && surfaces.is_some_and(|(one, other)| one.meets(&other))
                && self.parent_of(*a) != Some(*b)
                && self.parent_of(*b) != Some(*a)
                && !self.contacts.excluded.contains(&bodies)
        };
        let meets = |shape: &&(usize, &ShapePlan)| shapes.iter().any(|other| meet(shape, other));
        let count = if links_touch { 0 } else { shapes.iter().filter(meets).count() };
        if count > 0 {
            let what = format!("links do not touch each other: contacts between {count} shapes");
            self.left_out.push(what);
        }
    }

    /// The link of the parent of a link's body; none on the world or the base. A body with several joints has links without
    /// a mass before its own.
    pub(crate) fn parent_of(&self, link: usize) -> Option<usize> {
        let mut parent = self.links[link].parent?;
        while self.links[parent].mass.inv_mass == 0.0 && !self.links[parent].is_base() {
            parent = self.links[parent].parent?;
        }
        Some(parent).filter(|parent| !self.links[*parent].is_base())
    }

    /// Has the engine's solver enforce contacts and limits, which it cannot do for all models.
    pub(crate) fn use_engine(&mut self, compliance: f32) -> Result<(), String> {
        let reason = |why: &str| Err(format!("`physics.contact_compliance` {why}; remove it"));
        let is_plain = self.contacts.pairs.is_empty() && !self.contacts.links_touch;
        let grounds = self.grounds.as_slice();
        if !is_plain || !matches!(grounds, [] | [GroundPlan { form: GroundForm::Plane, .. }]) {
            return reason("needs a world with one plane and nothing else to touch");
        }
        let contacts = self.shapes().filter_map(|shape| self.floor_contact(shape));
        let contacts = contacts.map(|contact| contact.softness);
        let hinges = self.links.iter().filter_map(LinkPlan::hinge);
        let limits = hinges.filter(|hinge| hinge.range.is_some()).map(|hinge| hinge.limit);
        if !contacts.chain(limits).all(|softness| softness.is_plain()) {
            return reason(
                "needs `solref` with a damping ratio of 1 and `solimp` with midpoint 0.5 and power 2",
            );
        }
        let free = |joint: &JointPlan| match joint {
            JointPlan::Free(free) | JointPlan::Floating(free) => free.friction,
            _ => 0.0,
        };
        let has_limit = |tendon: &TendonPlan| tendon.range.is_some() || tendon.friction > 0.0;
        if !self.equalities.is_empty()
            || !self.connections.is_empty()
            || self.tendons.iter().any(has_limit)
            || self.links.iter().any(|link| free(&link.joint) > 0.0)
        {
            return reason(
                "needs a model without equalities, limits or friction of tendons, and friction of a free joint",
            );
        }
        if self.contacts.cone == Cone::Elliptic {
            let what = "friction is limited by a pyramid, not by an elliptic cone";
            self.left_out.push(what.to_owned());
        }
        if self.contacts.impratio != 1.0 {
            self.left_out.push("`impratio` is 1".to_owned());
        }
        self.law = Law::Engine { compliance };
        Ok(())
    }

    /// Contact of a shape with the fixed shape `ground`; `None` if MuJoCo computes none.
    pub(crate) fn contact(&self, shape: &ShapePlan, ground: &GroundPlan) -> Option<ContactPlan> {
        let surface = shape.surface.filter(|surface| surface.meets(&ground.surface))?;
        Some(surface.contact(&ground.surface, &self.contacts.stated, self.timestep_secs))
    }

    /// Whether a shape, the one with the index `index` of all, can touch anything.
    pub(crate) fn touches(&self, link: &LinkPlan, index: usize, shape: &ShapePlan) -> bool {
        let Some(surface) = shape.surface else { return false };
        let is_paired = self.contacts.pairs.iter().any(|pair| pair.shapes.contains(&index));
        let is_on_ground =
            self.grounds.iter().any(|ground| surface.meets(&ground.surface)) && !link.is_base();
        is_paired || is_on_ground || (self.contacts.links_touch && surface.collides())
    }

    /// Contact of a shape with the first fixed shape, the only one in the engine's law.
    pub(crate) fn floor_contact(&self, shape: &ShapePlan) -> Option<ContactPlan> {
        self.contact(shape, self.grounds.first()?)
    }

    /// All shapes of the links, in order.
    pub(crate) fn shapes(&self) -> impl Iterator<Item = &ShapePlan> {
        self.links.iter().flat_map(|link| &link.shapes)
    }
}
