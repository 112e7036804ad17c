//! Points in which two shapes touch, and the axes of their contacts.

use rapier3d::geometry::Collider;
use rapier3d::math::{Pose, Vector};
use rapier3d::parry::bounding_volume::BoundingVolume;
use rapier3d::parry::query::{
    ContactManifold, DefaultQueryDispatcher, PersistentQueryDispatcher, TrackedContact,
};
use rapier3d::parry::shape::{PackedFeatureId, SupportMap as _};

use super::convex::{keep_deepest, sharpen};
use super::segments::touch_capsules;
use crate::robot::{Convex, GroundForm};

/// Points of contact that are nearer to each other are one, m.
const SAME_POINT: f32 = 5e-5;
/// Sine of the tilt of a cylinder's axis up to which it stands upright.
const UPRIGHT: f32 = 1e-6;
/// Most contacts of a shape with a height field, as in MuJoCo.
const MOST_IN_FIELD: usize = 50;

/// The points of pairs of shapes, each with a normal in the frame of the first shape.
pub(super) type Manifolds = Vec<ContactManifold<(), ()>>;

/// Finds the points in which two shapes touch. `between` is the pose of the second in the frame of the first.
pub(super) fn touch(
    [one, other]: [&Collider; 2],
    between: &Pose,
    margin: f32,
    manifolds: &mut Manifolds,
) {
    let (one, other) = (one.shape(), other.shape());
    let convex = other.as_shape::<Convex>().filter(|_| one.as_halfspace().is_some());
    if let Some(hull) = convex.filter(|convex| convex.is_hull()) {
        manifolds.push(hull_on_plane(hull, between, margin));
        return;
    }
    if let Some((inside, sizes)) = convex.and_then(Convex::cylinder) {
        manifolds.extend(cylinder_on_plane(sizes, &(*between * *inside), between, margin));
        return;
    }
    let is_at_plane = one.as_halfspace().is_some() && between.translation.z.abs() < SAME_POINT;
    if let Some(ball) = other.as_ball().filter(|_| is_at_plane) {
        manifolds.push(ball_in_plane(ball.radius, between));
        return;
    }
    // The engine has no contacts for a plane with another plane, which do not meet.
    let _ =
        DefaultQueryDispatcher.contact_manifolds(between, one, other, margin, manifolds, &mut None);
    if let (Some(first), Some(second)) = (one.as_capsule(), other.as_capsule()) {
        touch_capsules([first, second], between, margin, manifolds);
        return;
    }
    for manifold in manifolds {
        sharpen([one, other], between, margin, manifold);
    }
}

/// The corners of a hull that touch a plane, at most four of those below it.
fn hull_on_plane(hull: &Convex, between: &Pose, margin: f32) -> ContactManifold<(), ()> {
    let mut manifold = ContactManifold::new();
    manifold.local_n1 = Vector::Z;
    let down = between.rotation.inverse() * -Vector::Z;
    let lowest = (*between * hull.local_support_point(down)).z;
    hull.corners_within(down, margin - lowest, |corner, id| {
        let place = *between * corner;
        let id = PackedFeatureId::vertex(id);
        let below = Vector::new(place.x, place.y, 0.0);
        manifold.points.push(TrackedContact::new(below, corner, id, id, place.z));
    });
    manifold
}

/// The contact of a plane with a ball whose centre is on it, where the engine has another normal.
fn ball_in_plane(radius: f32, between: &Pose) -> ContactManifold<(), ()> {
    let mut manifold = ContactManifold::new();
    manifold.local_n1 = Vector::Z;
    let place = between.translation;
    let lowest = between.rotation.inverse() * (Vector::Z * -radius);
    let (below, side) = (Vector::new(place.x, place.y, 0.0), PackedFeatureId::face(0));
    manifold.points.push(TrackedContact::new(below, lowest, side, side, place.z - radius));
    manifold
}

/// The points of a cylinder with the pose `pose` that touch a plane, as in MuJoCo, each on its own: the lowest one of its rim, that at
/// the other end of its side, and two on the lower rim at 120 degrees from the first.
fn cylinder_on_plane(
    [half, radius]: [f32; 2],
    pose: &Pose,
    between: &Pose,
    margin: f32,
) -> impl Iterator<Item = ContactManifold<(), ()>> + use<> {
    let axis = pose.rotation * Vector::Z;
    let axis = if axis.z > 0.0 { -axis } else { axis };
    let down = axis * axis.z - Vector::Z;
    let down = if down.length() > UPRIGHT { down.normalize() } else { pose.rotation * Vector::X };
    let (end, rim) = (axis * half, down * radius);
    let side = rim.cross(axis).normalize_or_zero() * (radius * 0.75_f32.sqrt());
    let offsets = [end + rim, rim - end, end - rim * 0.5 + side, end - rim * 0.5 - side];
    let places = offsets.map(|offset| pose.translation + offset);
    let back = between.inverse();
    (0..).zip(places).filter(move |(_, place)| place.z <= margin).map(move |(id, place)| {
        let (id, below) = (PackedFeatureId::vertex(id), Vector::new(place.x, place.y, 0.0));
        let mut manifold = ContactManifold::new();
        manifold.local_n1 = Vector::Z;
        manifold.points.push(TrackedContact::new(below, back * place, id, id, place.z));
        manifold
    })
}

/// Finds the points in which a shape touches a height field: as in MuJoCo, the deepest one in each of its prisms.
pub(super) fn touch_field(
    (ground, shape): (&GroundForm, &Collider),
    between: &Pose,
    margin: f32,
    manifolds: &mut Manifolds,
) {
    let GroundForm::Field(field) = ground else { return };
    let bounds = shape.shape().compute_aabb(between).loosened(margin);
    let deepest = |corners: [[f32; 3]; 6]| {
        let mut manifold = ContactManifold::new();
        let prism = Convex::prism(corners);
        // A plane does not move, so it meets no height field.
        let _ = DefaultQueryDispatcher.contact_manifold_convex_convex(
            between,
            &prism,
            shape.shape(),
            None,
            None,
            margin,
            &mut manifold,
        );
        sharpen([&prism, shape.shape()], between, margin, &mut manifold);
        keep_deepest(&mut manifold);
        manifold.points.iter().any(|point| point.dist < margin).then_some(manifold)
    };
    let prisms = field.prisms(bounds.mins, bounds.maxs);
    manifolds.extend(prisms.filter_map(deepest).take(MOST_IN_FIELD));
}

/// Whether another point, at least as deep, is in the place of the point `index`. The engine appends the deepest point of two
/// shapes to those in which their features touch, of which one is as deep unless the features miss each other. Of a capsule that
/// stands on a face, both ends are in one place.
pub(super) fn is_repeated(points: &[TrackedContact<()>], index: usize) -> bool {
    let point = &points[index];
    let is_appended = [point.fid1, point.fid2] == [PackedFeatureId::UNKNOWN; 2];
    let is_there =
        |other: &TrackedContact<()>| (other.local_p1 - point.local_p1).length() < SAME_POINT;
    let is_covered_before = points[..index].iter().any(|other| {
        (is_there(other) && other.dist - point.dist <= SAME_POINT)
            || (is_appended && index + 1 == points.len() && other.dist < point.dist + SAME_POINT)
    });
    let replaces = |(later, other): (usize, &TrackedContact<()>)| {
        let is_deeper = point.dist - other.dist > SAME_POINT;
        is_there(other) && is_deeper && !is_repeated(points, later)
    };
    is_covered_before || points.iter().enumerate().skip(index + 1).any(replaces)
}

/// MuJoCo's frame of a contact: the normal, and two tangents, the first of them along `along` as far as possible.
pub(super) fn frame(normal: Vector, along: Vector) -> [Vector; 3] {
    let towards = if along.length() < 0.5 {
        if normal.y.abs() < 0.5 { Vector::Y } else { Vector::Z }
    } else {
        along
    };
    let tangent = towards - normal * towards.dot(normal);
    // A capsule that stands on its end has no direction in the plane.
    let tangent = tangent.try_normalize().unwrap_or_else(|| normal.any_orthonormal_vector());
    [normal, tangent, normal.cross(tangent)]
}

#[cfg(test)]
mod tests {
    use rapier3d::math::Rotation;

    use super::*;
    use crate::scene::Shape;

    /// x, y and the distance of the contacts of a cylinder around a point above a plane, tilted around x.
    fn points(sizes: [f32; 2], height: f32, degrees: f32, margin: f32) -> Vec<[f32; 3]> {
        let [half_length, radius] = sizes;
        let form = Shape::Cylinder { half_length, radius };
        // In the link's frame it is elsewhere and turned.
        let inside = Pose::from_parts(Vector::new(0.3, -0.2, 0.1), Rotation::from_rotation_y(1.0));
        let cylinder = Convex::new(&form, &inside).unwrap();
        let turn = Rotation::from_rotation_x(degrees.to_radians());
        let pose = Pose::from_parts(Vector::new(0.0, 0.0, height), turn);
        let (inside, sizes) = cylinder.cylinder().unwrap();
        let between = pose * inside.inverse();
        let manifolds = cylinder_on_plane(sizes, &(between * *inside), &between, margin);
        let points = manifolds.flat_map(|manifold| manifold.points);
        let row = |point: TrackedContact<()>| {
            let at = between * point.local_p2;
            assert!((at.z - point.dist).abs() < 1e-6, "{at}");
            [point.local_p1.x, point.local_p1.y, point.dist]
        };
        points.map(row).collect()
    }

    /// Of MuJoCo 4.0.0.
    #[test]
    fn a_cylinder_touches_a_plane_where_mujocos_does() {
        let sizes = [0.1, 0.1];
        let upright = vec![[0.1, 0.0, -0.01], [-0.05, 0.086603, -0.01], [-0.05, -0.086603, -0.01]];
        let tilted = vec![
            [0.0, -0.092781, -0.016732],
            [0.086603, 0.056854, -0.006269],
            [-0.086603, 0.056854, -0.006269],
        ];
        let lying = vec![[0.0, 0.09824, -0.01173], [0.0, -0.10173, -0.00824]];
        let disc = vec![
            [0.1, 0.0, -0.001],
            [0.1, 0.0, 0.009],
            [-0.05, 0.086603, -0.001],
            [-0.05, -0.086603, -0.001],
        ];
        for (found, expected) in [
            (points(sizes, 0.09, 0.0, 0.0), upright),
            (points(sizes, 0.09, 4.0, 0.0), tilted),
            (points(sizes, 0.09, 89.0, 0.0), lying),
            (points([0.005, 0.1], 0.004, 0.0, 0.02), disc),
        ] {
            assert_eq!(found.len(), expected.len(), "{found:?}");
            let off = found.as_flattened().iter().zip(expected.as_flattened());
            let off = off.map(|(one, other)| (one - other).abs()).fold(0.0, f32::max);
            assert!(off < 6e-6, "{found:?}");
        }
    }
}
