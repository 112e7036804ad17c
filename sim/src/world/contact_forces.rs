//! What the floor does to each of the model's bodies, as the published Ant observes it.

use rapier3d::math::Vector;

use super::World;

/// Numbers for each body: torque, then force.
pub(crate) const PER_BODY: usize = 6;
/// Index of the body that stands still.
pub(crate) const WORLD: usize = 0;
/// Torques (N m) and forces (N) are clipped to this on either side.
pub(crate) const LARGEST: f32 = 1.0;

impl World {
    /// For each of the model's bodies, the world first, torque about the robot's mass centre and force of the
    /// contacts in the last physics step, in the world's axes and clipped: `[bodies, 6]`, N m and N. The world, which the
    /// floor belongs to, feels nothing, as in MuJoCo.
    ///
    /// # Panics
    /// If `out` has another length.
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
        out.iter_mut().for_each(|number| *number = number.clamp(-LARGEST, LARGEST));
    }

    /// Index of the model's body that a collider belongs to; the floor belongs to the world.
    fn body_of(&self, collider: rapier3d::prelude::ColliderHandle) -> usize {
        self.physics.colliders.get(collider).map_or(WORLD, |collider| collider.user_data as usize)
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
