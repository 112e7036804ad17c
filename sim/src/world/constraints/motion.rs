//! The motion of a robot's links at the start of a step, its mass matrix, and the forces without constraints.

use rapier3d::dynamics::{Multibody, MultibodyJoint, RigidBodySet};
use rapier3d::glamx::{DMat3, DVec3};
use rapier3d::math::{Pose, Vector};
use rapier3d::prelude::PhysicsWorld;

use super::super::{floating_at, floating_pose};
use super::problem::ConstraintProblem;
use crate::robot::{
    Fluid, JointMap, JointPlan, LinkPlan, MapKind, Robot, Thrust, ball_joint, ball_rotation, turned,
};

/// Levers up to this are rounding, m. Without compliance, even such a lever would turn a link.
const LEAST_LEVER: f64 = 1e-6;

/// The motion at the start of a step. Velocities have the order of the multibody.
#[derive(Default)]
pub(super) struct Motion {
    pub(super) speeds: Vec<f64>,
    /// Links in the order of the blueprint.
    pub(super) links: Vec<LinkMotion>,
    /// Positions of the hinges in the model's direction, m or rad.
    pub(super) hinges: Vec<f64>,
    /// For each velocity, the linear velocity at the tree's origin and the angular velocity that it gives a link and its children.
    twists: Vec<[DVec3; 2]>,
}

/// A link at the start of a step, in the axes of the world.
pub(super) struct LinkMotion {
    /// The velocities that move the link: those of its ancestors, then its own.
    dofs: Vec<usize>,
    /// Number of its own.
    own: usize,
    /// Its parent, if that moves.
    parent: Option<usize>,
    /// The origin of its tree: the frame of the first link. A distant one of another tree would round what happens here.
    origin: DVec3,
    pub(super) pose: Pose,
    pub(super) mass_centre: DVec3,
    pub(super) joint: MultibodyJoint,
    /// kg and kg m^2; 0 for links without a mass.
    mass: f64,
    /// Mass on which gravity acts, kg.
    weight: f64,
    inertia: DMat3,
    /// Force on the mass centre, N, and torque, N m, from outside.
    pull: [DVec3; 2],
    /// The same of actuators on sites, a part of `pull`.
    thrust: [DVec3; 2],
    /// Velocity of the mass centre, m/s, and angular velocity, rad/s.
    pub(super) velocity: [DVec3; 2],
    /// Their rates while all velocities of the joints are constant, m/s^2 and rad/s^2.
    pub(super) rates: [DVec3; 2],
    /// The link with all links that hang on it.
    branch: Branch,
}

/// Links that move as one.
#[derive(Clone, Copy)]
pub(super) struct Branch {
    /// kg.
    mass: f64,
    /// Mass times the position of the mass centre from the origin, kg m.
    pub(super) moment: DVec3,
    /// Inertia about the origin, kg m^2.
    pub(super) inertia: DMat3,
    /// Force, N, and torque about the origin, N m, on the links, less what their motion at constant velocities needs.
    pull: [DVec3; 2],
}

impl Motion {
    /// Reads the motion from the multibody, and the forces on sites.
    pub(super) fn read(
        &mut self,
        robot: &Robot,
        multibody: &Multibody,
        physics: &PhysicsWorld,
        thrusts: impl Iterator<Item = (Thrust, f32)>,
    ) {
        let (blueprint, layout) = (&robot.blueprint, &robot.layout);
        if self.links.is_empty() {
            self.links = links_of(robot, multibody);
        }
        self.speeds.clear();
        self.speeds.extend(multibody.generalized_velocity().iter().map(|speed| f64::from(*speed)));
        self.twists.clear();
        self.twists.resize(self.speeds.len(), [DVec3::ZERO; 2]);
        for (index, (plan, map)) in blueprint.links.iter().zip(&layout.joints).enumerate() {
            let (before, rest) = self.links.split_at_mut(index);
            let link = &mut rest[0];
            let parent = link.parent.map(|parent| &before[parent]);
            link.read(map, multibody, &physics.bodies);
            link.pull[0] += link.weight * physics.gravity.as_dvec3();
            link.origin = parent.map_or(link.pose.translation.as_dvec3(), |parent| parent.origin);
            let arm = link.mass_centre - link.origin;
            let jacobian = multibody.body_jacobian(map.link);
            let mut twist = parent.map_or([DVec3::ZERO; 2], |parent| {
                let [velocity, spin] = parent.velocity;
                [velocity - spin.cross(parent.mass_centre - parent.origin), spin]
            });
            for dof in &link.dofs[link.dofs.len() - link.own..] {
                let column = jacobian.column(*dof);
                let [moved, turned] =
                    [0, 3].map(|k| Vector::new(column[k], column[k + 1], column[k + 2]).as_dvec3());
                let own = [moved - turned.cross(arm), turned];
                self.twists[*dof] = own;
                twist = [0, 1].map(|k| twist[k] + own[k] * self.speeds[*dof]);
            }
            link.velocity = [twist[0] + twist[1].cross(arm), twist[1]];
            link.rates = rates(plan, link, parent);
        }
        if let Some(fluid) = &blueprint.fluid {
            self.flow(fluid);
        }
        thrusts.for_each(|(thrust, size)| self.push(&thrust, f64::from(size)));
        self.gather();
        self.hinges.clear();
        self.hinges.extend(layout.hinges.iter().map(|hinge| {
            let link = multibody.link(hinge.link).expect("the layout is this robot's");
            f64::from(hinge.position(link.joint()))
        }));
    }

    /// Whether two velocities move a link together.
    pub(super) fn share_link(&self, one: usize, other: usize) -> bool {
        self.links.iter().any(|link| link.dofs.contains(&one) && link.dofs.contains(&other))
    }

    /// Computes the branches.
    fn gather(&mut self) {
        for link in &mut self.links {
            link.branch = link.alone(link.mass_centre - link.origin);
        }
        for index in (0..self.links.len()).rev() {
            if let Some(parent) = self.links[index].parent {
                let branch = self.links[index].branch;
                self.links[parent].branch.add(&branch);
            }
        }
    }

    /// Adds the forces of a fluid.
    fn flow(&mut self, fluid: &Fluid) {
        let wind = DVec3::from_array(fluid.wind);
        for body in &fluid.boxes {
            let link = &mut self.links[body.link];
            let pose = link.pose * body.pose;
            let axes = pose.rotation.as_dquat();
            let arm = pose.translation.as_dvec3() - link.mass_centre;
            let [speed, spin] = link.velocity;
            let inside = [speed + spin.cross(arm) - wind, spin]
                .map(|velocity| (axes.inverse() * velocity).to_array());
            let [force, torque] =
                fluid.wrench(body.sizes, inside).map(|part| axes * DVec3::from_array(part));
            link.push(arm, [force, torque]);
        }
    }

    /// Adds the force of an actuator on a site.
    fn push(&mut self, thrust: &Thrust, size: f64) {
        let link = &mut self.links[thrust.link];
        let turn = link.pose.rotation.as_dquat();
        let [force, torque] = [thrust.force, thrust.torque].map(|part| turn * (size * part));
        let arm = (link.pose * thrust.point).as_dvec3() - link.mass_centre;
        link.push(arm, [force, torque]);
        link.thrust = [link.thrust[0] + force, link.thrust[1] + torque + arm.cross(force)];
    }

    /// Writes the mass matrix with armature, and the forces of gravity, of the rotation of the links and from outside.
    pub(super) fn write(&self, multibody: &Multibody, problem: &mut ConstraintProblem) {
        let size = self.speeds.len();
        for link in &self.links {
            for (count, dof) in link.dofs.iter().enumerate().skip(link.dofs.len() - link.own) {
                let twist = self.twists[*dof];
                problem.pull[*dof] += product(twist, link.branch.pull);
                let momentum = link.branch.momentum(twist);
                let line = &mut problem.mass[dof * size..][..=*dof];
                for other in &link.dofs[..=count] {
                    line[*other] = product(self.twists[*other], momentum);
                }
            }
        }
        for (index, armature) in multibody.armature().iter().enumerate() {
            problem.mass[index * size + index] += f64::from(*armature);
        }
    }

    /// Force on a velocity of actuators on sites and of the compensation of this gravity by links, N or N m.
    pub(super) fn actuation(&self, dof: usize, gravity: DVec3) -> f64 {
        let moved = self.links.iter().filter(|link| link.dofs.contains(&dof));
        let wrenches = moved.map(|link| {
            let [thrust, torque] = link.thrust;
            let force = thrust + (link.weight - link.mass) * gravity;
            [force, torque + (link.mass_centre - link.origin).cross(force)]
        });
        wrenches.fold(0.0, |sum, wrench| sum + product(self.twists[dof], wrench))
    }

    /// Adds to a row of a Jacobian `factor` times what a force at a point of a link and a torque do: their work for each unit
    /// of velocity.
    pub(super) fn add_levers(
        &self,
        row: &mut [f64],
        (link, point): (&LinkMotion, DVec3),
        [force, torque]: [DVec3; 2],
        factor: f64,
    ) {
        let wrench = [force, torque + (point - link.origin).cross(force)];
        for dof in &link.dofs {
            let twist = self.twists[*dof];
            let lever = product(twist, wrench);
            if lever * lever > LEAST_LEVER * LEAST_LEVER * twist[1].length_squared() {
                row[*dof] += factor * lever;
            }
        }
    }
}

/// Memory for the links of a robot.
fn links_of(robot: &Robot, multibody: &Multibody) -> Vec<LinkMotion> {
    let mut links: Vec<LinkMotion> = Vec::new();
    let plans = &robot.blueprint.links;
    for (plan, map) in plans.iter().zip(&robot.layout.joints) {
        let link = multibody.link(map.link).expect("the layout is this robot's");
        let own = link.joint().ndofs();
        let parent = plan.parent.filter(|parent| !plans[*parent].is_base());
        let mut dofs = parent.map_or(Vec::new(), |parent| links[parent].dofs.clone());
        dofs.extend(map.dof..map.dof + own);
        links.push(LinkMotion::new(*link.joint(), dofs, own, parent));
    }
    links
}

impl LinkMotion {
    fn new(joint: MultibodyJoint, dofs: Vec<usize>, own: usize, parent: Option<usize>) -> Self {
        Self {
            dofs,
            own,
            parent,
            origin: DVec3::ZERO,
            pose: Pose::IDENTITY,
            mass_centre: DVec3::ZERO,
            joint,
            mass: 0.0,
            weight: 0.0,
            inertia: DMat3::ZERO,
            pull: [DVec3::ZERO; 2],
            thrust: [DVec3::ZERO; 2],
            velocity: [DVec3::ZERO; 2],
            rates: [DVec3::ZERO; 2],
            branch: Branch::NOTHING,
        }
    }

    /// Reads what does not depend on the velocities.
    fn read(&mut self, map: &JointMap, multibody: &Multibody, bodies: &RigidBodySet) {
        let link = multibody.link(map.link).expect("the layout is this robot's");
        let body = &bodies[map.body];
        let properties = &body.mass_properties().local_mprops;
        self.pose = *link.local_to_world();
        self.joint = *link.joint();
        let turn = DMat3::from_quat(self.pose.rotation.as_dquat());
        let axes = properties.reconstruct_inertia_matrix().to_cols_array().map(f64::from);
        let is_massive = properties.inv_mass > 0.0;
        self.mass_centre = (self.pose * properties.local_com).as_dvec3();
        self.mass = if is_massive { f64::from(properties.mass()) } else { 0.0 };
        self.weight = self.mass * f64::from(body.gravity_scale());
        self.inertia = turn * DMat3::from_cols_array(&axes) * turn.transpose();
        self.pull = [body.user_force().as_dvec3(), body.user_torque().as_dvec3()];
        self.thrust = [DVec3::ZERO; 2];
    }

    /// Adds a force, N, at `arm` from the mass centre, and a torque, N m.
    fn push(&mut self, arm: DVec3, [force, torque]: [DVec3; 2]) {
        self.pull[0] += force;
        self.pull[1] += torque + arm.cross(force);
    }

    /// The link with all links that hang on it.
    pub(super) fn branch(&self) -> &Branch {
        &self.branch
    }

    /// Acceleration of one of its points while all velocities of the joints are constant, m/s^2.
    pub(super) fn acceleration(&self, point: DVec3) -> DVec3 {
        let (arm, [_, spin], [moving, turning]) =
            (point - self.mass_centre, self.velocity, self.rates);
        moving + turning.cross(arm) + spin.cross(spin.cross(arm))
    }

    /// The link without others, with its mass centre at `arm` from the origin.
    fn alone(&self, arm: DVec3) -> Branch {
        if self.mass <= 0.0 {
            let [force, torque] = self.pull;
            return Branch { pull: [force, torque + arm.cross(force)], ..Branch::NOTHING };
        }
        let [acceleration, turning] = self.rates;
        let spin = self.velocity[1];
        let force = self.pull[0] - self.mass * acceleration;
        let torque = self.pull[1] - self.inertia * turning - spin.cross(self.inertia * spin);
        let outer = DMat3::from_cols(arm * arm.x, arm * arm.y, arm * arm.z);
        let square = DMat3::from_diagonal(DVec3::splat(arm.length_squared()));
        Branch {
            mass: self.mass,
            moment: self.mass * arm,
            inertia: self.inertia + (square - outer) * self.mass,
            pull: [force, torque + arm.cross(force)],
        }
    }
}

impl Branch {
    const NOTHING: Self =
        Self { mass: 0.0, moment: DVec3::ZERO, inertia: DMat3::ZERO, pull: [DVec3::ZERO; 2] };

    fn add(&mut self, other: &Self) {
        self.mass += other.mass;
        self.moment += other.moment;
        self.inertia += other.inertia;
        self.pull = [0, 1].map(|k| self.pull[k] + other.pull[k]);
    }

    /// Momentum and angular momentum about the origin.
    fn momentum(&self, [moved, turned]: [DVec3; 2]) -> [DVec3; 2] {
        [
            self.mass * moved + turned.cross(self.moment),
            self.inertia * turned + self.moment.cross(moved),
        ]
    }
}

/// Power of a force and torque at the velocity and angular velocity of the same point.
fn product(twist: [DVec3; 2], wrench: [DVec3; 2]) -> f64 {
    twist[0].dot(wrench[0]) + twist[1].dot(wrench[1])
}

/// Rates of a link's velocity and angular velocity while all velocities of the joints are constant.
fn rates(plan: &LinkPlan, link: &LinkMotion, parent: Option<&LinkMotion>) -> [DVec3; 2] {
    let spin = link.velocity[1];
    let around = |spin: DVec3, arm: DVec3| spin.cross(spin.cross(arm));
    let hinge = match &plan.joint {
        JointPlan::Fixed => return [DVec3::ZERO; 2],
        // A ball joint turns about its anchor as a hinge does: its speeds are about the axes of the link.
        JointPlan::Hinge(hinge) | JointPlan::Ball(hinge) => hinge,
        // The velocities are those of the link's origin.
        JointPlan::Planar(_) | JointPlan::Free(_) | JointPlan::Floating(_) => {
            let arm = link.mass_centre - link.pose.translation.as_dvec3();
            return [around(spin, arm), DVec3::ZERO];
        }
    };
    let still = [DVec3::ZERO; 2];
    let [base, base_turning] = parent.map_or(still, |parent| parent.rates);
    let [base_speed, base_spin] = parent.map_or(still, |parent| parent.velocity);
    let base_centre = parent.map_or(DVec3::ZERO, |parent| parent.mass_centre);
    let on_base = |point: DVec3| {
        let arm = point - base_centre;
        base + base_turning.cross(arm) + around(base_spin, arm)
    };
    let turning = base_turning + base_spin.cross(spin - base_spin);
    if hinge.is_slide() {
        let moved = base_speed + base_spin.cross(link.mass_centre - base_centre);
        let sliding = link.velocity[0] - moved;
        return [on_base(link.mass_centre) + 2.0 * base_spin.cross(sliding), turning];
    }
    let anchor = (link.pose * hinge.anchor).as_dvec3();
    let arm = link.mass_centre - anchor;
    [on_base(anchor) + turning.cross(arm) + around(spin, arm), turning]
}

/// Moves a joint from its start with the velocities of the multibody.
pub(super) fn move_joint(
    multibody: &mut Multibody,
    (map, plan): (&JointMap, &LinkPlan),
    start: &LinkMotion,
    step_secs: f32,
) {
    let (count, _) = map.kind.speeds();
    if count == 0 {
        return;
    }
    let mut moved = [0.0; 6];
    let speeds = multibody.generalized_velocity();
    for (moved, speed) in moved[..count].iter_mut().zip(speeds.iter().skip(map.dof)) {
        *moved = step_secs * speed;
    }
    let link = multibody.link_mut(map.link).expect("the layout is this robot's");
    if let JointPlan::Ball(ball) = &plan.joint {
        let rotation = turned(ball_rotation(&start.joint.data), [moved[0], moved[1], moved[2]]);
        link.joint = MultibodyJoint::new(ball_joint(plan, ball, rotation), false);
        return;
    }
    link.joint = start.joint;
    link.joint.apply_displacement(&moved[..count]);
    if map.kind == MapKind::Floating {
        // The joint of a rebuilt world has its orientation elsewhere, and would round differently.
        let (position, rotation) = floating_pose(&link.joint);
        link.joint = floating_at(position, rotation);
    }
}
