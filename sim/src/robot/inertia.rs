//! Mass properties of a link from its parts: shapes, meshes and stated inertias.
//!
//! rapier computes principal axes with the platform's `acos` and `cos`, whose last bits differ between C libraries.
//! Here Jacobi rotations compute them with arithmetic and square roots only, which are exact on every platform.

use rapier3d::glamx::Mat3;
use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::prelude::{MassProperties, SharedShape};

use super::frame::{product, vector};

/// A matrix by rows.
pub(super) type Matrix = [[f64; 3]; 3];

const IDENTITY: Matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
/// Sweeps of Jacobi's method. It converges quadratically; five sweeps reach the last bit of a 3 x 3 matrix.
const SWEEPS: usize = 8;
/// Most rotations in MuJoCo's search for principal axes.
const MOST_TURNS: usize = 500;
/// Product of inertia, as a share of the moments' sum, that counts as zero: the round-off of the shapes' f32 quaternions.
const ROUND_OFF: f64 = 1e-7;

/// A rigid part: its mass, its mass centre, and its inertia about the centre.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Solid {
    /// kg.
    pub(super) mass: f64,
    /// m.
    pub(super) centre: [f64; 3],
    /// kg m^2.
    pub(super) inertia: Matrix,
}

impl Solid {
    /// A shape of a uniform density, kg/m^3, with the pose `pose` in the link's frame.
    pub(super) fn of_shape(shape: &SharedShape, density: f32, pose: &Pose) -> Self {
        let part = shape.mass_properties(density);
        let mass = f64::from(part.mass());
        let centre = (*pose * part.local_com).to_array().map(f64::from);
        let frame = pose.rotation * part.principal_inertia_local_frame;
        let turn = matrix(numbers(frame));
        let principal = part.principal_inertia().to_array().map(f64::from);
        let mut inertia = [[0.0; 3]; 3];
        for (row, numbers) in inertia.iter_mut().enumerate() {
            for (column, number) in numbers.iter_mut().enumerate() {
                *number = (0..3).map(|k| turn[row][k] * principal[k] * turn[column][k]).sum();
            }
        }
        Self { mass, centre, inertia }
    }

    /// A part with its principal axes along its frame.
    pub(super) fn principal(mass: f64, moments: [f64; 3]) -> Self {
        let [x, y, z] = moments;
        let inertia = [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]];
        Self { mass, centre: [0.0; 3], inertia }
    }

    /// A part from its second moments about the centre, `integral x x^T dm`.
    pub(super) fn from_moments(mass: f64, centre: [f64; 3], moments: Matrix) -> Self {
        let trace = moments[0][0] + moments[1][1] + moments[2][2];
        let mut inertia = [[0.0; 3]; 3];
        for (row, numbers) in inertia.iter_mut().enumerate() {
            for (column, number) in numbers.iter_mut().enumerate() {
                *number = IDENTITY[row][column] * trace - moments[row][column];
            }
        }
        Self { mass, centre, inertia }
    }

    /// The part with another mass and the same distribution of it.
    pub(super) fn with_mass(&self, mass: f64) -> Self {
        let factor = mass / self.mass;
        Self { mass, centre: self.centre, inertia: self.inertia.map(|row| row.map(|x| factor * x)) }
    }

    /// The part in the parent of `frame`.
    pub(super) fn placed(&self, frame: &Pose) -> Self {
        let mut placed = self.turned(numbers(frame.rotation));
        let at = frame.translation.to_array().map(f64::from);
        (0..3).for_each(|axis| placed.centre[axis] += at[axis]);
        placed
    }

    /// The part rotated by a unit quaternion (x y z w).
    pub(super) fn turned(&self, rotation: [f64; 4]) -> Self {
        let turn = matrix(rotation);
        let mut turned = Self { mass: self.mass, ..Self::default() };
        for row in 0..3 {
            turned.centre[row] = (0..3).map(|k| turn[row][k] * self.centre[k]).sum();
            for column in 0..3 {
                turned.inertia[row][column] = (0..9)
                    .map(|k| turn[row][k / 3] * self.inertia[k / 3][k % 3] * turn[column][k % 3])
                    .sum();
            }
        }
        turned
    }

    /// The part with at least this mass, kg, and these principal moments, kg m^2.
    pub(super) fn at_least(&self, mass: f64, inertia: f64) -> Self {
        let (moments, frame) = principal_axes(self.inertia);
        let raised = Self::principal(self.mass.max(mass), moments.map(|own| own.max(inertia)));
        Self { centre: self.centre, ..raised.turned(numbers(frame)) }
    }

    /// Moments along axes, kg m^2.
    pub(super) fn moments_along(&self, axes: Rotation) -> [f64; 3] {
        let inertia = self.inside(numbers(axes));
        std::array::from_fn(|axis| inertia[axis][axis])
    }

    /// Principal axes as MuJoCo finds them from those of `frame`: turned about one axis after another, so that the largest product
    /// of inertia becomes zero. Which axes of equal moments are found depends on this order.
    pub(super) fn axes_from(&self, frame: Rotation) -> Rotation {
        let part = Self { inertia: self.inside(numbers(frame)), ..Self::default() };
        let [x, y, z, w] = part.found_axes().map(|number| number as f32);
        frame * Rotation::from_xyzw(x, y, z, w)
    }

    /// Principal axes as MuJoCo finds and orders them, the one with the largest moment first, as a unit quaternion (x y z w).
    pub(super) fn sorted_axes(&self) -> [f64; 4] {
        let mut found = self.found_axes();
        for first in [0, 1, 0] {
            let inertia = self.inside(found);
            if inertia[first][first] + ROUND_OFF * self.trace() < inertia[first + 1][first + 1] {
                found = unit(turned(found, (first + 2) % 3, [0.0, 1.0]));
            }
        }
        found
    }

    fn trace(&self) -> f64 {
        (0..3).map(|axis| self.inertia[axis][axis]).sum()
    }

    /// Axes, as a unit quaternion (x y z w), along which all products of inertia are zero.
    fn found_axes(&self) -> [f64; 4] {
        let mut found = [0.0, 0.0, 0.0, 1.0];
        let trace = self.trace();
        for _ in 0..MOST_TURNS {
            let inertia = self.inside(found);
            let size = |axis: usize| inertia[(axis + 1) % 3][(axis + 2) % 3].abs();
            let axis = match (size(2) > size(1), size(1) > size(0)) {
                (true, _) if size(2) > size(0) => 2,
                (_, true) => 1,
                _ => 0,
            };
            let rotation = jacobi_rotation(&inertia, (axis + 1) % 3, (axis + 2) % 3);
            let Some(rotation) = rotation.filter(|_| size(axis) > ROUND_OFF * trace) else { break };
            found = unit(turned(found, axis, rotation));
        }
        found
    }

    /// Inertia along the axes of a unit quaternion (x y z w).
    fn inside(&self, [x, y, z, w]: [f64; 4]) -> Matrix {
        self.turned([-x, -y, -z, w]).inertia
    }

    /// Centre, half edges and axes of the box with the same mass and inertia, the shortest edge first.
    pub(super) fn half_box(&self) -> ([f64; 3], [f64; 3], Rotation) {
        let (moments, axes) = principal_axes(self.inertia);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| moments[*b].total_cmp(&moments[*a]));
        let [x, y, z] = order.map(|axis| moments[axis]);
        let half = |square: f64| (1.5 * square.max(0.0) / self.mass).sqrt();
        let columns = order.map(|axis| axes * [Vector::X, Vector::Y, Vector::Z][axis]);
        let frame = Mat3::from_cols(columns[0], columns[1], columns[0].cross(columns[1]));
        let sizes = [half(y + z - x), half(x + z - y), half(x + y - z)];
        (self.centre, sizes, Rotation::from_mat3(&frame))
    }

    /// Principal moments, kg m^2.
    pub(super) fn principal_moments(&self) -> [f64; 3] {
        principal_axes(self.inertia).0
    }
}

/// Mass, first moments and inertia about the link's origin, summed over its parts.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MassSum {
    /// kg.
    pub(super) mass: f64,
    /// kg m.
    moments: [f64; 3],
    /// kg m^2.
    inertia: Matrix,
}

impl MassSum {
    /// Adds a part whose centre and axes are those of the link's frame.
    pub(super) fn add(&mut self, solid: &Solid) {
        let Solid { mass, centre, inertia } = *solid;
        let square: f64 = centre.iter().map(|x| x * x).sum();
        for row in 0..3 {
            self.moments[row] += mass * centre[row];
            for column in 0..3 {
                let shift = IDENTITY[row][column] * square - centre[row] * centre[column];
                self.inertia[row][column] += inertia[row][column] + mass * shift;
            }
        }
        self.mass += mass;
    }

    /// The sum as one part; without a mass, nothing.
    pub(super) fn solid(&self) -> Solid {
        if self.mass <= 0.0 {
            return Solid::default();
        }
        let centre = self.moments.map(|moment| moment / self.mass);
        let square: f64 = centre.iter().map(|x| x * x).sum();
        let mut inertia = self.inertia;
        for row in 0..3 {
            for column in 0..3 {
                let shift = IDENTITY[row][column] * square - centre[row] * centre[column];
                inertia[row][column] -= self.mass * shift;
            }
        }
        Solid { mass: self.mass, centre, inertia }
    }

    /// Mass properties, with mass and inertia multiplied by `factor`.
    pub(super) fn properties(&self, factor: f64) -> MassProperties {
        if self.mass <= 0.0 {
            return MassProperties::default();
        }
        let Solid { mass, centre, inertia } = self.solid();
        let (principal, frame) = principal_axes(inertia);
        MassProperties::with_principal_inertia_frame(
            vector(centre),
            (factor * mass) as f32,
            vector(principal.map(|moment| factor * moment)),
            frame,
        )
    }
}

fn numbers(rotation: Rotation) -> [f64; 4] {
    rotation.to_array().map(f64::from)
}

/// Rotation matrix of a unit quaternion.
fn matrix([x, y, z, w]: [f64; 4]) -> Matrix {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Eigenvalues of a symmetric matrix and the rotation from the frame of its eigenvectors, by Jacobi's method. The
/// rotation is a quaternion, so that a diagonal matrix gives exactly the identity.
fn principal_axes(mut inertia: Matrix) -> ([f64; 3], Rotation) {
    let mut frame = [0.0, 0.0, 0.0, 1.0];
    for _ in 0..SWEEPS {
        for axis in 0..3 {
            let (p, q) = ((axis + 1) % 3, (axis + 2) % 3);
            if let Some([cos, sin]) = jacobi_rotation(&inertia, p, q) {
                rotate(&mut inertia, [p, q], [cos, sin]);
                frame = turned(frame, axis, [cos, sin]);
            }
        }
    }
    let [x, y, z, w] = unit(frame).map(|x| x as f32);
    ([inertia[0][0], inertia[1][1], inertia[2][2]], Rotation::from_xyzw(x, y, z, w))
}

/// The quaternion with the length 1.
fn unit(quaternion: [f64; 4]) -> [f64; 4] {
    let length = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
    quaternion.map(|x| x / length)
}

/// Cosine and sine of the rotation from `p` to `q` that makes `inertia[p][q]` zero; `None` if it is already zero.
fn jacobi_rotation(inertia: &Matrix, p: usize, q: usize) -> Option<[f64; 2]> {
    let off = inertia[p][q];
    let size = inertia[p][p].abs() + inertia[q][q].abs();
    // Round-off of the shapes' f32 quaternions counts as zero.
    if off.abs() <= 1e-9 * size {
        return None;
    }
    let ratio = (inertia[q][q] - inertia[p][p]) / (2.0 * off);
    let tangent = ratio.signum() / (ratio.abs() + (ratio * ratio + 1.0).sqrt());
    let cos = 1.0 / (tangent * tangent + 1.0).sqrt();
    // The frame of the eigenvectors rotates in the opposite direction.
    Some([cos, -tangent * cos])
}

/// `J^T inertia J`, where `J` is the rotation from `p` to `q`.
fn rotate(inertia: &mut Matrix, [p, q]: [usize; 2], [cos, sin]: [f64; 2]) {
    for row in inertia.iter_mut() {
        (row[p], row[q]) = (cos * row[p] + sin * row[q], cos * row[q] - sin * row[p]);
    }
    let (first, second) = (inertia[p], inertia[q]);
    for k in 0..3 {
        inertia[p][k] = cos * first[k] + sin * second[k];
        inertia[q][k] = cos * second[k] - sin * first[k];
    }
}

/// The quaternion (x y z w) followed by a rotation about its own `axis`.
fn turned(frame: [f64; 4], axis: usize, [cos, sin]: [f64; 2]) -> [f64; 4] {
    let half_cos = ((1.0 + cos) / 2.0).sqrt();
    let half_sin = sin / (2.0 * half_cos);
    let mut turn = [0.0; 3];
    turn[axis] = half_sin;
    let [a, b, c] = turn;
    product(frame, [a, b, c, half_cos])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn principal_axes_reconstruct_the_matrix() {
        let inertia = [[2.0, 0.3, -0.4], [0.3, 1.5, 0.2], [-0.4, 0.2, 0.7]];
        let (principal, frame) = principal_axes(inertia);
        let turn = matrix(numbers(frame));
        for row in 0..3 {
            for column in 0..3 {
                let sum: f64 = (0..3).map(|k| turn[row][k] * principal[k] * turn[column][k]).sum();
                assert!((sum - inertia[row][column]).abs() < 1e-6, "{row} {column}: {sum}");
            }
        }
    }

    #[test]
    fn a_diagonal_matrix_is_not_rotated() {
        let (principal, frame) =
            principal_axes([[3.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]]);
        assert_eq!((principal, frame), ([3.0, 1.0, 2.0], Rotation::IDENTITY));
    }

    #[test]
    fn two_balls_have_the_inertia_of_a_dumbbell() {
        let ball = SharedShape::ball(0.1);
        let mut sum = MassSum::default();
        for side in [-1.0, 1.0] {
            let pose = Pose::from_parts(Vector::new(side, side, 0.0), Rotation::IDENTITY);
            sum.add(&Solid::of_shape(&ball, 1000.0, &pose));
        }
        let mass = 1000.0 * 4.0 / 3.0 * std::f32::consts::PI * 1e-3;
        let own = 0.4 * mass * 0.01;
        let properties = sum.properties(1.0);
        let mut moments = properties.principal_inertia().to_array();
        moments.sort_by(f32::total_cmp);
        for (got, want) in
            moments.into_iter().zip([2.0 * own, 2.0 * own + 4.0 * mass, 2.0 * own + 4.0 * mass])
        {
            assert!((got - want).abs() < 1e-4 * want, "{got} kg m^2 against {want}");
        }
        assert!((properties.mass() - 2.0 * mass).abs() < 1e-4 * mass);
    }
}
