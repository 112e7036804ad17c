//! Robots. Each robot is built once as a template, from which all worlds are cloned.

mod activation;
mod actuator;
mod assemble;
mod blueprint;
mod convex;
mod coupling;
mod document;
mod exploration;
mod fluid;
mod folder;
mod frame;
mod heights;
mod inertia;
mod kinematics;
mod layout;
mod mesh;
mod model;
mod neighbourhood;
mod nesting;
mod softness;
mod surface;

use serde::Deserialize;

use activation::Activation;

use crate::arrays;
use crate::error::SimError;
use crate::scene::{LinkShape, parts};
use crate::state::StateBounds;

pub use actuator::{Actuator, Torque};
pub(crate) use assemble::{
    Template, ball_joint, ball_rotation, empty_world, floating_joint, shape_of,
};
pub(crate) use blueprint::{
    Blueprint, Cone, ContactRules, GroundForm, GroundPlan, HeightField, JointPlan, Keyframe, Law,
    LinkPlan, MotorPlan, PairPlan, ShapePlan,
};
pub(crate) use convex::Convex;
pub(crate) use coupling::{Combination, ConnectionPlan, Coupled, EqualityPlan, TendonPlan, Thrust};
pub(crate) use fluid::Fluid;
pub(crate) use frame::{product, turned, unit};
pub(crate) use kinematics::{Place, PlaceMotion};
pub(crate) use layout::{FreeFriction, HingeMap, JointMap, Layout, MapKind, Orientation};
pub(crate) use neighbourhood::Neighbourhood;
#[cfg(test)]
pub(crate) use softness::Reference;
pub(crate) use softness::{ImplicitForces, Integration, Softness, SoftnessOverride, Spring};
pub(crate) use surface::{ContactOverride, ContactPlan, Surface};

/// A robot: its model and the settings that MJCF does not contain.
#[derive(Debug)]
pub(crate) struct RobotRow {
    /// Name of the robot; its states have the kind `rapier/NAME`.
    pub(crate) name: String,
    /// MJCF document of the model.
    pub(crate) mjcf: String,
    /// Physics steps in an environment step.
    pub(crate) frame_skip: u32,
    /// Neighbouring joints, for agents with local observations.
    pub(crate) neighbourhood: Neighbourhood,
    pub(crate) physics: Physics,
}

/// MuJoCo's parameters in place of the model's; absent ones are the model's.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Physics {
    pub(crate) integration: Option<Integration>,
    /// Softness of the joint limits.
    #[serde(deserialize_with = "arrays::table")]
    pub(crate) limits: SoftnessOverride,
    /// Softness of the contacts.
    #[serde(deserialize_with = "arrays::table")]
    pub(crate) contacts: SoftnessOverride,
    /// Distance at which contacts become active, m.
    pub(crate) margin: Option<f32>,
    /// Whether links of a robot touch each other and its base.
    pub(crate) self_contacts: Option<bool>,
    /// Selects [`Law::Engine`], with this compliance.
    pub(crate) contact_compliance: Option<f32>,
}

/// `self_contacts` of a robot that states neither it nor `contact_compliance`.
const LINKS_TOUCH: bool = true;

/// A robot from which worlds are created. Immutable and shared.
pub struct Robot {
    name: String,
    pub(crate) frame_skip: u32,
    pub(crate) neighbourhood: Neighbourhood,
    pub(crate) blueprint: Blueprint,
    pub(crate) layout: Layout,
    pub(crate) template: Template,
}

/// Replaces a damping ratio by MuJoCo's damping, `2 ratio sqrt(kp m)`, where `m` is the inertia of the joint or tendon with all
/// other joints free.
fn damp(motor: &mut MotorPlan, layout: &Layout) {
    let Some(servo) = &mut motor.servo else { return };
    let [_, stiffness, ratio] = servo.bias;
    if ratio > 0.0 && servo.gain == -stiffness && motor.gear != 0.0 {
        let inverse = match (motor.tendon, motor.moved.only_hinge()) {
            (Some(tendon), _) => layout.tendon_inverses[tendon] as f32,
            (None, Some(hinge)) => layout.hinges[hinge].axis_inverse_inertia,
            (None, None) => return,
        };
        let inertia = 1.0 / (inverse * motor.gear * motor.gear);
        // What nothing moves has no inertia, and a negative gain no damping.
        let damping = 2.0 * ratio * (servo.gain * inertia).sqrt();
        servo.bias[2] = if damping.is_finite() { -damping } else { 0.0 };
    }
}

/// Reads a model as one document. A document that needs no other file is returned unchanged. Otherwise the files that
/// it includes become part of it, colliding meshes become the corners of their convex hulls, and masses that come
/// from meshes become `inertial` elements; what has no effect on the motion is left out. `read` returns the content of
/// a file, or the reason why it cannot be read. Its paths are relative to the model's folder and never leave it.
///
/// # Errors
/// If a file cannot be read or the model cannot be built.
pub fn one_document(
    document: &str,
    read: impl Fn(&str) -> Result<Vec<u8>, String>,
) -> Result<String, SimError> {
    let refused = |reason| SimError::Model { robot: document.to_owned(), reason };
    let mut folder = folder::Folder::new(document, &read).map_err(refused)?;
    let text = folder.document().map_err(refused)?;
    model::read(&text, &mut folder).map_err(refused)?;
    if folder.known.len() == 1 {
        return Ok(text);
    }
    folder.recount();
    model::flat(&text, &mut folder).map_err(refused)
}

impl Robot {
    /// Builds a robot whose model is one document.
    pub(crate) fn build(row: RobotRow) -> Result<Self, SimError> {
        Self::of_files(row, &|path| {
            Err(format!("{path}: the model of a task is one document without other files"))
        })
    }

    /// Builds the robot of a model without a task, with the model's own parameters and one physics step per environment
    /// step. `read` returns the content of a file, or the reason why it cannot be read.
    ///
    /// # Errors
    /// If a file cannot be read or the model cannot be built.
    pub fn of_model(
        document: &str,
        read: impl Fn(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Self, SimError> {
        let refused = |reason| SimError::Model { robot: document.to_owned(), reason };
        let mut folder = folder::Folder::new(document, &read).map_err(refused)?;
        let row = RobotRow {
            name: document.to_owned(),
            mjcf: folder.document().map_err(refused)?,
            frame_skip: 1,
            neighbourhood: Neighbourhood::default(),
            physics: Physics::default(),
        };
        Self::of_files(row, &read)
    }

    /// Builds a robot whose model names files that `source` reads. [`Self::left_out`] lists what MuJoCo simulates in
    /// addition.
    pub(crate) fn of_files(
        row: RobotRow,
        source: &dyn Fn(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Self, SimError> {
        let refused = |reason| SimError::Model { robot: row.name.clone(), reason };
        let mut folder = folder::Folder::new(&row.name, source).map_err(refused)?;
        let mut blueprint = model::read(&row.mjcf, &mut folder).map_err(refused)?;
        let Physics { integration, limits, contacts, margin, self_contacts, contact_compliance } =
            row.physics;
        if let Some(other) = integration.filter(|other| *other != blueprint.integration) {
            blueprint.implicit = match other {
                Integration::Euler => ImplicitForces::Damping,
                Integration::RungeKutta => ImplicitForces::Nothing,
            };
            blueprint.integration = other;
        }
        blueprint.soften(ContactOverride { softness: contacts, margin }, &limits);
        blueprint.contacts.links_touch =
            self_contacts.unwrap_or(LINKS_TOUCH && contact_compliance.is_none());
        blueprint.note_link_contacts();
        if let Some(compliance) = contact_compliance {
            blueprint.use_engine(compliance).map_err(refused)?;
        }
        blueprint.note_integration();
        let (template, layout) = assemble::assemble(&blueprint).map_err(refused)?;
        layout.check_names().map_err(refused)?;
        blueprint.motors.iter_mut().for_each(|motor| damp(motor, &layout));
        Ok(Self {
            name: row.name,
            frame_skip: row.frame_skip,
            neighbourhood: row.neighbourhood,
            blueprint,
            layout,
            template,
        })
    }

    /// Name of the robot.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What MuJoCo simulates for this model and this simulator leaves out, one sentence each.
    pub fn left_out(&self) -> &[String] {
        &self.blueprint.left_out
    }

    /// Kind of its encoded states.
    pub(crate) fn state_kind(&self) -> String {
        format!("rapier/{}", self.name)
    }

    /// Names of the generalised coordinates, `[nq]`.
    pub fn coordinate_names(&self) -> &[String] {
        &self.layout.coordinate_names
    }

    /// Names of the generalised velocities, `[nv]`.
    pub fn velocity_names(&self) -> &[String] {
        &self.layout.velocity_names
    }

    /// Offset from this crate's coordinates to the model's own, `[nq]`, m and rad.
    pub fn reference(&self) -> &[f32] {
        &self.layout.reference
    }

    /// Coordinates of the rest pose, `[nq]`.
    pub fn rest(&self) -> &[f32] {
        &self.layout.rest
    }

    /// Names of the model's bodies, the world first. Bodies without a joint are part of a link.
    pub(crate) fn bodies(&self) -> &[String] {
        &self.blueprint.bodies
    }

    /// Limits of the hinges and slides as in `qpos` (rad or m), if any.
    pub fn limits_in_qpos(&self) -> impl Iterator<Item = Option<[f32; 2]>> {
        let hinges = self.blueprint.links.iter().filter_map(LinkPlan::hinge);
        hinges.map(|hinge| hinge.range.map(|range| range.map(|end| end + hinge.reference)))
    }

    /// Names of the hinges and slides and the limits (rad or m) of their positions relative to the rest pose, if any.
    pub fn hinges(&self) -> impl Iterator<Item = (&str, Option<[f32; 2]>)> {
        let hinges = self.blueprint.links.iter().filter_map(LinkPlan::hinge);
        hinges.map(|hinge| (hinge.name.as_str(), hinge.range))
    }

    /// Names of the ball joints and their largest angles from the rest pose (rad), if any.
    pub fn balls(&self) -> impl Iterator<Item = (&str, Option<f32>)> {
        let balls = self.blueprint.links.iter().filter_map(LinkPlan::ball);
        balls.map(|ball| (ball.name.as_str(), ball.range.map(|[_, largest]| largest)))
    }

    /// Names of the coordinates and of the velocities of a hinge, slide or ball joint.
    pub(crate) fn numbers_of(&self, joint: &str) -> [Vec<String>; 2] {
        if !self.balls().any(|(name, _)| name == joint) {
            return [vec![joint.to_owned()], vec![joint.to_owned()]];
        }
        let parts = |parts: &[&str]| parts.iter().map(|part| format!("{joint}.{part}")).collect();
        [parts(&layout::QUATERNION), parts(&layout::TURNING)]
    }

    /// Names of the joints in the order of [`World::efforts`](crate::World::efforts): hinges and slides, then the three axes of
    /// each ball joint.
    pub fn effort_names(&self) -> Vec<String> {
        let hinges = self.hinges().map(|(name, _)| name.to_owned());
        hinges.chain(self.balls().flat_map(|(name, _)| self.numbers_of(name)[1].clone())).collect()
    }

    /// Whether a coordinate is of a hinge whose range suggests degrees that were read as radians.
    pub(crate) fn has_range_in_degrees(&self, coordinate: usize) -> bool {
        let hinges = self.layout.hinges.iter().enumerate();
        let mut wide = hinges.filter(|(_, hinge)| hinge.has_range_in_degrees());
        wide.any(|(index, _)| self.layout.hinge_coordinate(index) == coordinate)
    }

    /// Name of the joint, tendon or site of each actuator, and the links that it moves. Actuators on joints come first.
    pub(crate) fn moved_links(&self) -> impl Iterator<Item = (&str, Vec<usize>)> {
        let motors = self.blueprint.motors.iter();
        let (own, others): (Vec<_>, Vec<_>) =
            motors.partition(|motor| motor.tendon.is_none() && motor.thrust.is_none());
        let motors = own.into_iter().chain(others);
        motors.map(|motor| (motor.joint.as_str(), self.blueprint.links_of(motor).collect()))
    }

    /// Units of the coordinates of hinges and slides, in the order of [`Self::hinges`].
    pub fn hinge_units(&self) -> impl Iterator<Item = &'static str> {
        self.layout.hinges.iter().map(|hinge| hinge.units()[0])
    }

    /// Name, mass (kg) and ascending principal inertias about the centre of mass (kg m^2) of each link.
    pub fn masses(&self) -> impl Iterator<Item = (&str, f32, [f32; 3])> {
        self.blueprint.links.iter().map(|link| {
            let mut inertia = link.mass.principal_inertia().to_array();
            inertia.sort_by(f32::total_cmp);
            (link.name.as_str(), link.mass.mass(), inertia)
        })
    }

    /// Shapes of the robot, link by link.
    pub fn shapes(&self) -> Vec<LinkShape> {
        let of_link = |link: &LinkPlan| {
            let name = link.name.clone();
            let shape = move |plan: &ShapePlan| {
                let (position, quaternion) = parts(&plan.pose);
                LinkShape { link: name.clone(), shape: plan.shape.clone(), position, quaternion }
            };
            link.shapes.iter().map(shape).collect::<Vec<_>>()
        };
        self.blueprint.links.iter().flat_map(of_link).collect()
    }

    /// Seconds that one environment step simulates.
    pub(crate) fn step_secs(&self) -> f64 {
        self.blueprint.timestep_secs * f64::from(self.frame_skip)
    }

    /// Seconds of one physics step.
    pub fn physics_step_secs(&self) -> f64 {
        self.blueprint.timestep_secs
    }

    /// Bounds of this robot's states in a task with episodes of `longest` steps.
    pub(crate) fn state_bounds(&self, longest: u32) -> StateBounds {
        StateBounds {
            kind: self.state_kind(),
            longest,
            coordinates: self.layout.coordinate_bounds.clone(),
            velocities: self.layout.velocity_names.len(),
            activations: self.activations().map(Activation::bounds).collect(),
            fastest: layout::FASTEST,
            orientations: self.layout.quaternions().collect(),
            ..StateBounds::default()
        }
    }

    /// Activations of the actuators that have one, in the model's order, `[m]`.
    pub(crate) fn activations(&self) -> impl Iterator<Item = &Activation> {
        self.blueprint.motors.iter().filter_map(|motor| motor.activation.as_ref())
    }
}
