//! Contacts of convex shapes. The engine finds the normals of ellipsoids and cylinders only roughly, and misses contacts of capsules.

use rapier3d::math::Pose;
use rapier3d::parry::query::ContactManifold;
use rapier3d::parry::shape::Shape;

use super::pair::Pair;
use crate::robot::Convex;

/// Finds the contacts of convex shapes anew that the engine finds roughly: those of an ellipsoid or a cylinder, and wrong ones. Of
/// any convex shapes, only the deepest point remains, as in MuJoCo, unless the normal is that of a face of one of them, and no cylinder is
/// tilted against that face. Of two boxes with such a normal, it remains if edges touch.
pub(super) fn sharpen(
    shapes: [&dyn Shape; 2],
    between: &Pose,
    margin: f32,
    manifold: &mut ContactManifold<(), ()>,
) {
    let convex = shapes.map(|shape| shape.as_shape::<Convex>());
    if convex.iter().all(Option::is_none) {
        return;
    }
    let Some(pair) = Pair::new(shapes, between) else { return };
    let is_round = convex.into_iter().flatten().any(Convex::is_round);
    if is_round || !pair.is_right(manifold, margin) {
        Pair::find(shapes, between, (margin, is_round), manifold);
    }
    let along = [manifold.local_n1, manifold.local_n2];
    let faces = || convex.iter().zip(along);
    let has_face = faces().any(|(convex, along)| convex.is_some_and(|own| own.has_face(along)))
        && !faces().any(|(convex, along)| convex.is_some_and(|own| own.is_tilted(along)));
    let edges_touch = match convex {
        [Some(one), Some(other)] => has_face && one.edges_touch(other, between),
        _ => false,
    };
    if !has_face || edges_touch {
        keep_deepest(manifold);
    }
}

/// Keeps the point that was added last: the deepest one of two convex shapes.
pub(super) fn keep_deepest(manifold: &mut ContactManifold<(), ()>) {
    let others = manifold.points.len().saturating_sub(1);
    manifold.points.drain(..others);
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rapier3d::math::{Rotation, Vector};
    use rapier3d::parry::query::{DefaultQueryDispatcher, PersistentQueryDispatcher as _};
    use rapier3d::prelude::SharedShape;

    use super::*;
    use crate::scene::{Hull, Shape as Form};

    const ELLIPSOID: [f32; 3] = [0.15, 0.1, 0.05];
    const DEPTH: f32 = 1e-3;

    /// The normal, the distance and the point on the ellipsoid of its contact with another shape.
    fn contact(other: &SharedShape, pose: &Pose) -> (Vector, f32, Vector) {
        let ellipsoid = Convex::shared(&Form::Ellipsoid { half_sizes: ELLIPSOID }, &Pose::IDENTITY);
        let mut manifold = ContactManifold::new();
        sharpen([&*ellipsoid, &**other], pose, 0.0, &mut manifold);
        let [point] = &manifold.points[..] else { panic!("{} points", manifold.points.len()) };
        (manifold.local_n1, point.dist, point.local_p1)
    }

    /// The contact of two shapes that the engine finds, sharpened.
    fn touch(shapes: [&dyn Shape; 2], between: &Pose) -> ContactManifold<(), ()> {
        let mut manifold = ContactManifold::new();
        let [one, other] = shapes;
        let found = DefaultQueryDispatcher.contact_manifold_convex_convex(
            between,
            one,
            other,
            None,
            None,
            0.0,
            &mut manifold,
        );
        assert!(found.is_ok());
        sharpen(shapes, between, 0.0, &mut manifold);
        manifold
    }

    /// The upper edge of a box along x and the lower one of another along y cross a tenth of their size deep. Sizes in m.
    #[test]
    fn crossed_edges_touch_in_one_point() {
        for size in [0.2, 0.002] {
            let cube = Convex::shared(&Form::Box { half_sizes: [0.5 * size; 3] }, &Pose::IDENTITY);
            let turned =
                |axis: Vector| Rotation::from_axis_angle(axis, std::f32::consts::FRAC_PI_4);
            let height = 0.5 * size * std::f32::consts::SQRT_2;
            let below = Pose::from_parts(Vector::ZERO, turned(Vector::X));
            let above = Vector::new(0.1 * size, 0.15 * size, 2.0 * height - 0.1 * size);
            let between = below.inv_mul(&Pose::from_parts(above, turned(Vector::Y)));
            let manifold = touch([&*cube, &*cube], &between);
            let [point] = &manifold.points[..] else { panic!("{} points", manifold.points.len()) };
            assert!((below.rotation * manifold.local_n1 - Vector::Z).length() < 1e-3);
            let off = below * point.local_p1 - Vector::new(0.1 * size, 0.0, height);
            assert!(off.length() < 5e-3 * size, "{size}: {off}");
            assert!((point.dist / size + 0.1).abs() < 5e-5, "{size}: {}", point.dist);
        }
    }

    /// A box lies across the upper edge of a longer one, tilted along it; then on a face.
    #[test]
    fn an_edge_that_crosses_a_slightly_tilted_face_touches_in_one_point() {
        let shared = |half_sizes| Convex::shared(&Form::Box { half_sizes }, &Pose::IDENTITY);
        let below = shared([1.0, 0.1, 0.1]);
        let above = shared([0.08, 0.05, 0.03]);
        for (roll, tilt, count) in [(45.0_f32, 0.1_f32, 1), (45.0, 0.5, 1), (0.0, 0.1, 5)] {
            let pose = Pose::from_parts(Vector::ZERO, Rotation::from_rotation_x(roll.to_radians()));
            let height = if roll == 0.0 { 0.1 } else { 0.1 * std::f32::consts::SQRT_2 };
            let tilted = Rotation::from_rotation_y(tilt.to_radians());
            let between =
                pose.inv_mul(&Pose::from_parts(Vector::Z * (height + 0.03 - 4e-3), tilted));
            let manifold = touch([&*below, &*above], &between);
            assert_eq!(manifold.points.len(), count, "{roll} {tilt}");
        }
    }

    /// The bottom of a plate is 8 mm below its rim.
    #[test]
    fn a_hull_lies_on_the_corners_of_its_bottom_and_not_on_higher_ones() {
        let ring = |radius: f32, z: f32| {
            [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
                .map(|[x, y]| [radius * x, radius * y, z])
        };
        let points = [ring(0.4, 0.0), ring(0.5, 0.008), ring(0.5, 0.1)].concat();
        let triangles = vec![[0, 2, 1], [0, 3, 2]];
        let plate = Form::Hull(Arc::new(Hull { points, triangles }));
        let plate = Convex::shared(&plate, &Pose::IDENTITY);
        let below = Convex::shared(&Form::Box { half_sizes: [1.0; 3] }, &Pose::IDENTITY);
        let manifold = touch([&*below, &*plate], &Pose::from_translation(Vector::Z * 0.999));
        let distances: Vec<f32> = manifold.points.iter().map(|point| point.dist).collect();
        assert!(distances.len() >= 4, "{distances:?}");
        assert!(distances.iter().all(|dist| (dist + DEPTH).abs() < 1e-5), "{distances:?}");
    }

    #[test]
    fn a_cylinder_touches_a_face_in_one_point_unless_an_end_or_its_side_lies_on_it() {
        let cylinder =
            Convex::shared(&Form::Cylinder { half_length: 0.1, radius: 0.1 }, &Pose::IDENTITY);
        let below = Convex::shared(&Form::Box { half_sizes: [1.0; 3] }, &Pose::IDENTITY);
        for (degrees, count) in [(0.0_f32, 5), (8.0, 1), (60.0, 1), (90.0, 3)] {
            let turn = Rotation::from_rotation_x(degrees.to_radians());
            let (sine, cosine) = libm::sincosf(degrees.to_radians());
            let height = 1.0 + 0.1 * (sine + cosine) - DEPTH;
            let manifold =
                touch([&*below, &*cylinder], &Pose::from_parts(Vector::Z * height, turn));
            assert_eq!(manifold.points.len(), count, "{degrees}");
        }
    }

    #[test]
    fn a_capsule_whose_axis_ends_on_a_face_has_its_normal() {
        let cube = Convex::shared(&Form::Box { half_sizes: [0.1; 3] }, &Pose::IDENTITY);
        for step in 0..30 {
            let (sine, cosine) = libm::sincosf(0.05 * step as f32 - 0.7);
            let start = Vector::new(0.1, 0.0, 0.0);
            let capsule =
                SharedShape::capsule(start, start + 0.3 * Vector::new(cosine, 0.0, sine), 0.03);
            let manifold = touch([&*cube, &*capsule], &Pose::IDENTITY);
            assert!((manifold.local_n1 - Vector::X).length() < 1e-3, "{}", manifold.local_n1);
            let deepest = manifold.points.iter().map(|point| point.dist).fold(0.0, f32::min);
            assert!((deepest + 0.03).abs() < 1e-5, "{step}: {deepest}");
        }
    }

    /// An end and the side of a capsule, the corner of a box and the rim of a cylinder are a millimetre deep in an ellipsoid,
    /// along its normal at a known point.
    #[test]
    fn contacts_of_an_ellipsoid_are_along_its_normal_where_another_shape_is_deepest() {
        let [a, b, c] = ELLIPSOID.map(|half| half * half);
        for along in [[0.3, 0.5, 0.8], [-0.9, 0.2, 0.1], [0.1, -0.2, -1.0]] {
            let normal = Vector::from_array(along).normalize();
            let scaled = Vector::new(a * normal.x, b * normal.y, c * normal.z);
            let place = scaled / scaled.dot(normal).sqrt();
            let deepest = place - normal * DEPTH;
            let axis = normal.any_orthonormal_vector();
            let centre = deepest + normal * 0.03;
            let capsule = |from, to| (SharedShape::capsule(from, to, 0.03), Pose::IDENTITY);
            let tip = |form: Form, corner: [f32; 3], outward: [f32; 3]| {
                let outward = Vector::from_array(outward).normalize();
                let turn = Rotation::from_rotation_arc(outward, -normal);
                let moved = deepest - turn * Vector::from_array(corner);
                (Convex::shared(&form, &Pose::IDENTITY), Pose::from_parts(moved, turn))
            };
            for (shape, pose) in [
                capsule(centre, centre + (normal + axis) * 0.1),
                capsule(centre - axis * 0.1, centre + axis * 0.1),
                tip(Form::Box { half_sizes: [0.05; 3] }, [0.05; 3], [1.0, 0.8, 0.7]),
                tip(
                    Form::Cylinder { half_length: 0.06, radius: 0.04 },
                    [0.04, 0.0, 0.06],
                    [1.0, 0.0, 0.7],
                ),
            ] {
                let (found, distance, at) = contact(&shape, &pose);
                let off =
                    [(found - normal).length(), (distance + DEPTH).abs(), (at - place).length()];
                assert!(off[0] < 1e-3 && off[1] < 1e-6 && off[2] < 1e-4, "{along:?}: {off:?}");
            }
        }
    }
}
