//! Positions and orientations as MJCF states them, in double precision.
//!
//! Angles become quaternions with the sine and cosine of `libm`, which are the same on every machine.

use rapier3d::math::{Pose, Rotation, Vector};

use super::document::{Element, ORIENTATIONS};

/// A frame in its parent's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame {
    /// m.
    pub(super) position: [f64; 3],
    /// Unit quaternion, x y z w.
    pub(super) rotation: [f64; 4],
}

pub(super) const IDENTITY: Frame = Frame { position: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] };

/// Units and order of a document's angles.
#[derive(Clone, Debug)]
pub(super) struct Angles {
    pub(super) degrees: bool,
    /// Axes of Euler angles, in the order of their rotations; upper case for axes of the parent's frame.
    pub(super) sequence: String,
}

impl Default for Angles {
    fn default() -> Self {
        Self { degrees: true, sequence: "xyz".to_owned() }
    }
}

impl Angles {
    /// Radians of an angle in the document's unit.
    pub(super) fn radians(&self, angle: f64) -> f64 {
        if self.degrees { angle * std::f64::consts::PI / 180.0 } else { angle }
    }

    /// Reads `pos` and the orientation of an element.
    pub(super) fn frame(&self, element: &Element) -> Result<Frame, String> {
        let position = element.numbers("pos")?.unwrap_or([0.0; 3]);
        Ok(Frame { position, rotation: self.rotation(element)? })
    }

    fn rotation(&self, element: &Element) -> Result<[f64; 4], String> {
        let mut given = ORIENTATIONS.iter().filter(|name| element.text(name).is_some());
        let (first, second) = (given.next(), given.next());
        if second.is_some() {
            return Err(element.refuse("it has more than one orientation; remove all but one"));
        }
        let rotation = match first.copied() {
            Some("quat") => {
                let [w, x, y, z] = element.numbers("quat")?.unwrap_or_default();
                Some([x, y, z, w])
            }
            Some("axisangle") => {
                let [x, y, z, angle] = element.numbers("axisangle")?.unwrap_or_default();
                unit([x, y, z]).map(|axis| about(axis, self.radians(angle)))
            }
            Some("euler") => Some(self.euler(element)?),
            Some("xyaxes") => {
                let [a, b, c, d, e, f] = element.numbers("xyaxes")?.unwrap_or_default();
                from_axes([a, b, c], [d, e, f])
            }
            Some(_) => {
                let axis = element.numbers::<3>("zaxis")?.unwrap_or_default();
                unit(axis).map(|axis| arc([0.0, 0.0, 1.0], axis))
            }
            None => return Ok(IDENTITY.rotation),
        };
        let rotation = rotation.and_then(normalized);
        let name = first.copied().unwrap_or_default();
        let reason = || format!("`{name}` has no direction; correct its numbers");
        rotation.ok_or_else(|| element.refuse_for(name, reason()))
    }

    fn euler(&self, element: &Element) -> Result<[f64; 4], String> {
        let angles: [f64; 3] = element.numbers("euler")?.unwrap_or_default();
        let mut rotation = IDENTITY.rotation;
        for (letter, angle) in self.sequence.chars().zip(angles) {
            let mut axis = [0.0; 3];
            axis["xyz".find(letter.to_ascii_lowercase()).unwrap_or(0)] = 1.0;
            let turn = about(axis, self.radians(angle));
            rotation = if letter.is_ascii_lowercase() {
                product(rotation, turn)
            } else {
                product(turn, rotation)
            };
        }
        Ok(rotation)
    }
}

impl Frame {
    /// A frame inside this one, in this one's parent.
    pub(super) fn then(&self, inner: &Self) -> Self {
        if *self == IDENTITY {
            return *inner;
        }
        let moved = rotated(self.rotation, inner.position);
        Self {
            position: [0, 1, 2].map(|i| self.position[i] + moved[i]),
            rotation: product(self.rotation, inner.rotation),
        }
    }

    /// The frame that `fromto` states: in the middle of two points, with the z axis from the second to the first. `None` if they
    /// are the same.
    pub(super) fn between([from, to]: [[f64; 3]; 2]) -> Option<Self> {
        let axis = unit([0, 1, 2].map(|i| from[i] - to[i]))?;
        let rotation = normalized(arc([0.0, 0.0, 1.0], axis))?;
        Some(Self { position: [0, 1, 2].map(|i| (from[i] + to[i]) / 2.0), rotation })
    }

    /// The parent's frame in this one.
    pub(super) fn inverse(&self) -> Self {
        let [x, y, z, w] = self.rotation;
        let rotation = [-x, -y, -z, w];
        Self { position: rotated(rotation, self.position).map(|part| -part), rotation }
    }

    /// The frame in single precision.
    pub(super) fn pose(&self) -> Pose {
        let [x, y, z, w] = self.rotation.map(|number| number as f32);
        Pose::from_parts(vector(self.position), Rotation::from_xyzw(x, y, z, w))
    }
}

/// A vector in single precision.
pub(super) fn vector(numbers: [f64; 3]) -> Vector {
    Vector::from_array(numbers.map(|number| number as f32))
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A vector rotated by a unit quaternion.
pub(super) fn rotated([x, y, z, w]: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let once = cross([x, y, z], v);
    let twice = cross([x, y, z], once);
    [0, 1, 2].map(|i| v[i] + 2.0 * (w * once[i] + twice[i]))
}

/// The direction of a vector; `None` if it is too short to have one.
pub(crate) fn unit(vector: [f64; 3]) -> Option<[f64; 3]> {
    let length = dot(vector, vector).sqrt();
    (length > 1e-12).then(|| vector.map(|x| x / length))
}

/// The unit quaternion in the direction of another; `None` if it is too short to have one.
pub(super) fn normalized(q: [f64; 4]) -> Option<[f64; 4]> {
    let length = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    let scale = 1.0 / length;
    (length > 1e-12).then(|| q.map(|x| x * scale))
}

/// The rotation about a unit vector.
pub(super) fn about(axis: [f64; 3], angle: f64) -> [f64; 4] {
    let (sin, cos) = libm::sincos(angle / 2.0);
    [axis[0] * sin, axis[1] * sin, axis[2] * sin, cos]
}

/// The shortest rotation from one unit vector to another.
fn arc(from: [f64; 3], to: [f64; 3]) -> [f64; 4] {
    let cos = dot(from, to);
    if cos < -1.0 + 1e-12 {
        return [1.0, 0.0, 0.0, 0.0];
    }
    let [x, y, z] = cross(from, to);
    [x, y, z, 1.0 + cos]
}

/// Rotation with the given x axis and a y axis in the plane of both.
fn from_axes(x: [f64; 3], y: [f64; 3]) -> Option<[f64; 4]> {
    let x = unit(x)?;
    let z = unit(cross(x, y))?;
    let y = cross(z, x);
    let first = arc([1.0, 0.0, 0.0], x);
    let first = normalized(if dot([1.0, 0.0, 0.0], x) < -1.0 + 1e-12 {
        [0.0, 0.0, 1.0, 0.0]
    } else {
        first
    })?;
    // The rest is a rotation about x, from the rotated y axis to the wanted one.
    let moved = rotated(first, [0.0, 1.0, 0.0]);
    let (cos, sin) = (dot(moved, y), dot(cross(moved, y), x));
    let half = [(1.0 + cos).max(0.0).sqrt(), (1.0 - cos).max(0.0).sqrt().copysign(sin)];
    let second = normalized([x[0] * half[1], x[1] * half[1], x[2] * half[1], half[0]])?;
    Some(product(second, first))
}

/// A rotation followed by one about its own axes, by a rotation vector, rad.
pub(crate) fn turned(rotation: Rotation, turn: [f32; 3]) -> Rotation {
    let turn = turn.map(f64::from);
    let start = rotation.to_array().map(f64::from);
    let end = unit(turn).map(|axis| product(start, about(axis, dot(turn, turn).sqrt())));
    let [x, y, z, w] = normalized(end.unwrap_or(start)).unwrap_or(start).map(|part| part as f32);
    Rotation::from_xyzw(x, y, z, w)
}

/// The rotation vector of a rotation, at most a half turn, rad.
pub(crate) fn rotation_vector(rotation: Rotation) -> [f64; 3] {
    let [x, y, z, w] = rotation.to_array().map(f64::from);
    let sin = dot([x, y, z], [x, y, z]).sqrt();
    let angle = 2.0 * libm::atan2(sin, w);
    let angle = if angle > std::f64::consts::PI { angle - std::f64::consts::TAU } else { angle };
    if sin > 0.0 { [x, y, z].map(|part| part * angle / sin) } else { [0.0; 3] }
}

/// The rotation `b`, then `a`.
pub(crate) fn product([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}
