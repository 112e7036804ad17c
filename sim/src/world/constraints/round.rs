//! Contacts of ellipsoids and cylinders with other convex shapes. The engine finds their normals only roughly, and misses
//! contacts of capsules.

use rapier3d::glamx::{DMat2, DVec2};
use rapier3d::math::{Pose, Vector};
use rapier3d::parry::query::{ContactManifold, TrackedContact};
use rapier3d::parry::shape::{
    PackedFeatureId, PolygonalFeature, PolygonalFeatureMap, Segment, Shape,
};

use super::segments::nearest;
use crate::robot::Convex;

/// Tangent of the largest angle between the first guess and the normal.
const FARTHEST: f64 = 1.0;
/// Steps of the search for a normal. Each keeps 0.77 of the area in which it is; all of them 6e-11.
const STEPS: usize = 90;
/// Distances that differ less are equal, m.
const ROUNDING: f32 = 1e-6;
/// Change of a normal that shows the edges of a shape, rad.
const TILT: f32 = 3e-4;
/// Shortest edge that another one can cross, m: longer than where a round shape touches.
const EDGE: f32 = 6e-3;

/// Two convex shapes, capsules without their radii.
struct Pair<'a> {
    maps: [&'a dyn PolygonalFeatureMap; 2],
    radii: [f32; 2],
    /// Pose of the second shape in the frame of the first.
    between: &'a Pose,
}

/// Finds the contacts of an ellipsoid or a cylinder anew. Of any convex shapes, only the deepest point remains, as in MuJoCo, unless
/// the normal is that of a face of one of them.
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
    let [Some((one, first)), Some((other, second))] =
        shapes.map(|shape| shape.as_polygonal_feature_map())
    else {
        return;
    };
    let pair = Pair { maps: [one, other], radii: [first, second], between };
    let is_unsure = match manifold.points.last() {
        // The engine has no normal where the axis of a capsule just touches a shape.
        Some(deepest) => first + second > 0.0 && (deepest.dist + first + second).abs() < ROUNDING,
        None => manifold.local_n1 == Vector::ZERO,
    };
    if is_unsure || convex.into_iter().flatten().any(Convex::is_round) {
        let [from, to] = shapes.map(|shape| shape.compute_local_aabb().center());
        let Some(normal) = pair.normal([manifold.local_n1, *between * to - from]) else { return };
        manifold.points.clear();
        if pair.distance(normal) < margin {
            pair.touch(normal, manifold);
        }
    }
    let along = [manifold.local_n1, manifold.local_n2];
    let mut faces = convex.iter().zip(along);
    if !faces.any(|(convex, along)| convex.is_some_and(|convex| convex.has_face(along))) {
        keep_deepest(manifold);
    }
}

/// Keeps the point that was added last: the deepest one of two convex shapes.
pub(super) fn keep_deepest(manifold: &mut ContactManifold<(), ()>) {
    let others = manifold.points.len().saturating_sub(1);
    manifold.points.drain(..others);
}

impl Pair<'_> {
    /// The farthest point of the first shape along a direction, and that of the second against it.
    fn ends(&self, along: Vector) -> [Vector; 2] {
        let [one, other] = self.maps;
        let against = self.between.rotation.inverse() * -along;
        [one.local_support_point(along), *self.between * other.local_support_point(against)]
    }

    /// Distance along a direction, m; negative if the shapes overlap.
    fn distance(&self, along: Vector) -> f32 {
        let [one, other] = self.ends(along);
        (other - one).dot(along) - self.radii[0] - self.radii[1]
    }

    /// The direction near one of two guesses along which the distance is largest: the normal of the contact. As the distance is
    /// nearly concave in it, an ellipse in which it is shrinks by the half in which it is not (the ellipsoid method).
    fn normal(&self, guesses: [Vector; 2]) -> Option<Vector> {
        let guesses = guesses.into_iter().filter_map(Vector::try_normalize);
        let better =
            |one: &Vector, other: &Vector| self.distance(*one).total_cmp(&self.distance(*other));
        let start = guesses.max_by(better)?;
        let (right, up) = start.any_orthonormal_pair();
        let at = |place: DVec2| start + place.x as f32 * right + place.y as f32 * up;
        let mut centre = DVec2::ZERO;
        let mut ellipse = DMat2::IDENTITY * (FARTHEST * FARTHEST);
        for _ in 0..STEPS {
            let along = at(centre).normalize();
            let [one, other] = self.ends(along);
            let aside = (other - one) - along * (other - one).dot(along);
            let slope = DVec2::new(f64::from(aside.dot(right)), f64::from(aside.dot(up)));
            let step = ellipse * slope;
            let length = step.dot(slope).sqrt();
            if length.is_nan() || length <= 0.0 {
                break;
            }
            let step = step / length;
            centre += step / 3.0;
            let outer = DMat2::from_cols(step * step.x, step * step.y);
            ellipse = (ellipse - outer * (2.0 / 3.0)) * (4.0 / 3.0);
        }
        let found = at(centre).normalize();
        // The engine has the normals of faces exactly.
        let is_better = self.distance(found) > self.distance(start) - ROUNDING;
        Some(if is_better { found } else { start })
    }

    /// Sets the points of a contact with this normal: those in which the farthest faces and edges meet, then the deepest.
    fn touch(&self, normal: Vector, manifold: &mut ContactManifold<(), ()>) {
        let inside = self.between.rotation.inverse() * -normal;
        (manifold.local_n1, manifold.local_n2) = (normal, inside);
        let mut features = [PolygonalFeature::default(), PolygonalFeature::default()];
        for ((feature, map), along) in features.iter_mut().zip(self.maps).zip([normal, inside]) {
            map.local_support_feature(along, feature);
        }
        let [first, second] = &features;
        let back = self.between.inverse();
        PolygonalFeature::contacts(
            self.between,
            &back,
            normal,
            inside,
            first,
            second,
            manifold,
            false,
        );
        let apart = self.distance(normal) + self.radii[0] + self.radii[1];
        let [one, other] = self.ends(normal);
        let edges = [0, 1].map(|shape| self.edge(normal, shape));
        let lengths = [edges[0].length(), edges[1].length()];
        // Of a face only some line is known, which does not count.
        let deepest = if lengths[0].min(lengths[1]) > EDGE {
            nearest(&edges[0], &edges[1])[0]
        } else if lengths[0] <= lengths[1] {
            one
        } else {
            other - normal * apart
        };
        let unknown = PackedFeatureId::UNKNOWN;
        let opposite = back * (deepest + normal * apart);
        manifold.points.push(TrackedContact::new(deepest, opposite, unknown, unknown, apart));
        for point in &mut manifold.points {
            point.local_p1 += normal * self.radii[0];
            point.local_p2 += inside * self.radii[1];
            point.dist -= self.radii[0] + self.radii[1];
        }
    }

    /// Where the farthest point of a shape is when the direction is tilted a little to one side and to the other, of two
    /// such lines the longer one: an edge or nearly a point.
    fn edge(&self, along: Vector, shape: usize) -> Segment {
        let (right, up) = along.any_orthonormal_pair();
        let tilted = |aside: Vector| {
            let [a, b] = [TILT, -TILT].map(|tilt| self.ends(along + tilt * aside)[shape]);
            Segment::new(a, b)
        };
        let [one, other] = [tilted(right), tilted(up)];
        if one.length() >= other.length() { one } else { other }
    }
}

#[cfg(test)]
mod tests {
    use rapier3d::math::Rotation;
    use rapier3d::parry::query::{DefaultQueryDispatcher, PersistentQueryDispatcher as _};
    use rapier3d::prelude::SharedShape;

    use super::*;
    use crate::scene::Shape as Form;

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

    /// The upper edge of a box along x and the lower one of another along y cross 0.02 m deep.
    #[test]
    fn crossed_edges_touch_in_one_point() {
        let cube = Convex::shared(&Form::Box { half_sizes: [0.1; 3] }, &Pose::IDENTITY);
        let turned = |axis: Vector| Rotation::from_axis_angle(axis, std::f32::consts::FRAC_PI_4);
        let height = 0.1 * std::f32::consts::SQRT_2;
        let below = Pose::from_parts(Vector::ZERO, turned(Vector::X));
        let above = Vector::new(0.02, 0.03, 2.0 * height - 0.02);
        let between = below.inv_mul(&Pose::from_parts(above, turned(Vector::Y)));
        let mut manifold = ContactManifold::<(), ()>::new();
        let found = DefaultQueryDispatcher.contact_manifold_convex_convex(
            &between,
            &*cube,
            &*cube,
            None,
            None,
            0.0,
            &mut manifold,
        );
        assert!(found.is_ok() && manifold.points.len() > 1);
        sharpen([&*cube, &*cube], &between, 0.0, &mut manifold);
        let [point] = &manifold.points[..] else { panic!("{} points", manifold.points.len()) };
        assert!((below.rotation * manifold.local_n1 - Vector::Z).length() < 1e-3);
        let place = below * point.local_p1;
        assert!((place - Vector::new(0.02, 0.0, height)).length() < 1e-3, "{place}");
        assert!((point.dist + 0.02).abs() < 1e-5, "{}", point.dist);
    }

    #[test]
    fn a_capsule_whose_axis_ends_on_a_face_has_its_normal() {
        let cube = Convex::shared(&Form::Box { half_sizes: [0.1; 3] }, &Pose::IDENTITY);
        for step in 0..30 {
            let (sine, cosine) = libm::sincosf(0.05 * step as f32 - 0.7);
            let start = Vector::new(0.1, 0.0, 0.0);
            let capsule =
                SharedShape::capsule(start, start + 0.3 * Vector::new(cosine, 0.0, sine), 0.03);
            let mut manifold = ContactManifold::<(), ()>::new();
            let found = DefaultQueryDispatcher.contact_manifold_convex_convex(
                &Pose::IDENTITY,
                &*cube,
                &*capsule,
                None,
                None,
                0.0,
                &mut manifold,
            );
            assert!(found.is_ok());
            sharpen([&*cube, &*capsule], &Pose::IDENTITY, 0.0, &mut manifold);
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
