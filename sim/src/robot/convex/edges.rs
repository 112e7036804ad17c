//! Whether two boxes touch with edges: the axis of their least overlap, after the separating axis theorem.

use rapier3d::glamx::DVec3;
use rapier3d::math::{Pose, Vector};

/// Part of the overlap along a face's normal by which that along edges must be less, as in MuJoCo.
const PREFERENCE: f64 = 0.05;
/// The same, as a fraction of the sum of all half sizes. MuJoCo has no such limit.
const DOUBT: f64 = 1e-3;

/// Whether two boxes touch with edges, if one has a face within 0.01 rad of the contact's normal: they overlap clearly less along a
/// normal of two edges. `between` is the pose of the second box in the first.
pub(super) fn overlap_least(halves: [Vector; 2], between: &Pose) -> bool {
    let [first, second] = halves.map(|half| half.as_dvec3().to_array());
    let apart = between.translation.as_dvec3();
    let own = DVec3::AXES;
    let other = own.map(|axis| between.rotation.as_dquat() * axis);
    let reach = |axis: DVec3, half: [f64; 3], axes: [DVec3; 3]| -> f64 {
        half.iter().zip(axes).map(|(half, side)| half * axis.dot(side).abs()).sum()
    };
    let overlap =
        |axis: DVec3| reach(axis, first, own) + reach(axis, second, other) - axis.dot(apart).abs();
    let least = |axes: &mut dyn Iterator<Item = DVec3>| axes.map(overlap).fold(f64::MAX, f64::min);
    let size: f64 = first.iter().chain(&second).sum();
    let faces = least(&mut own.into_iter().chain(other));
    let crossed = own.iter().flat_map(|one| other.map(|side| one.cross(side)));
    // Parallel edges have no common normal.
    let crossed = crossed.filter_map(DVec3::try_normalize);
    let least_gain = (PREFERENCE * faces).max(DOUBT * size);
    least(&mut crossed.into_iter()) < faces - least_gain
}
