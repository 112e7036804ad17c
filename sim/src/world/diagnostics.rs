//! Physics diagnostics: energy, centre of mass, lowest point, contact impulse. All but the centre of mass may allocate; do
//! not use them while stepping.

use rapier3d::math::{Pose, Vector};
use rapier3d::parry::shape::SupportMap as _;

use super::{Enforcer, World};
use crate::robot::{Convex, GroundForm, LinkPlan, ShapePlan};
use crate::scene::Shape;

impl World {
    /// Kinetic energy (with armature) plus potential energy of weight and springs, J. Without control it never rises.
    pub fn mechanical_energy(&self) -> f64 {
        self.kinetic_energy() + self.potential_energy()
    }

    /// Centre of mass of the robot in the world, m.
    pub fn centre_of_mass(&self) -> [f32; 3] {
        let total: f32 = self.robot.masses().map(|(_, mass, _)| mass).sum();
        let weighted = self.mass_centres().map(|(link, centre)| centre * link.mass.mass());
        (weighted.fold(Vector::ZERO, |sum, part| sum + part) / total).to_array()
    }

    /// Height of the robot's lowest point above a floor at z = 0, m; negative for penetration.
    pub fn lowest_point(&self) -> f32 {
        self.lowest(Pose::IDENTITY, |_| true).unwrap_or(f32::INFINITY)
    }

    /// Height above a plane of the lowest point that can touch it, m; negative for penetration. `None` if nothing can
    /// touch a plane.
    pub(crate) fn lowest_contact(&self) -> Option<f32> {
        let grounds = self.robot.blueprint.grounds.iter();
        let planes = grounds.filter(|ground| matches!(ground.form, GroundForm::Plane));
        let heights = planes.filter_map(|plane| {
            self.lowest(plane.pose, |shape| {
                shape.surface.is_some_and(|surface| surface.meets(&plane.surface))
            })
        });
        heights.reduce(f32::min)
    }

    /// Height of the lowest point of some shapes above the plane z = 0 of a frame, m.
    fn lowest(&self, plane: Pose, counts: impl Fn(&ShapePlan) -> bool + Copy) -> Option<f32> {
        let links = self.robot.blueprint.links.iter().zip(&self.robot.layout.joints);
        let heights = links.flat_map(|(plan, joint)| {
            let frame = plane.inverse() * self.frame(joint);
            plan.shapes.iter().filter(move |shape| counts(shape)).map(move |shape| {
                let pose = frame * shape.pose;
                let along = pose.rotation * Vector::Z;
                match shape.shape {
                    Shape::Sphere { radius } => pose.translation.z - radius,
                    Shape::Capsule { half_length, radius } => {
                        pose.translation.z - half_length * along.z.abs() - radius
                    }
                    _ => Convex::new(&shape.shape, &pose)
                        .map_or(f32::INFINITY, |convex| convex.local_support_point(-Vector::Z).z),
                }
            })
        });
        heights.reduce(f32::min)
    }

    /// Torque of the motors of the hinge or slide `joint` for their last controls, N m or N; `None` without a motor, or if the
    /// torque of one also depends on the robot's motion.
    pub fn torque(&self, joint: &str) -> Option<f32> {
        let joint = self.robot.hinges().position(|(name, _)| name == joint)?;
        let motors = self.robot.blueprint.motors.iter().enumerate();
        let torques = motors.filter_map(|(index, motor)| {
            let mut moved = motor.moved.0.iter();
            let (_, factor) = moved.find(|(hinge, _)| *hinge == joint)?;
            Some(motor.torque(self.drives.control(index)).map(|torque| factor * torque))
        });
        torques.reduce(|sum, torque| Some(sum? + torque?)).flatten()
    }

    /// Sum of the normal impulses in the last physics step, N s.
    pub fn contact_impulse(&self) -> f32 {
        if let Enforcer::Constraints(constraints) = &self.enforcer {
            return constraints.normal_impulse();
        }
        let manifolds = self.physics.narrow_phase.contact_pairs().flat_map(|pair| pair.manifolds());
        manifolds.flat_map(|manifold| &manifold.points).map(|point| point.data.impulse).sum()
    }

    fn kinetic_energy(&self) -> f64 {
        let multibody = self.multibody();
        let speeds = multibody.generalized_velocity();
        let armature = multibody.armature().iter().zip(speeds.iter());
        let rotors: f64 = armature.map(|(a, v)| 0.5 * f64::from(a * v * v)).sum();
        let links = self.robot.blueprint.links.iter().zip(&self.robot.layout.joints);
        let links = links.map(|(plan, joint)| {
            let twist = multibody.body_jacobian(joint.link) * speeds;
            let linear = Vector::new(twist[0], twist[1], twist[2]);
            let turn = self.frame(joint).rotation;
            let angular = turn.inverse() * Vector::new(twist[3], twist[4], twist[5]);
            let inertia = plan.mass.reconstruct_inertia_matrix();
            let moved = 0.5 * plan.mass.mass() * linear.length_squared();
            f64::from(moved + 0.5 * angular.dot(inertia * angular))
        });
        rotors + links.sum::<f64>()
    }

    fn potential_energy(&self) -> f64 {
        let gravity = self.robot.blueprint.gravity;
        let weight = self.mass_centres().map(|(link, centre)| {
            f64::from(-link.gravity_scale * link.mass.mass() * gravity.dot(centre))
        });
        let mut coordinates = vec![0.0; self.robot.coordinate_names().len()];
        self.coordinates(&mut coordinates);
        let layout = &self.robot.layout;
        let position = |hinge: usize| layout.hinge_position(hinge, &coordinates);
        let energy = |stiffness: f32, stretch: f32| f64::from(0.5 * stiffness * stretch * stretch);
        let joints = layout.hinges.iter().enumerate().map(|(index, hinge)| {
            energy(hinge.plan.stiffness, position(index) - hinge.plan.spring_rest)
        });
        let tendons = self
            .robot
            .blueprint
            .tendons
            .iter()
            .map(|tendon| energy(tendon.stiffness, tendon.stretch(tendon.moved.sum(position))));
        weight.chain(joints).chain(tendons).sum()
    }

    fn mass_centres(&self) -> impl Iterator<Item = (&LinkPlan, Vector)> {
        let links = self.robot.blueprint.links.iter().zip(&self.robot.layout.joints);
        links.map(|(plan, joint)| (plan, self.frame(joint) * plan.mass.local_com))
    }
}
