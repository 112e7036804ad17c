//! MuJoCo's constraints on the engine's multibody: contacts, joint limits and dry friction, solved together.
//!
//! The engine finds the contacts and moves the robot without them. Then the forces of all constraints are computed from
//! the motion at the start of the step, as MuJoCo does, and the step is completed with them. A constraint of a length
//! with position `r` and speed `v`, negative for a violation, has the reference acceleration `a_ref = -b v - k d(r) r`
//! and, at the acceleration `a`, the force `(a_ref - a) / R` with `R = (1 - d(r)) / d(r) A`; `A` is its inverse mass in
//! the rest pose. [`Softness`](crate::robot::Softness) holds `k`, `b` and `d`.
//!
//! No number is kept between steps, so a rebuilt world continues as the uninterrupted one.

mod contacts;
mod couplings;
mod problem;

use rapier3d::dynamics::{Multibody, MultibodyJoint, RigidBodySet};
use rapier3d::math::{Pose, Vector};
use rapier3d::prelude::{PairFilterContext, PhysicsHooks, PhysicsWorld, SolverFlags};

use super::place;
use crate::robot::{
    FreeFriction, HingeMap, Integration, JointMap, Layout, MapKind, Robot, ShapeTag, Softness,
};
use contacts::Touching;
use problem::{Kind, Problem};

/// The constraints of one robot, and the motion at the start of the step.
pub(crate) struct Constraints {
    integration: Integration,
    step_secs: f64,
    touching: Touching,
    start: Start,
    problem: Problem,
    /// `M` plus what the engine integrates implicitly.
    implicit_mass: Vec<f64>,
    /// Change of the accelerations by the constraints.
    change: Vec<f64>,
    /// Sum of the normal impulses in the last step, N s.
    normal_impulse: f64,
}

/// The motion at the start of a step.
#[derive(Default)]
struct Start {
    /// Velocities in the multibody's order.
    speeds: Vec<f64>,
    /// Links in the order of the blueprint.
    links: Vec<LinkStart>,
    /// Positions of the hinges in the model's direction, m or rad.
    hinges: Vec<f64>,
}

/// A link at the start of a step.
struct LinkStart {
    pose: Pose,
    mass_centre: Vector,
    /// Linear and angular velocity of the mass centre for each velocity of the multibody.
    jacobian: Vec<[f64; 6]>,
    joint: MultibodyJoint,
}

impl Constraints {
    /// Constraints of a robot at rest, for physics steps of `step_secs`.
    pub(crate) fn new(robot: &Robot, step_secs: f32) -> Self {
        Self {
            integration: robot.blueprint().integration,
            step_secs: f64::from(step_secs),
            touching: Touching::new(robot),
            start: Start::default(),
            problem: Problem::default(),
            implicit_mass: Vec::new(),
            change: Vec::new(),
            normal_impulse: 0.0,
        }
    }

    /// Sum of the normal impulses in the last step, N s.
    pub(crate) fn normal_impulse(&self) -> f32 {
        self.normal_impulse as f32
    }

    /// Sets the friction of all contacts to this multiple of the model's.
    pub(crate) fn set_friction(&mut self, factor: f32) {
        self.touching.friction = f64::from(factor);
    }

    /// Notes the motion at the start of a step.
    pub(crate) fn observe(
        &mut self,
        layout: &Layout,
        multibody: &Multibody,
        bodies: &RigidBodySet,
    ) {
        let start = &mut self.start;
        start.speeds.clear();
        start.speeds.extend(multibody.generalized_velocity().iter().map(|speed| f64::from(*speed)));
        start.links.truncate(layout.joints.len());
        for (index, map) in layout.joints.iter().enumerate() {
            let link = multibody.link(map.link).expect("the layout is this robot's");
            let pose = *link.local_to_world();
            let mass_centre = pose * bodies[map.body].mass_properties().local_mprops.local_com;
            let columns = multibody.body_jacobian(map.link).column_iter();
            let columns = columns.map(|column| std::array::from_fn(|row| f64::from(column[row])));
            match start.links.get_mut(index) {
                Some(link_start) => {
                    (link_start.pose, link_start.mass_centre) = (pose, mass_centre);
                    link_start.joint = *link.joint();
                    link_start.jacobian.clear();
                    link_start.jacobian.extend(columns);
                }
                None => {
                    let (jacobian, joint) = (columns.collect(), *link.joint());
                    start.links.push(LinkStart { pose, mass_centre, jacobian, joint });
                }
            }
        }
        start.hinges.clear();
        start.hinges.extend(layout.hinges.iter().map(|hinge| {
            let link = multibody.link(hinge.link).expect("the layout is this robot's");
            f64::from(hinge.plan.axis.sign * link.joint().coords()[hinge.axis])
        }));
    }

    /// Completes a step that the engine has made without constraints. Returns whether the motion is finite.
    pub(crate) fn complete(&mut self, robot: &Robot, physics: &mut PhysicsWorld) -> bool {
        let layout = robot.layout();
        self.problem.clear(self.start.speeds.len());
        self.normal_impulse = 0.0;
        let rule = Rule { integration: self.integration, step_secs: self.step_secs };
        for (hinge, position) in layout.hinges.iter().zip(&self.start.hinges) {
            add_limit(&mut self.problem, &self.start.speeds, hinge, *position, rule);
            add_dry_friction(&mut self.problem, &self.start.speeds, hinge, rule);
        }
        couplings::add(&mut self.problem, &self.start, robot, rule);
        if let Some(free) = &layout.free_friction {
            add_free_friction(&mut self.problem, &self.start, free, rule);
        }
        self.touching.add(robot.blueprint(), physics, &self.start, &mut self.problem, rule);
        if !self.problem.has_constraints() {
            return true;
        }
        let multibody = physics.multibody_joints.get_multibody(layout.multibody);
        let multibody = multibody.expect("the template holds the robot");
        self.weigh(layout, multibody, &physics.bodies);
        self.problem.solve();
        self.normal_impulse = self.step_secs * self.touching.normal_force(&self.problem.forces);
        self.problem.push(&mut self.change);
        problem::factorise(&mut self.implicit_mass, self.change.len());
        problem::substitute(&self.implicit_mass, &mut self.change);
        self.apply(layout, physics)
    }

    /// Computes the mass matrix and, from the accelerations without constraints, the forces.
    fn weigh(&mut self, layout: &Layout, multibody: &Multibody, bodies: &RigidBodySet) {
        let size = self.start.speeds.len();
        let mass = &mut self.problem.mass;
        for (link, map) in self.start.links.iter().zip(&layout.joints) {
            let properties = &bodies[map.body].mass_properties().local_mprops;
            if properties.inv_mass > 0.0 {
                let inertia = properties.reconstruct_inertia_matrix();
                let turn = link.pose.rotation;
                let axes = [Vector::X, Vector::Y, Vector::Z];
                let inertia =
                    axes.map(|axis| (turn * (inertia * (turn.inverse() * axis))).to_array());
                add_link(mass, link, f64::from(properties.mass()), inertia);
            }
        }
        for (index, armature) in multibody.armature().iter().enumerate() {
            mass[index * size + index] += f64::from(*armature);
        }
        self.implicit_mass.clear();
        self.implicit_mass.extend_from_slice(mass);
        let implicit = &mut self.implicit_mass;
        for (index, damping) in multibody.damping().iter().enumerate() {
            implicit[index * size + index] += self.step_secs * f64::from(*damping);
        }
        let accelerations = multibody.generalized_acceleration();
        let accelerations = accelerations.iter().map(|number| f64::from(*number));
        self.problem.accelerations.clear();
        self.problem.accelerations.extend(accelerations);
        problem::multiply(implicit, &self.problem.accelerations, &mut self.problem.pull);
        self.change.clear();
        self.change.resize(size, 0.0);
    }

    /// Adds the change to the velocities, and its effect on the positions.
    fn apply(&mut self, layout: &Layout, physics: &mut PhysicsWorld) -> bool {
        let multibody = physics.multibody_joints.get_multibody_mut(layout.multibody);
        let multibody = multibody.expect("the template holds the robot");
        let mut speeds = multibody.generalized_velocity_mut();
        for (speed, change) in speeds.iter_mut().zip(&mut self.change) {
            *change *= self.step_secs;
            *speed += *change as f32;
        }
        if speeds.iter().any(|speed| !speed.is_finite()) {
            return false;
        }
        let step_secs = self.step_secs as f32;
        for (map, start) in layout.joints.iter().zip(&self.start.links) {
            move_joint(multibody, map, start, (&self.change, step_secs));
        }
        multibody.forward_kinematics(&physics.bodies, false);
        place(physics, layout.multibody);
        true
    }
}

/// Moves a joint by the change of its speed. A rotation in space starts again from its start.
fn move_joint(
    multibody: &mut Multibody,
    map: &JointMap,
    start: &LinkStart,
    (change, step_secs): (&[f64], f32),
) {
    let mut moved = [0.0; 6];
    let (count, is_free) = match map.kind {
        MapKind::Fixed => return,
        MapKind::Hinge { .. } => (1, false),
        MapKind::Planar => (3, false),
        MapKind::Free | MapKind::Floating => (6, true),
    };
    for (k, moved) in moved[..count].iter_mut().enumerate() {
        *moved = step_secs
            * if is_free {
                multibody.generalized_velocity()[map.dof + k]
            } else {
                change[map.dof + k] as f32
            };
    }
    let link = multibody.link_mut(map.link).expect("the layout is this robot's");
    if is_free {
        link.joint = start.joint;
    }
    link.joint.apply_displacement(&moved[..count]);
}

/// Adds a link's part to the mass matrix; `inertia` is in the world's axes.
fn add_link(matrix: &mut [f64], link: &LinkStart, mass: f64, inertia: [[f32; 3]; 3]) {
    let size = link.jacobian.len();
    for (index, column) in link.jacobian.iter().enumerate() {
        if *column == [0.0; 6] {
            continue;
        }
        let [vx, vy, vz, wx, wy, wz] = *column;
        let turned =
            inertia.map(|[x, y, z]| f64::from(x) * wx + f64::from(y) * wy + f64::from(z) * wz);
        let momentum = [mass * vx, mass * vy, mass * vz, turned[0], turned[1], turned[2]];
        for (other, number) in link.jacobian.iter().zip(&mut matrix[index * size..][..=index]) {
            *number += momentum.iter().zip(other).fold(0.0, |sum, (a, b)| sum + a * b);
        }
    }
}

/// How a constraint's reference acceleration follows from its motion.
#[derive(Clone, Copy)]
struct Rule {
    integration: Integration,
    step_secs: f64,
}

impl Rule {
    fn aim(&self, softness: &Softness, position: Option<f64>, speed: f64) -> f64 {
        softness.reference_acceleration(self.integration, self.step_secs, position, speed)
    }
}

/// Adds the ends of a hinge's range that it has passed.
fn add_limit(problem: &mut Problem, speeds: &[f64], hinge: &HingeMap, position: f64, rule: Rule) {
    let Some(range) = hinge.plan.range else { return };
    let margin = f64::from(hinge.plan.margin);
    let [low, high] = range.map(f64::from);
    let (low, high) = (low + margin, high - margin);
    for (inward, distance) in [(1.0, position - low), (-1.0, high - position)] {
        if distance >= 0.0 {
            continue;
        }
        let direction = inward * f64::from(hinge.plan.axis.sign);
        problem.add_row()[hinge.dof] = direction;
        let compliance = f64::from(hinge.plan.limit.compliance(-distance as f32));
        let aim = rule.aim(&hinge.plan.limit, Some(distance), direction * speeds[hinge.dof]);
        problem.set_row(aim, compliance * f64::from(hinge.inverse_inertia));
        problem.close(Kind::Push);
    }
}

fn add_dry_friction(problem: &mut Problem, speeds: &[f64], hinge: &HingeMap, rule: Rule) {
    if hinge.plan.friction <= 0.0 {
        return;
    }
    let softness = &hinge.plan.friction_softness;
    problem.add_row()[hinge.dof] = 1.0;
    let compliance = f64::from(softness.compliance(0.0));
    let aim = rule.aim(softness, None, speeds[hinge.dof]);
    problem.set_row(aim, compliance * f64::from(hinge.inverse_inertia));
    problem.close(Kind::Bounded(f64::from(hinge.plan.friction)));
}

/// Adds the dry friction of a free root: along the axes of the world, and about those of the link.
fn add_free_friction(problem: &mut Problem, start: &Start, free: &FreeFriction, rule: Rule) {
    let softness = &free.plan.friction_softness;
    let turn = start.links[free.link].pose.rotation;
    let axes = [Vector::X, Vector::Y, Vector::Z];
    for (first, axes, inverse) in [
        (free.dof, axes, free.inverses[0]),
        (free.dof + 3, axes.map(|axis| turn * axis), free.inverses[1]),
    ] {
        for axis in axes {
            let row = &mut problem.add_row()[first..first + 3];
            row.iter_mut().zip(axis.to_array()).for_each(|(to, part)| *to = f64::from(part));
            let speeds = row.iter().zip(&start.speeds[first..]);
            let speed = speeds.map(|(part, speed)| part * speed).sum();
            let aim = rule.aim(softness, None, speed);
            problem.set_row(aim, f64::from(softness.compliance(0.0)) * inverse);
            problem.close(Kind::Bounded(f64::from(free.plan.friction)));
        }
    }
}

impl PhysicsHooks for Constraints {
    /// The engine finds contacts and does not solve them.
    fn filter_contact_pair(&self, context: &PairFilterContext) -> Option<SolverFlags> {
        let tag = |handle| ShapeTag::of(&context.colliders[handle]);
        let meet = self.touching.meet(tag(context.collider1), tag(context.collider2));
        meet.then(SolverFlags::empty)
    }
}
