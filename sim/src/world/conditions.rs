//! Physical parameters of an episode that differ from those of the model, and forces from outside.

use rapier3d::math::Vector;

use super::{Enforcer, World};
use crate::robot::shape_of;

/// Physical parameters of an episode, relative to the model's. The softness of contacts and limits, which depends on the
/// masses of the rest pose, stays that of the model.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct EpisodeConditions {
    /// Factor of the friction of all contacts.
    pub(crate) friction: f32,
    /// Gravity instead of the model's, m/s^2.
    pub(crate) gravity: Option<Vector>,
    /// Indices of fixed shapes of the blueprint and what is added to their heights, m.
    pub(crate) rises: Vec<(usize, f32)>,
    /// Links and the masses added at their mass centres, kg.
    pub(crate) payloads: Vec<(usize, f32)>,
    /// Factor of the torque of each motor, in the order of the blueprint, `[A]`.
    pub(crate) motor_strengths: Vec<f32>,
    /// Factor of the damping of each hinge, in the order of the layout.
    pub(crate) joint_dampings: Vec<f32>,
}

impl World {
    /// Sets the conditions from the next rebuild on.
    pub(crate) fn set_conditions(&mut self, conditions: EpisodeConditions) {
        self.conditions = Some(conditions);
    }

    /// Sets the forces on the mass centres of these links, N, until the next call or rebuild. A body whose force stays the
    /// same is not touched: after access to a body the engine's results differ in their last bits.
    pub(crate) fn push(&mut self, forces: &[(usize, Vector)]) {
        for (link, force) in forces {
            let handle = self.robot.layout.joints[*link].body;
            if self.physics.bodies[handle].user_force() != *force {
                let body = &mut self.physics.bodies[handle];
                body.reset_forces(true);
                body.add_force(*force, true);
            }
        }
    }

    /// Changes the copy of the template. The engine sums masses of bodies and colliders; those of colliders are 0.
    pub(super) fn apply_conditions(&mut self) {
        let Some(conditions) = &self.conditions else { return };
        self.physics.gravity = conditions.gravity.unwrap_or(self.robot.blueprint.gravity);
        let moving = self.robot.blueprint.shapes().count();
        for (_, collider) in self.physics.colliders.iter_mut() {
            let fixed = shape_of(collider).checked_sub(moving);
            let rise = conditions.rises.iter().find(|(ground, _)| Some(*ground) == fixed);
            if let Some((_, rise)) = rise {
                collider.set_translation(collider.translation() + Vector::Z * *rise);
            }
        }
        match &mut self.enforcer {
            Enforcer::Constraints(constraints) => constraints.set_friction(conditions.friction),
            Enforcer::Engine(_) => {
                for (_, collider) in self.physics.colliders.iter_mut() {
                    collider.set_friction(collider.friction() * conditions.friction);
                }
            }
        }
        for (link, added) in conditions.payloads.iter().filter(|(_, added)| *added > 0.0) {
            let mut mass = self.robot.blueprint.links[*link].mass;
            mass.inv_mass = 1.0 / (mass.mass() + added);
            let body = &mut self.physics.bodies[self.robot.layout.joints[*link].body];
            body.set_additional_mass_properties(mass, true);
            body.recompute_mass_properties_from_colliders(&self.physics.colliders);
        }
        self.drives.vary(&self.robot, &conditions.motor_strengths, &conditions.joint_dampings);
    }
}
