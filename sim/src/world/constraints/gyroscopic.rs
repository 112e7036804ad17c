//! Gyroscopic forces of single free bodies, which MuJoCo's implicit integrators take implicit.

use rapier3d::glamx::{DMat3, DVec3};

use super::motion::{Branch, Motion};
use crate::robot::{JointPlan, Robot};

/// Velocities of a free joint: three of its origin, then three of its rotation.
const SIZE: usize = 6;

type Block = [[f64; SIZE]; SIZE];

/// A free link that carries no other; bodies that are welded to it are part of it.
pub(super) struct LoneLink {
    link: usize,
    /// Its first velocity.
    dof: usize,
}

impl LoneLink {
    /// All of a robot.
    pub(super) fn all(robot: &Robot) -> Vec<Self> {
        let links = &robot.blueprint.links;
        let carries = |link: usize| links.iter().any(|other| other.parent == Some(link));
        let is_free =
            |link: usize| matches!(links[link].joint, JointPlan::Free(_) | JointPlan::Floating(_));
        let lone = (0..links.len()).filter(|link| is_free(*link) && !carries(*link));
        lone.map(|link| Self { link, dof: robot.layout.joints[link].dof }).collect()
    }

    /// Accelerations `a` of the link's velocities with `(M + h B) a = f`: the forces `f` on all velocities, the implicit mass
    /// matrix `M`, of which the lower half is read, and [`bias_derivative`] `B`. Returns the first velocity and `a`; `None`
    /// if the matrix is singular.
    pub(super) fn accelerations(
        &self,
        start: &Motion,
        (mass, forces): (&[f64], &[f64]),
        step_secs: f64,
    ) -> Option<(usize, [f64; SIZE])> {
        let link = &start.links[self.link];
        let mut matrix = bias_derivative(link.branch(), link.velocity[1]);
        for (row, line) in matrix.iter_mut().enumerate() {
            for (column, number) in line.iter_mut().enumerate() {
                let [low, high] = [row.min(column), row.max(column)].map(|own| self.dof + own);
                *number = mass[high * forces.len() + low] + step_secs * *number;
            }
        }
        let own = std::array::from_fn(|row| forces[self.dof + row]);
        solved(matrix, own).map(|accelerations| (self.dof, accelerations))
    }
}

/// Derivative of a free body's bias forces by its velocities: of the force `w x (w x c)` and, about the origin, the torque
/// `w x J w`, with the angular velocity `w`, the inertia `J` about the origin and mass times mass centre `c` from it. The
/// speed of the origin has no influence.
fn bias_derivative(branch: &Branch, spin: DVec3) -> Block {
    let moment = branch.moment;
    let force = -(skew(spin.cross(moment)) + skew(spin) * skew(moment));
    let torque = skew(spin) * branch.inertia - skew(branch.inertia * spin);
    let mut block = [[0.0; SIZE]; SIZE];
    for (first, part) in [(0, force), (3, torque)] {
        for row in 0..3 {
            block[first + row][3..].copy_from_slice(&part.row(row).to_array());
        }
    }
    block
}

/// The matrix of the cross product with a vector.
fn skew(vector: DVec3) -> DMat3 {
    DMat3::from_cols(vector.cross(DVec3::X), vector.cross(DVec3::Y), vector.cross(DVec3::Z))
}

/// Solves `A x = b` by elimination; `None` if `A` is singular.
fn solved(mut matrix: Block, mut vector: [f64; SIZE]) -> Option<[f64; SIZE]> {
    for column in 0..SIZE {
        let size = |row: &usize| matrix[*row][column].abs();
        let pivot = (column..SIZE).max_by(|one, other| size(one).total_cmp(&size(other)))?;
        matrix.swap(column, pivot);
        vector.swap(column, pivot);
        let (line, number) = (matrix[column], vector[column]);
        if line[column] == 0.0 {
            return None;
        }
        for (below, to) in matrix.iter_mut().zip(&mut vector).skip(column + 1) {
            let factor = below[column] / line[column];
            below.iter_mut().zip(line).for_each(|(to, part)| *to -= factor * part);
            *to -= factor * number;
        }
    }
    for row in (0..SIZE).rev() {
        let found: f64 = (row + 1..SIZE).map(|column| matrix[row][column] * vector[column]).sum();
        vector[row] = (vector[row] - found) / matrix[row][row];
    }
    Some(vector)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equations_are_solved_also_with_zeros_on_the_diagonal() {
        let mut matrix = [[0.0; SIZE]; SIZE];
        for (row, line) in matrix.iter_mut().enumerate() {
            line[(row + 1) % SIZE] = 2.0;
            line[(row + 2) % SIZE] = 0.5;
        }
        let expected = [1.0, -2.0, 3.0, 0.5, -4.0, 7.0];
        let product = matrix.map(|line| line.iter().zip(expected).map(|(a, b)| a * b).sum());
        let found = solved(matrix, product).unwrap();
        let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-12, "{found:?}");
        assert_eq!(solved([[1.0; SIZE]; SIZE], expected), None);
    }
}
