//! MuJoCo's contact law on rapier's solver, for [`Law::Engine`](crate::robot::Law): target normal speed and friction of
//! each contact in the next step. [`Constraints`](super::Constraints) is exact, and has no bounds on the compliance.
//!
//! MuJoCo's friction pyramid is four soft constraints `n + mu t` along the axes of the contact's frame, each with the
//! spring of [`Softness`] and the compliance `2 mu^2 R`. It differs from a rigid contact in three ways:
//! - It is compliant: along the normal by `mu^2 R / 2`, along the floor by `R`. A loaded foot creeps.
//! - Friction is `mu` along the frame's axes and `mu / sqrt 2` between them; one axis follows the capsule.
//! - Sliding causes lift. The edge against the slide constrains `v_n - mu v_t`, so a faster slide gives a faster rise.
//!
//! rapier solves for one target speed along the normal and one friction coefficient per contact. Both are set here from
//! the contact's motion and its impulse in the last step.

use rapier3d::dynamics::Multibody;
use rapier3d::math::Vector;
use rapier3d::prelude::{ContactModificationContext, PhysicsHooks, RigidBodyHandle, SolverContact};

use crate::robot::{Layout, Robot, Softness, Spring, shape_of};

/// Largest compliance along the normal that is computed from the last impulse, in units of the inverse mass. With 1,
/// the contact would oscillate.
const LARGEST_LAGGING: f32 = 0.5;
/// Below this speed, a contact has no sliding direction, m/s.
const SLOWEST_SLIDE: f32 = 1e-4;
/// Prevents a division by zero, m/s.
const TINY: f32 = 1e-9;

/// The contact law for one step length, and the links' motion at the start of the step.
pub(crate) struct ContactLaw {
    /// Softness of the contacts of each shape, in the order of the blueprint's shapes; `None` without contacts.
    shapes: Vec<Option<(Softness, Spring)>>,
    step_secs: f32,
    /// Compliance of the engine's solver, in units of the inverse mass.
    solved_compliance: f32,
    motions: Vec<LinkMotion>,
}

/// Motion of a link in the world.
#[derive(Clone, Copy, Debug)]
struct LinkMotion {
    body: RigidBodyHandle,
    /// Position, m.
    mass_centre: Vector,
    /// Velocity of the mass centre, m/s.
    linear: Vector,
    /// Angular velocity, rad/s.
    angular: Vector,
    /// 1/kg.
    inverse_mass: f32,
}

/// Motion of a contact point relative to the floor.
struct Touch {
    /// Speed upwards, m/s.
    rise: f32,
    /// Speed along the floor, m/s.
    slide: f32,
    /// Friction in the direction of the slide as a fraction of `mu`: 1 along a frame axis, `1 / sqrt 2` between axes.
    share: f32,
}

impl ContactLaw {
    /// Creates the contact law of a robot for physics steps of `step_secs` and an engine with this compliance.
    pub(crate) fn new(robot: &Robot, compliance: f32, step_secs: f32) -> Self {
        let blueprint = &robot.blueprint;
        let law =
            |softness: Softness| (softness, softness.spring(blueprint.integration, step_secs));
        Self {
            shapes: blueprint
                .shapes()
                .map(|shape| Some(law(blueprint.floor_contact(shape)?.softness)))
                .collect(),
            step_secs,
            solved_compliance: compliance,
            motions: Vec::with_capacity(robot.layout.joints.len()),
        }
    }

    /// Reads the links' motion from the joints, because the rigid bodies' velocities are one step old.
    pub(crate) fn observe(&mut self, robot: &Robot, multibody: &Multibody) {
        let Layout { joints, inverse_masses, .. } = &robot.layout;
        let speeds = multibody.generalized_velocity();
        self.motions.clear();
        for ((plan, joint), inverse_mass) in
            robot.blueprint.links.iter().zip(joints).zip(inverse_masses)
        {
            let twist = multibody.body_jacobian(joint.link) * speeds;
            let link = multibody.link(joint.link).expect("the layout is this robot's");
            self.motions.push(LinkMotion {
                body: joint.body,
                mass_centre: *link.local_to_world() * plan.mass.local_com,
                linear: Vector::new(twist[0], twist[1], twist[2]),
                angular: Vector::new(twist[3], twist[4], twist[5]),
                inverse_mass: *inverse_mass,
            });
        }
    }

    /// Sets the contact's distance, from which the engine computes its target speed `-distance / dt`. Returns the
    /// friction coefficient.
    fn set_target(&self, contact: &mut SolverContact, touch: &Touch, mass: f32, held: Held) -> f32 {
        let Held { mu, impulse, law: (softness, spring) } = held;
        let compliance = softness.compliance(-contact.dist) * (1.0 + mu * mu);
        if mu == 0.0 {
            let give = (compliance - self.solved_compliance).clamp(0.0, LARGEST_LAGGING);
            let speed = spring.next_speed(touch.rise, contact.dist) - give * mass * impulse;
            contact.dist = -speed * self.step_secs;
            return 0.0;
        }
        let give =
            (0.5 * mu * mu * compliance - self.solved_compliance).clamp(0.0, LARGEST_LAGGING);
        let pressed = spring.next_speed(touch.rise, contact.dist) - give * mass * impulse;
        // Number of pyramid edges against the slide: one along an axis, two between axes.
        let edges = 1.0 / (touch.share * touch.share);
        let edge = touch.rise - mu * touch.share * touch.slide;
        let shift = spring.next_speed(edge, contact.dist) - edge;
        let lifted = touch.rise + shift * edges / (edges + mu * mu * (1.0 + 2.0 * compliance));
        contact.dist = -pressed.max(lifted) * self.step_secs;
        let creep = spring.damping() * touch.slide / (compliance * mass * impulse + TINY);
        creep.min(mu * touch.share)
    }
}

/// State of a contact before the step.
#[derive(Clone, Copy)]
struct Held {
    /// Friction coefficient.
    mu: f32,
    /// Impulse along the normal in the last step, N s.
    impulse: f32,
    law: (Softness, Spring),
}

impl PhysicsHooks for ContactLaw {
    fn modify_solver_contacts(&self, context: &mut ContactModificationContext) {
        let robot_first = context.rigid_body1.is_some();
        let (body, collider) = if robot_first {
            (context.rigid_body1, context.collider1)
        } else {
            (context.rigid_body2, context.collider2)
        };
        let collider = &context.colliders[collider];
        let law = self.shapes.get(shape_of(collider)).copied().flatten();
        let capsule = collider.shape().as_capsule();
        let along = capsule.map_or(Vector::ZERO, |capsule| {
            collider.rotation() * (capsule.segment.b - capsule.segment.a)
        });
        let motion = self.motions.iter().find(|motion| Some(motion.body) == body);
        let (Some(motion), Some(law)) = (motion, law) else { return };
        let Some(pair) = context.rigid_mut() else { return };
        let up = if robot_first { -*pair.normal } else { *pair.normal };
        let mut friction = *pair.friction;
        for contact in pair.solver_contacts.iter_mut().filter(|contact| contact.dist < 0.0) {
            let touch = motion.touch(contact.anchor1, up, along);
            let point = (contact.contact_id[0] & !rapier3d::geometry::NEW_CONTACT_BIT) as usize;
            let impulse = pair.manifold.points[point].data.impulse;
            let held = Held { mu: *pair.friction, impulse, law };
            friction = friction.min(self.set_target(contact, &touch, motion.inverse_mass, held));
        }
        *pair.friction = friction;
    }
}

impl LinkMotion {
    /// Motion of a point of the link on a floor with normal `up`; `along` is the capsule's axis.
    fn touch(&self, point_in_world: Vector, up: Vector, along: Vector) -> Touch {
        let velocity = self.linear + self.angular.cross(point_in_world - self.mass_centre);
        let rise = velocity.dot(up);
        let sliding = velocity - up * rise;
        let slide = sliding.length();
        let axis = along - up * along.dot(up);
        let length = axis.length();
        let share = if slide < SLOWEST_SLIDE || length < SLOWEST_SLIDE {
            1.0
        } else {
            let cos = sliding.dot(axis).abs() / (slide * length);
            let sin = (1.0 - cos * cos).max(0.0).sqrt();
            1.0 / (cos + sin)
        };
        Touch { rise, slide, share }
    }
}
