//! Contact forces of the floor on each of the model's bodies, as the published Ant observes them.

use rapier3d::math::Vector;

use super::World;
use crate::robot::ShapeTag;
use crate::state::LARGEST_CONTACT_FORCE;

/// Values per body: torque, then force.
pub(crate) const PER_BODY: usize = 6;
/// Index of the static body.
pub(crate) const WORLD: usize = 0;

impl World {
    /// Writes the contact torque about the robot's centre of mass and the contact force on each of the model's bodies
    /// in the last physics step, in world axes and clipped: `[bodies, 6]`, N m and N. The world is the first body; its
    /// values are zero, as in MuJoCo.
    ///
    /// # Panics
    /// If `out` has a wrong length.
    pub(crate) fn contact_forces(&self, out: &mut [f32]) {
        assert_eq!(out.len(), PER_BODY * self.robot.blueprint().bodies.len(), "contact forces");
        out.fill(0.0);
        let centre = Vector::from(self.centre_of_mass());
        let per_sec = 1.0 / self.physics.integration_parameters.dt;
        for pair in self.physics.narrow_phase.contact_pairs() {
            let bodies = [pair.collider1, pair.collider2].map(|handle| self.body_of(handle));
            for manifold in pair.manifolds() {
                let frame = self.physics.colliders.get(pair.collider1).map(|c| *c.position());
                for point in &manifold.points {
                    let push = point.data.warmstart_tangent_world
                        - manifold.data.normal * point.data.impulse;
                    let arm = frame.map_or(centre, |frame| frame * point.local_p1) - centre;
                    add(out, bodies[0], arm, push * per_sec);
                    add(out, bodies[1], arm, -push * per_sec);
                }
            }
        }
        out.iter_mut().for_each(|number| {
            *number = number.clamp(-LARGEST_CONTACT_FORCE, LARGEST_CONTACT_FORCE)
        });
    }

    /// Index of a collider's body in the model; the floor belongs to the world.
    fn body_of(&self, collider: rapier3d::prelude::ColliderHandle) -> usize {
        self.physics.colliders.get(collider).map_or(WORLD, |collider| ShapeTag::of(collider).body)
    }
}

fn add(out: &mut [f32], body: usize, arm: Vector, force: Vector) {
    if body == WORLD {
        return;
    }
    let (torque, force) = (arm.cross(force).to_array(), force.to_array());
    for (sum, number) in
        out[PER_BODY * body..][..PER_BODY].iter_mut().zip(torque.into_iter().chain(force))
    {
        *sum += number;
    }
}
