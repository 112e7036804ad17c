//! The rows of a contact: MuJoCo's friction pyramids and cones.

use rapier3d::glamx::DVec3;

use super::matrix::dot;
use super::motion::{LinkMotion, Motion};
use super::problem::{ConstraintProblem, Kind};
use crate::robot::{Blueprint, Cone, ContactPlan};

/// A contact of two shapes in the world.
pub(super) struct Contact<'a> {
    pub(super) plan: ContactPlan,
    /// Links of the shapes.
    pub(super) links: [Option<&'a LinkMotion>; 2],
    /// Sum of the inverse masses and inertias of both bodies.
    pub(super) inverse: [f64; 2],
    /// Middle between the surfaces, m.
    pub(super) point: DVec3,
    /// Normal, from the first shape to the second, and two tangents.
    pub(super) axes: [DVec3; 3],
    /// Distance less the margin, m.
    pub(super) position: f64,
}

impl Contact<'_> {
    /// Adds the contact. Returns its first row and the number of rows whose forces add up to the normal force.
    pub(super) fn add(
        &self,
        blueprint: &Blueprint,
        start: &Motion,
        problem: &mut ConstraintProblem,
    ) -> (usize, usize) {
        let softness = &self.plan.softness;
        let compliance = f64::from(softness.compliance(-self.position as f32)) * self.inverse[0];
        let frictions = self.plan.dimensions - 1;
        let mu = self.plan.friction[0];
        let impratio = blueprint.contacts.impratio;
        if frictions == 0 {
            self.fill(problem.add_row(), start, &[(0, 1.0)]);
            let aim = softness.reference_acceleration(Some(self.position), speed(problem, start));
            problem.set_row(aim, compliance);
            return (problem.close(Kind::Push), 1);
        }
        if blueprint.contacts.cone == Cone::Elliptic {
            for direction in 0..=frictions {
                self.fill(problem.add_row(), start, &[(direction, 1.0)]);
                let (position, ratio, softness) = match direction {
                    0 => (Some(self.position), 1.0, softness),
                    k => {
                        let own = self.plan.friction_softness.as_ref();
                        (None, mu / self.plan.friction[k - 1], own.unwrap_or(softness))
                    }
                };
                let aim = softness.reference_acceleration(position, speed(problem, start));
                let share = if direction == 0 { 1.0 } else { ratio * ratio / impratio };
                problem.set_scaled_row(aim, compliance, share);
            }
            let friction = self.plan.friction;
            return (problem.close(Kind::Cone { mu: mu / impratio.sqrt(), friction }), 1);
        }
        // All edges of a pyramid have the compliance of the first.
        let compliance = compliance * (1.0 + mu * mu);
        let mut first = 0;
        for direction in 1..=frictions {
            for sign in [1.0, -1.0] {
                let friction = sign * self.plan.friction[direction - 1];
                self.fill(problem.add_row(), start, &[(0, 1.0), (direction, friction)]);
                let aim =
                    softness.reference_acceleration(Some(self.position), speed(problem, start));
                problem.set_scaled_row(aim, compliance, 2.0 * mu * mu / impratio);
                first = problem.close(Kind::Push);
            }
        }
        (first + 1 - 2 * frictions, 2 * frictions)
    }

    /// Writes the Jacobian of a sum of directions, each with its factor: 0 for the normal, 1 and 2 for the tangents, and
    /// 3 to 5 for rotations about these three.
    fn fill(&self, row: &mut [f64], start: &Motion, directions: &[(usize, f64)]) {
        for (link, sign) in self.links.iter().zip([-1.0, 1.0]) {
            let Some(link) = link else { continue };
            for (direction, factor) in directions {
                let mut wrench = [DVec3::ZERO; 2];
                wrench[direction / 3] = self.axes[direction % 3];
                start.add_levers(row, (link, self.point), wrench, sign * factor);
            }
        }
    }
}

/// Speed along the row that was added last.
fn speed(problem: &ConstraintProblem, start: &Motion) -> f64 {
    dot(problem.last_row(), &start.speeds)
}
