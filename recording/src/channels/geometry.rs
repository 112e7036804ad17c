//! Vectors and rotations of the simulator as Foxglove messages.

use foxglove::messages::{Quaternion, Vector3};

/// A vector or a position, metres.
pub(super) fn vector([x, y, z]: [f32; 3]) -> Vector3 {
    Vector3 { x: x.into(), y: y.into(), z: z.into() }
}

/// A rotation.
pub(super) fn quaternion([x, y, z, w]: [f32; 4]) -> Quaternion {
    Quaternion { x: x.into(), y: y.into(), z: z.into(), w: w.into() }
}
