//! Builds a robot's template world in rapier: one multibody, and fixed shapes without a parent body.

use rapier3d::prelude::*;

use super::blueprint::{
    Blueprint, GroundForm, GroundPlan, Hinge, JointPlan, Law, LinkPlan, Motion, ShapePlan,
};
use super::convex::Convex;
use super::layout::Layout;
use crate::scene::Shape;

/// All parts of a world with state. Cloning them resets the world.
#[derive(Clone)]
pub(crate) struct Template {
    pub(crate) islands: IslandManager,
    pub(crate) broad_phase: BroadPhaseBvh,
    pub(crate) narrow_phase: NarrowPhase,
    pub(crate) bodies: RigidBodySet,
    pub(crate) colliders: ColliderSet,
    pub(crate) impulse_joints: ImpulseJointSet,
    pub(crate) multibody_joints: MultibodyJointSet,
}

const GROUND: Group = Group::GROUP_1;
const ROBOT: Group = Group::GROUP_2;

/// Builds the template in its rest pose, and the layout of the robot's coordinates in it.
pub(super) fn assemble(blueprint: &Blueprint) -> Result<(Template, Layout), String> {
    let mut world = empty_world(blueprint, 1);
    let count = blueprint.shapes().count();
    for (index, ground) in (count..).zip(&blueprint.grounds) {
        insert_ground(&mut world, blueprint, ground, index);
    }
    let mut shapes = 0;
    let ground = world.bodies.insert(RigidBodyBuilder::fixed());
    let mut handles: Vec<RigidBodyHandle> = Vec::new();
    let mut frames: Vec<Pose> = Vec::new();
    for link in &blueprint.links {
        let parent_frame = link.parent.map_or(Pose::IDENTITY, |parent| frames[parent]);
        frames.push(parent_frame * link.rest);
        let body = insert_link(&mut world, blueprint, link, (parent_frame * link.rest, shapes));
        shapes += link.shapes.len();
        let parent = link.parent.map_or(ground, |parent| handles[parent]);
        if let Some(joint) = joint(link) {
            let inserted = world.multibody_joints.insert(parent, body, joint, true);
            inserted.ok_or_else(|| format!("{}: rapier rejects the joint", link.name))?;
        }
        handles.push(body);
    }
    weigh(&mut world, handles[0]);
    let mut layout = Layout::new(blueprint, &world, &handles)?;
    set_passive_terms(&mut world, blueprint, &layout);
    if let Law::Engine { .. } = blueprint.law {
        fill_broad_phase(&mut world);
    }
    set_inverse_masses(&world, blueprint, &mut layout);
    Ok((Template::of(world), layout))
}

impl Template {
    fn of(world: PhysicsWorld) -> Self {
        Self {
            islands: world.islands,
            broad_phase: world.broad_phase,
            narrow_phase: world.narrow_phase,
            bodies: world.bodies,
            colliders: world.colliders,
            impulse_joints: world.impulse_joints,
            multibody_joints: world.multibody_joints,
        }
    }

    /// Replaces the content of `world` with a copy of the template.
    pub(crate) fn copy_into(&self, world: &mut PhysicsWorld) {
        world.islands = self.islands.clone();
        world.broad_phase = self.broad_phase.clone();
        world.narrow_phase = self.narrow_phase.clone();
        world.bodies = self.bodies.clone();
        world.colliders = self.colliders.clone();
        world.impulse_joints = self.impulse_joints.clone();
        world.multibody_joints = self.multibody_joints.clone();
    }
}

/// Creates an empty world with the robot's gravity and its physics step split into `parts`.
///
/// [`Law::Constraints`] needs nothing else of the engine's settings, since the engine makes no step. For [`Law::Engine`],
/// [`ContactLaw`](crate::world::ContactLaw) implements the contacts' springs. The engine only enforces their target speeds, with the given compliance: without damping `erp = 1`, and the compliance is
/// `1 / (dt w)^2`. One pass solves contacts and friction, because a second pass without bias would remove the springs'
/// rebound.
pub(crate) fn empty_world(blueprint: &Blueprint, parts: u32) -> PhysicsWorld {
    let mut world = PhysicsWorld { gravity: blueprint.gravity, ..PhysicsWorld::default() };
    let parameters = &mut world.integration_parameters;
    parameters.dt = blueprint.timestep_secs as f32 / parts as f32;
    let Law::Engine { compliance } = blueprint.law else { return world };
    // Balancing the tree would call the platform's logarithm. A dozen shapes do not need it.
    world.broad_phase = BroadPhaseBvh::with_optimization_strategy(BvhOptimizationStrategy::None);
    parameters.num_solver_iterations = 1;
    parameters.num_internal_pgs_iterations = 2;
    parameters.num_internal_stabilization_iterations = 0;
    parameters.max_ccd_substeps = 0;
    parameters.contact_recycling = false;
    // As in MuJoCo, contacts exist only within the margin.
    parameters.normalized_prediction_distance = 1e-4;
    parameters.normalized_max_corrective_velocity = f32::MAX;
    let turn = parameters.dt * compliance.sqrt() * std::f32::consts::TAU;
    parameters.static_contact_softness = SpringCoefficients::new(1.0 / turn, 0.0);
    world
}

/// Inserts a fixed shape without a parent. Attached to the multibody's fixed root, it would be a part of the robot.
fn insert_ground(
    world: &mut PhysicsWorld,
    blueprint: &Blueprint,
    ground: &GroundPlan,
    index: usize,
) {
    let collider = match &ground.form {
        GroundForm::Plane => {
            ColliderBuilder::new(SharedShape::halfspace(Vector::Z)).position(ground.pose)
        }
        // What touches its prisms is found for each of them.
        GroundForm::Field(field) => {
            let (shape, inside) = field.bounding_box();
            ColliderBuilder::new(Convex::shared(&shape, &inside)).position(ground.pose)
        }
        GroundForm::Solid(shape) => ColliderBuilder::new(Convex::shared(shape, &ground.pose))
            .translation(match shape {
                Shape::Sphere { .. } => ground.pose.translation,
                _ => Vector::ZERO,
            }),
    };
    let collider = match blueprint.law {
        Law::Engine { .. } => solved(collider, 0.0, GROUND, ROBOT),
        Law::Constraints => collider.contact_skin(ground.surface.reach(&blueprint.contacts.stated)),
    };
    world.colliders.insert(collider.user_data(index as u128));
}

fn insert_link(
    world: &mut PhysicsWorld,
    blueprint: &Blueprint,
    link: &LinkPlan,
    (frame, first_shape): (Pose, usize),
) -> RigidBodyHandle {
    let body = RigidBodyBuilder::dynamic()
        .pose(frame)
        .can_sleep(false)
        .gravity_scale(link.gravity_scale)
        .additional_mass_properties(link.mass);
    let handle = world.bodies.insert(body);
    for (index, plan) in (first_shape..).zip(&link.shapes) {
        let Some(collider) = touching(blueprint, link, index, plan) else { continue };
        let collider = collider.user_data(index as u128);
        world.colliders.insert_with_parent(collider, handle, &mut world.bodies);
    }
    handle
}

/// Collider of a shape, whose skin is the distance at which its contacts become active; `None` if it touches nothing.
fn touching(
    blueprint: &Blueprint,
    link: &LinkPlan,
    index: usize,
    plan: &ShapePlan,
) -> Option<ColliderBuilder> {
    match blueprint.law {
        Law::Engine { .. } if link.is_base() => None,
        Law::Engine { .. } => {
            let contact = blueprint.floor_contact(plan)?;
            let collider = collider(plan)
                .contact_skin(contact.margin)
                .active_hooks(ActiveHooks::MODIFY_SOLVER_CONTACTS);
            Some(solved(collider, contact.sliding_friction() as f32, ROBOT, GROUND))
        }
        Law::Constraints => {
            let surface = plan.surface.filter(|_| blueprint.touches(link, index, plan))?;
            let own = surface.reach(&blueprint.contacts.stated);
            let pairs = blueprint.contacts.pairs.iter();
            let pairs = pairs.filter(|pair| pair.shapes.contains(&index));
            let margin = pairs.map(|pair| pair.contact.margin).fold(own, f32::max);
            Some(collider(plan).contact_skin(margin))
        }
    }
}

/// Builds a shape without mass. The engine sums mass properties unless they are exactly zero in the link's frame, and
/// diagonalises sums with the platform's mathematical functions. A capsule is therefore defined by its ends in that
/// frame, and the massless centre of a ball is moved to the link's origin. Other shapes are [`Convex`].
fn collider(plan: &ShapePlan) -> ColliderBuilder {
    let collider = ColliderBuilder::new(Convex::shared(&plan.shape, &plan.pose));
    if let Shape::Sphere { .. } = plan.shape {
        let at = plan.pose.translation;
        let nothing = MassProperties { local_com: -at, ..MassProperties::default() };
        return collider.translation(at).mass_properties(nothing);
    }
    collider.mass_properties(MassProperties::default())
}

/// Index of a collider's shape among the shapes of all links, then the fixed ones, in the order of the blueprint.
pub(crate) fn shape_of(collider: &Collider) -> usize {
    collider.user_data as usize
}

/// A collider whose contacts the engine solves.
fn solved(collider: ColliderBuilder, friction: f32, own: Group, other: Group) -> ColliderBuilder {
    collider
        .friction(friction)
        .friction_combine_rule(CoefficientCombineRule::Max)
        .collision_groups(InteractionGroups::new(own, other, InteractionTestMode::And))
}

/// Joint of a link. A free root is the root of the multibody and needs none.
fn joint(link: &LinkPlan) -> Option<GenericJoint> {
    match &link.joint {
        JointPlan::Fixed => {
            let builder = GenericJointBuilder::new(JointAxesMask::all()).local_frame1(link.rest);
            Some(builder.contacts_enabled(false).build())
        }
        JointPlan::Free(_) => None,
        JointPlan::Floating(_) => Some(floating_joint(link.rest.rotation)),
        JointPlan::Planar(_) => {
            let locked = JointAxesMask::LIN_Y | JointAxesMask::ANG_X | JointAxesMask::ANG_Z;
            let builder = GenericJointBuilder::new(locked).local_frame1(link.rest);
            Some(builder.local_frame2(Pose::IDENTITY).contacts_enabled(false).build())
        }
        JointPlan::Hinge(hinge) => Some(hinge_joint(link, hinge)),
        JointPlan::Ball(ball) => Some(ball_joint(link, ball, Rotation::IDENTITY)),
    }
}

/// Joint with all six freedoms to a fixed root, in the orientation `rotation`.
pub(crate) fn floating_joint(rotation: Rotation) -> GenericJoint {
    GenericJointBuilder::new(JointAxesMask::empty())
        .local_frame1(Pose::IDENTITY)
        .local_frame2(Pose::from_rotation(rotation.inverse()))
        .contacts_enabled(false)
        .build()
}

/// Ball joint in this rotation, which is a part of its frame: its velocities then are those about the axes of the link. Its
/// user data has the quaternion, because products of rotations are rounded.
pub(crate) fn ball_joint(link: &LinkPlan, ball: &Hinge, rotation: Rotation) -> GenericJoint {
    let inside = Pose::from_translation(ball.anchor);
    let bits = rotation.to_array().map(|number| u128::from(number.to_bits()));
    GenericJointBuilder::new(JointAxesMask::LIN_AXES)
        .local_frame1(link.rest * inside * Pose::from_rotation(rotation))
        .local_frame2(inside)
        .contacts_enabled(false)
        .user_data(bits.into_iter().fold(0, |data, bits| (data << 32) | bits))
        .build()
}

/// Rotation of a ball joint.
pub(crate) fn ball_rotation(joint: &GenericJoint) -> Rotation {
    let [x, y, z, w] =
        [96, 64, 32, 0].map(|shift| f32::from_bits((joint.user_data >> shift) as u32));
    Rotation::from_xyzw(x, y, z, w)
}

/// Builds a hinge without limits, which [`HingeDrives`](crate::world::HingeDrives) implements as springs.
fn hinge_joint(link: &LinkPlan, hinge: &Hinge) -> GenericJoint {
    let masks = match hinge.motion {
        Motion::Rotation | Motion::Ball => {
            [JointAxesMask::ANG_X, JointAxesMask::ANG_Y, JointAxesMask::ANG_Z]
        }
        Motion::Translation => [JointAxesMask::LIN_X, JointAxesMask::LIN_Y, JointAxesMask::LIN_Z],
    };
    let inside = Pose::from_parts(hinge.anchor, hinge.axis.frame);
    GenericJointBuilder::new(JointAxesMask::all() & !masks[hinge.axis.free])
        .local_frame1(link.rest * inside)
        .local_frame2(inside)
        .contacts_enabled(false)
        .build()
}

/// Computes the bodies' masses and runs the first kinematics. Before it, a multibody also counts the six freedoms of a fixed
/// root, and all rows are off by six.
fn weigh(world: &mut PhysicsWorld, root: RigidBodyHandle) {
    for (_, body) in world.bodies.iter_mut() {
        body.recompute_mass_properties_from_colliders(&world.colliders);
    }
    let index = world.multibody_joints.rigid_body_link(root).map(|link| link.multibody);
    if let Some(robot) = index.and_then(|index| world.multibody_joints.get_multibody_mut(index)) {
        robot.forward_kinematics(&world.bodies, true);
        robot.update_rigid_bodies(&mut world.bodies, true);
    }
}

/// Sets damping and armature after all inserts, because each insert moves the multibody's rows. Other freedoms are set
/// to zero, because rapier's default damping of angular freedoms is 0.1.
fn set_passive_terms(world: &mut PhysicsWorld, blueprint: &Blueprint, layout: &Layout) {
    let Some(robot) = world.multibody_joints.get_multibody_mut(layout.multibody) else { return };
    robot.set_self_contacts_enabled(false);
    robot.damping_mut().fill(0.0);
    robot.armature_mut().fill(0.0);
    for (link, map) in blueprint.links.iter().zip(&layout.joints) {
        match &link.joint {
            JointPlan::Hinge(hinge) => {
                robot.damping_mut()[map.dof] = hinge.damping;
                robot.armature_mut()[map.dof] = hinge.armature;
                if let Law::Engine { .. } = blueprint.law {
                    robot.frictions_mut()[map.dof] = hinge.friction;
                }
            }
            JointPlan::Free(free) | JointPlan::Floating(free) => {
                robot.damping_mut().rows_mut(map.dof, 6).fill(free.damping);
                robot.armature_mut().rows_mut(map.dof, 6).fill(free.armature);
            }
            JointPlan::Ball(ball) => {
                robot.damping_mut().rows_mut(map.dof, 3).fill(ball.damping);
                robot.armature_mut().rows_mut(map.dof, 3).fill(ball.armature);
            }
            JointPlan::Fixed | JointPlan::Planar(_) => {}
        }
    }
}

/// Computes inverse masses and inertias. A copy is used, so that the template does not change.
fn set_inverse_masses(world: &PhysicsWorld, blueprint: &Blueprint, layout: &mut Layout) {
    let robot = world.multibody_joints.get_multibody(layout.multibody);
    let mut robot = robot.expect("the layout was read from this world").clone();
    layout.set_inverse_masses(blueprint, &mut robot, &world.bodies);
}

/// Runs a step of zero duration, which fills the islands and the broad phase. All clones then start from the same
/// state.
fn fill_broad_phase(world: &mut PhysicsWorld) {
    let dt = std::mem::replace(&mut world.integration_parameters.dt, 0.0);
    world.step();
    world.integration_parameters.dt = dt;
}
