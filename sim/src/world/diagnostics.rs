//! Physics diagnostics: energy, centre of mass, lowest point, contact impulse. All but the centre of mass may allocate; do
//! not use them while stepping.

use std::collections::BTreeMap;

use rapier3d::math::Vector;
use rapier3d::parry::shape::SupportMap as _;

use super::{Constraints, Enforcer, World};
use crate::robot::{Blueprint, Convex, GroundForm, LinkPlan};
use crate::scene::Shape;

impl World {
    /// Kinetic energy (with armature) plus potential energy of weight and springs, J. Without control it never rises.
    pub fn mechanical_energy(&self) -> f64 {
        self.kinetic_energy() + self.potential_energy()
    }

    /// Centre of mass in the world of everything that moves, with payloads, m.
    pub fn centre_of_mass(&self) -> [f32; 3] {
        let payloads = self.conditions.iter().flat_map(|conditions| &conditions.payloads);
        let (mut total, mut weighted) = (0.0, Vector::ZERO);
        for (index, (link, centre)) in self.mass_centres().enumerate() {
            if !link.is_base() {
                let added = payloads.clone().find(|(loaded, _)| *loaded == index);
                let mass = link.mass.mass() + added.map_or(0.0, |(_, added)| *added);
                total += mass;
                weighted += centre * mass;
            }
        }
        (weighted / total).to_array()
    }

    /// Height of the robot's lowest point above a floor at z = 0, m; negative for penetration.
    pub fn lowest_point(&self) -> f32 {
        let links = self.robot.blueprint.links.iter().zip(&self.robot.layout.joints);
        let heights = links.flat_map(|(plan, joint)| {
            let frame = self.frame(joint);
            plan.shapes.iter().map(move |shape| {
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
        heights.fold(f32::INFINITY, f32::min)
    }

    /// Largest depth of the robots that have motors in what is fixed and can touch them, m; `None` if nothing is near.
    #[must_use]
    pub fn depth_in_ground(&self) -> Option<f32> {
        let blueprint = &self.robot.blueprint;
        let shapes: Vec<_> = blueprint.shapes().collect();
        let driven = self.robot.driven_trees();
        let link = |index: &usize| shapes.get(*index).map(|own| blueprint.link_of_shape(own));
        let is_fixed =
            |index: &usize| link(index).is_none_or(|link| blueprint.links[link].is_base());
        let is_driven = |index: &usize| {
            link(index).is_some_and(|link| driven.contains(&blueprint.tree_of(link)))
        };
        let are_of_one = |[one, other]: [usize; 2]| {
            let both = shapes.get(one).zip(shapes.get(other));
            both.is_some_and(|(one, other)| blueprint.are_of_one_robot(one, other))
        };
        let counts = |pair: [usize; 2]| {
            pair.iter().any(is_fixed) && pair.iter().any(is_driven) && !are_of_one(pair)
        };
        let counted = self.depths().into_iter().filter(|(pair, _)| counts(*pair));
        counted.map(|(_, depth)| depth).reduce(f32::max)
    }

    /// Depths, m, of shapes that are near and can touch in each other, with the shapes as [`Constraints::depths`] counts them.
    fn depths(&self) -> Vec<([usize; 2], f32)> {
        let mut constraints = Constraints::new(&self.robot, 0.0);
        constraints.depths(&self.robot, self.multibody(), &self.physics)
    }

    /// What links are in that can touch them and is no part of their robot, each with the largest depth, m: the name of a
    /// link's shape, and that of the other shape; `None` for a plane.
    pub(crate) fn overlaps(&self) -> BTreeMap<(&str, Option<&str>), f32> {
        let blueprint = &self.robot.blueprint;
        let shapes: Vec<_> = blueprint.shapes().collect();
        let name = |index: usize| shape_name(blueprint, &shapes[index].name, shapes[index].body);
        let mut overlaps = BTreeMap::new();
        for (pair, depth) in self.depths() {
            let [first, second] = pair;
            let other = match first.checked_sub(shapes.len()).map(|at| &blueprint.grounds[at]) {
                Some(plane) if matches!(plane.form, GroundForm::Plane) => None,
                Some(ground) => Some(shape_name(blueprint, &ground.name, ground.body)),
                None if blueprint.are_of_one_robot(shapes[first], shapes[second]) => continue,
                None => Some(name(first)),
            };
            let deepest = overlaps.entry((name(second), other)).or_insert(depth);
            *deepest = depth.max(*deepest);
        }
        overlaps
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

/// Name of a shape; without one that of its body.
fn shape_name<'a>(blueprint: &'a Blueprint, name: &'a str, body: usize) -> &'a str {
    match body {
        _ if !name.is_empty() => name,
        0 => "a fixed shape",
        body => &blueprint.bodies[body],
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::robot::Robot;

    /// Depth of a driven ball of 0.1 m, whose middle is at this height, beside a box without motors that is in the floor.
    fn depth(grounds: &str, height: f32) -> Option<f32> {
        let model = format!(
            "<mujoco><worldbody>{grounds}<body pos=\"3 0 0.1\"><freejoint/><geom type=\"box\" size=\"0.2 0.2 0.2\"/></body>\
             <body pos=\"0 0 {height}\"><joint name=\"j\" type=\"slide\" axis=\"0 0 1\"/><geom size=\"0.1\"/></body></worldbody>\
             <actuator><motor joint=\"j\" ctrlrange=\"-1 1\"/></actuator></mujoco>"
        );
        let model = |_: &str| Ok(model.as_bytes().to_vec());
        World::new(Arc::new(Robot::of_model("world.xml", model).unwrap())).depth_in_ground()
    }

    #[test]
    fn the_depth_in_the_ground_is_that_of_driven_robots_in_planes_and_solids() {
        let plane = |place: &str| format!("<geom type=\"plane\" size=\"9 9 1\" {place}/>");
        let near = |found: Option<f32>, expected: f32| {
            assert!((found.unwrap() - expected).abs() < 1e-5, "{found:?} against {expected}");
        };
        assert_eq!(depth("", 0.05), None);
        assert!(depth(&plane(""), 5.0).is_none_or(|depth| depth < 0.0));
        near(depth(&plane(""), 0.08), 0.02);
        // At an incline of 60 degrees the middle is half as far from the plane as it is high.
        near(depth(&plane("euler=\"0 60 0\""), 0.1), 0.05);
        near(depth("<geom type=\"box\" size=\"1 1 1\" pos=\"0 0 -1.5\"/>", -0.43), 0.03);
    }
}
