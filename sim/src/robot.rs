//! Robots: one row each, built once into a template world that every environment's world is cloned from.

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

/// One robot: its model and the settings that MJCF cannot say.
#[derive(Debug)]
pub(crate) struct RobotRow {
    /// The robot's name; its states are of the kind `rapier/NAME`.
    pub(crate) name: &'static str,
    /// The model.
    pub(crate) mjcf: &'static str,
    /// Physics steps in an environment step.
    pub(crate) frame_skip: u32,
    /// Who is next to whom, for agents that see only what is near.
    pub(crate) neighbourhood: &'static Neighbourhood,
    /// How MuJoCo integrates it.
    pub(crate) integration: Integration,
    /// MuJoCo's softness of the joint limits.
    pub(crate) limits: Softness,
    /// MuJoCo's softness of the contacts.
    pub(crate) contacts: Softness,
    /// Distance from which contacts push, m.
    pub(crate) margin: f32,
    /// The part of the contacts' compliance that the engine's own solver takes, in units of their inverse mass. The rest
    /// is [`ContactLaw`](crate::world::ContactLaw)'s, from the last step's impulses.
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

/// A robot, ready to be put into worlds. Immutable and shared.
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

    /// The robot's name.
    pub fn name(&self) -> &'static str {
        self.row.name
    }

    /// What its states are called on the wire.
    pub(crate) fn state_kind(&self) -> String {
        format!("rapier/{}", self.row.name)
    }

    /// Names of the generalised coordinates `[nq]`.
    pub fn coordinate_names(&self) -> &[String] {
        &self.layout.coordinate_names
    }

    /// Names of the generalised velocities `[nv]`.
    pub fn velocity_names(&self) -> &[String] {
        &self.layout.velocity_names
    }

    /// What a coordinate of 0 is in the model's own coordinates `[nq]`, m and rad.
    pub fn reference(&self) -> &[f32] {
        &self.layout.reference
    }

    /// The coordinates of the rest pose `[nq]`.
    pub fn rest(&self) -> &[f32] {
        &self.layout.rest
    }

    /// The model's bodies, the world first; those without a joint are part of a link.
    pub(crate) fn bodies(&self) -> &[String] {
        &self.blueprint.bodies
    }

    /// The hinges' names and limits (rad), where they have any.
    pub fn hinges(&self) -> impl Iterator<Item = (&str, Option<[f32; 2]>)> {
        self.blueprint.links.iter().filter_map(|link| match &link.joint {
            JointPlan::Hinge(hinge) => Some((hinge.name.as_str(), hinge.range)),
            JointPlan::Planar(_) | JointPlan::Free(_) => None,
        })
    }

    /// The motors' joints, in the order of the model's actuators.
    pub fn actuators(&self) -> impl Iterator<Item = &str> {
        self.blueprint.motors.iter().map(|motor| motor.joint.as_str())
    }

    /// Torque with which the motor of `joint` answers a control, clamped to its range, N m; `None` without a motor.
    pub fn torque(&self, joint: &str, control: f32) -> Option<f32> {
        let motor = self.blueprint.motors.iter().find(|motor| motor.joint == joint)?;
        Some(motor.gear * control.clamp(motor.range[0], motor.range[1]))
    }

    /// Each link's name, mass (kg), and principal inertia about its centre of mass (kg m^2) in ascending order.
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

    /// What a state of this robot may hold in a task whose episodes last `longest` steps.
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
