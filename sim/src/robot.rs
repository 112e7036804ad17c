//! Robots: one row each. Each robot is built once as a template, from which all worlds are cloned.

mod assemble;
mod blueprint;
mod inertia;
mod layout;
mod model;
mod neighbourhood;
mod softness;

use crate::error::SimError;
use crate::state::StateBounds;

pub(crate) use assemble::{Template, empty_world};
pub(crate) use blueprint::{Blueprint, JointPlan, LinkPlan};
pub(crate) use layout::{HingeMap, JointMap, Layout, MapKind};
pub(crate) use neighbourhood::Neighbourhood;
#[cfg(test)]
pub(crate) use softness::DEFAULT as DEFAULT_SOFTNESS;
pub(crate) use softness::{Integration, Softness, Spring};

/// A robot: its model and the settings that MJCF does not contain.
#[derive(Debug)]
pub(crate) struct RobotRow {
    /// Name of the robot; its states have the kind `rapier/NAME`.
    pub(crate) name: &'static str,
    /// MJCF document of the model.
    pub(crate) mjcf: &'static str,
    /// Physics steps in an environment step.
    pub(crate) frame_skip: u32,
    /// Neighbouring joints, for agents with local observations.
    pub(crate) neighbourhood: &'static Neighbourhood,
    /// MuJoCo's integrator for this robot.
    pub(crate) integration: Integration,
    /// MuJoCo's softness of the joint limits.
    pub(crate) limits: Softness,
    /// MuJoCo's softness of the contacts.
    pub(crate) contacts: Softness,
    /// Distance at which contacts become active, m.
    pub(crate) margin: f32,
    /// Part of the contacts' compliance that the engine's solver applies, in units of their inverse mass.
    /// [`ContactLaw`](crate::world::ContactLaw) applies the rest, from the impulses of the last step.
    pub(crate) contact_compliance: f32,
}

pub(crate) const HALFCHEETAH: RobotRow = RobotRow {
    name: "halfcheetah",
    mjcf: include_str!("../assets/halfcheetah.xml"),
    frame_skip: 5,
    neighbourhood: &neighbourhood::HALFCHEETAH,
    integration: Integration::Euler,
    limits: Softness { impedance: [0.0, 0.8], width: 0.03, ..softness::DEFAULT },
    contacts: Softness { impedance: [0.0, 0.8], width: 0.01, ..softness::DEFAULT },
    margin: 0.0,
    contact_compliance: 0.6,
};

pub(crate) const WALKER2D: RobotRow = RobotRow {
    name: "walker2d",
    mjcf: include_str!("../assets/walker2d.xml"),
    frame_skip: 4,
    neighbourhood: &neighbourhood::WALKER2D,
    integration: Integration::RungeKutta,
    limits: softness::DEFAULT,
    contacts: softness::DEFAULT,
    margin: 0.0,
    contact_compliance: 0.1,
};

pub(crate) const ANT: RobotRow = RobotRow {
    name: "ant",
    mjcf: include_str!("../assets/ant.xml"),
    frame_skip: 5,
    neighbourhood: &neighbourhood::ANT,
    integration: Integration::RungeKutta,
    limits: softness::DEFAULT,
    contacts: softness::DEFAULT,
    margin: 0.01,
    contact_compliance: 0.05,
};

/// A robot from which worlds are created. Immutable and shared.
pub struct Robot {
    row: &'static RobotRow,
    blueprint: Blueprint,
    layout: Layout,
    template: Template,
}

impl Robot {
    pub(crate) fn build(row: &'static RobotRow) -> Result<Self, SimError> {
        let model = |reason| SimError::Model { robot: row.name.to_owned(), reason };
        let blueprint = model::read(row.mjcf).map_err(model)?;
        let (template, layout) = assemble::assemble(&blueprint, row).map_err(model)?;
        Ok(Self { row, blueprint, layout, template })
    }

    /// Name of the robot.
    pub fn name(&self) -> &'static str {
        self.row.name
    }

    /// Kind of its encoded states.
    pub(crate) fn state_kind(&self) -> String {
        format!("rapier/{}", self.row.name)
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

    /// Names of the hinges and their limits (rad), if any.
    pub fn hinges(&self) -> impl Iterator<Item = (&str, Option<[f32; 2]>)> {
        self.blueprint.links.iter().filter_map(|link| match &link.joint {
            JointPlan::Hinge(hinge) => Some((hinge.name.as_str(), hinge.range)),
            JointPlan::Planar(_) | JointPlan::Free(_) => None,
        })
    }

    /// Joints of the motors, in the order of the model's actuators.
    pub fn actuators(&self) -> impl Iterator<Item = &str> {
        self.blueprint.motors.iter().map(|motor| motor.joint.as_str())
    }

    /// Torque of the motor of `joint` for a control, which is clamped to its range, N m; `None` without a motor.
    pub fn torque(&self, joint: &str, control: f32) -> Option<f32> {
        let motor = self.blueprint.motors.iter().find(|motor| motor.joint == joint)?;
        Some(motor.gear * control.clamp(motor.range[0], motor.range[1]))
    }

    /// Name, mass (kg) and ascending principal inertias about the centre of mass (kg m^2) of each link.
    pub fn masses(&self) -> impl Iterator<Item = (&str, f32, [f32; 3])> {
        self.blueprint.links.iter().map(|link| {
            let mut inertia = link.mass.principal_inertia().to_array();
            inertia.sort_by(f32::total_cmp);
            (link.name.as_str(), link.mass.mass(), inertia)
        })
    }

    /// Seconds that one environment step simulates.
    pub(crate) fn step_secs(&self) -> f64 {
        self.blueprint.timestep_secs * f64::from(self.row.frame_skip)
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
            fastest: layout::FASTEST,
            contact_forces: 0,
            orientation: self.layout.orientation,
        }
    }

    pub(crate) fn neighbourhood(&self) -> &'static Neighbourhood {
        self.row.neighbourhood
    }

    pub(crate) fn row(&self) -> &'static RobotRow {
        self.row
    }

    pub(crate) fn frame_skip(&self) -> u32 {
        self.row.frame_skip
    }

    pub(crate) fn blueprint(&self) -> &Blueprint {
        &self.blueprint
    }

    pub(crate) fn layout(&self) -> &Layout {
        &self.layout
    }

    pub(crate) fn template(&self) -> &Template {
        &self.template
    }
}
