//! Contacts of capsules: the nearest points of their axes. The engine takes short axes for parallel, as it compares the product
//! of their squared lengths with an absolute value, in m^4.

use rapier3d::glamx::DVec3;
use rapier3d::math::{Pose, Vector};
use rapier3d::parry::query::{ContactManifold, TrackedContact};
use rapier3d::parry::shape::{Capsule, PackedFeatureId, Segment};

use super::points::Manifolds;

/// Square of the sine of an angle below which two segments are taken as parallel: their ends are rounded to single precision.
const PARALLEL: f64 = 1e-12;
/// Square of the sine of an angle up to which two capsules may touch in two points, in MuJoCo 4.0.0.
const TOUCH_TWICE: f64 = 1e-8;
/// Difference of two equal distances, as a fraction.
const SAME_DISTANCE: f32 = 1e-5;
/// Distance of two equal places, as a fraction of the length of both axes.
const SAME_PLACE: f32 = 1e-3;

/// The points of two segments that are nearest to each other. Of parallel segments, the start of the first has priority.
pub(super) fn nearest(one: &Segment, other: &Segment) -> [Vector; 2] {
    let [[a, b], [c, d]] = [one, other].map(|line| [line.a.as_dvec3(), line.b.as_dvec3()]);
    let (first, second, apart) = (b - a, d - c, a - c);
    let squares = [first.length_squared(), second.length_squared()];
    let along = first.dot(second);
    let sides = [first.dot(apart), second.dot(apart)];
    // The fraction of a segment at which a point is nearest to a place of the other.
    let on_first = |t: f64| fraction(along * t - sides[0], squares[0]);
    let on_second = |s: f64| fraction(along * s + sides[1], squares[1]);
    let across = squares[0] * squares[1] - along * along;
    let crossing = if across > PARALLEL * squares[0] * squares[1] {
        fraction(along * sides[1] - sides[0] * squares[1], across)
    } else {
        0.0
    };
    let t = on_second(crossing);
    let s = on_first(t);
    let at = |start: DVec3, line: DVec3, part: f64| (start + line * part).as_vec3();
    [at(a, first, s), at(c, second, t)]
}

fn fraction(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { (part / whole).clamp(0.0, 1.0) } else { 0.0 }
}

/// Finds the contacts of two capsules as in MuJoCo: up to two of parallel ones, one of others, which is the engine's if it is right.
pub(super) fn touch_capsules(
    [one, other]: [&Capsule; 2],
    between: &Pose,
    margin: f32,
    manifolds: &mut Manifolds,
) {
    let (first, second) = (one.segment, other.segment.transformed(between));
    let radii = [one.radius, other.radius];
    let contact = |points| touch_balls(points, radii, between, margin);
    if are_parallel(&first, &second) {
        manifolds.clear();
        manifolds.extend(parallel_ends(&first, &second).into_iter().filter_map(contact));
        return;
    }
    let points = nearest(&first, &second);
    let apart = (points[1] - points[0]).length();
    let lengths = first.length() + second.length();
    let found = manifolds.first().and_then(|found| Some((found.local_n1, found.points.first()?)));
    let is_right = match found {
        Some((normal, found)) => {
            let place = found.local_p1 - normal * one.radius;
            (found.dist + one.radius + other.radius - apart).abs() <= SAME_DISTANCE * apart
                && (place - points[0]).length() <= SAME_PLACE * lengths
        }
        None => false,
    };
    if !is_right {
        manifolds.clear();
        manifolds.extend(contact(points));
    }
}

/// The nearest points of two parallel axes at both ends of the part in which they are beside each other, the end of the first axis
/// first; twice those of the nearest ends if there is no such part.
fn parallel_ends(first: &Segment, second: &Segment) -> [[Vector; 2]; 2] {
    let axis = (first.b - first.a).as_dvec3();
    // Single precision may round a short axis to a point.
    if axis.length_squared() == 0.0 {
        return [nearest(first, second); 2];
    }
    let along = |end: Vector| (end - first.a).as_dvec3().dot(axis) / axis.length_squared();
    let mut ends = [second.a, second.b];
    if along(ends[0]) > along(ends[1]) {
        ends.swap(0, 1);
    }
    let [low, high] = ends;
    let of_first = |end: Vector| [end, nearest(&point(end), second)[1]];
    let of_second = |end: Vector| [nearest(first, &point(end))[0], end];
    let upper = if along(high) >= 1.0 { of_first(first.b) } else { of_second(high) };
    let lower = if along(low) <= 0.0 { of_first(first.a) } else { of_second(low) };
    match (along(low) > 1.0, along(high) < 0.0) {
        (true, _) => [upper; 2],
        (_, true) => [lower; 2],
        _ => [upper, lower],
    }
}

/// Whether two axes are parallel, as in MuJoCo.
fn are_parallel(one: &Segment, other: &Segment) -> bool {
    let [first, second] = [one, other].map(|line| (line.b - line.a).as_dvec3());
    let squares = first.length_squared() * second.length_squared();
    let along = first.dot(second);
    squares - along * along <= TOUCH_TWICE * squares
}

fn point(place: Vector) -> Segment {
    Segment::new(place, place)
}

/// The contact of two balls with these centres, in the frame of the first shape.
fn touch_balls(
    [from, to]: [Vector; 2],
    radii: [f32; 2],
    between: &Pose,
    margin: f32,
) -> Option<ContactManifold<(), ()>> {
    let apart = (to - from).length();
    let depth = apart - radii[0] - radii[1];
    if depth > margin {
        return None;
    }
    let mut manifold = ContactManifold::new();
    let normal = (to - from).normalize_or(Vector::Y);
    let inside = between.rotation.inverse() * -normal;
    (manifold.local_n1, manifold.local_n2) = (normal, inside);
    let side = PackedFeatureId::face(0);
    manifold.points.push(TrackedContact::new(
        from + normal * radii[0],
        between.inverse_transform_point(to) + inside * radii[1],
        side,
        side,
        depth,
    ));
    Some(manifold)
}

#[cfg(test)]
mod tests {
    use rapier3d::math::Rotation;
    use rapier3d::parry::query::{DefaultQueryDispatcher, PersistentQueryDispatcher as _};

    use super::*;

    /// Two capsules of half length 1, times a scale, are `DEEP` in each other where their axes cross.
    const RADIUS: f32 = 0.4;
    const DEEP: f32 = 0.01;

    #[test]
    fn crossed_capsules_of_all_sizes_touch_where_their_axes_cross() {
        for scale in [0.003, 0.01, 0.1, 1.0] {
            for angle in [0.3_f32, 1.0, 5.0, 30.0, 60.0, 90.0] {
                for shift in [-0.5, 0.2, 0.9] {
                    let half = Vector::Z * scale;
                    let capsule = Capsule::new(-half, half, RADIUS * scale);
                    let turn = Rotation::from_rotation_x(angle.to_radians());
                    // The middle of the second axis crosses the first one at `shift`.
                    let apart = Vector::new(2.0 * RADIUS - DEEP, 0.0, shift) * scale;
                    let between = Pose::from_parts(apart, turn);
                    let mut manifolds = Vec::new();
                    let found = DefaultQueryDispatcher.contact_manifolds(
                        &between,
                        &capsule,
                        &capsule,
                        0.0,
                        &mut manifolds,
                        &mut None,
                    );
                    assert!(found.is_ok());
                    touch_capsules([&capsule, &capsule], &between, 0.0, &mut manifolds);
                    let case = format!("{scale} m, {angle} degrees, at {shift}");
                    let [manifold] = &manifolds[..] else { panic!("{case}: no contact") };
                    let point = &manifold.points[0];
                    let place = Vector::new(RADIUS, 0.0, shift) * scale;
                    assert!((manifold.local_n1 - Vector::X).length() < 1e-3, "{case}");
                    assert!((point.dist / scale + DEEP).abs() < 1e-4, "{case}: {}", point.dist);
                    let off = (point.local_p1 - place).length() / scale;
                    assert!(off < 2.5e-3, "{case}: {off}");
                }
            }
        }
    }

    #[test]
    fn parallel_capsules_touch_where_they_begin_and_end_beside_each_other() {
        for scale in [0.003, 0.01, 0.1, 1.0] {
            let half = Vector::Z * scale;
            let capsule = Capsule::new(-half, half, RADIUS * scale);
            let between = Pose::from_translation(Vector::new(0.79, 0.0, 0.5) * scale);
            let mut manifolds = Vec::new();
            touch_capsules([&capsule, &capsule], &between, 0.0, &mut manifolds);
            let places = manifolds.iter().map(|manifold| manifold.points[0].local_p1 / scale);
            let expected = [[RADIUS, 0.0, 1.0], [RADIUS, 0.0, -0.5]].map(Vector::from_array);
            assert_eq!(manifolds.len(), 2, "{scale}");
            for (place, expected) in places.zip(expected) {
                assert!((place - expected).length() < 1e-5, "{scale}: {place}");
            }
        }
    }

    #[test]
    fn capsules_within_a_ten_thousandth_of_a_radian_of_parallel_touch_twice() {
        for (angle, count) in [(0.9e-4, 2), (1.2e-4, 1)] {
            let capsule = Capsule::new(-Vector::Z, Vector::Z, RADIUS);
            let turn = Rotation::from_rotation_x(angle);
            let between = Pose::from_parts(Vector::new(0.79, 0.0, 0.5), turn);
            let mut manifolds = Vec::new();
            touch_capsules([&capsule, &capsule], &between, 0.0, &mut manifolds);
            assert_eq!(manifolds.len(), count, "{angle}");
        }
    }

    #[test]
    fn the_nearest_points_of_segments_may_be_ends() {
        let line = |a: [f32; 3], b: [f32; 3]| Segment::new(Vector::from(a), Vector::from(b));
        let one = line([0.0; 3], [1.0, 0.0, 0.0]);
        for (other, expected) in [
            (line([2.0, 1.0, 0.0], [3.0, 4.0, 0.0]), [[1.0, 0.0, 0.0], [2.0, 1.0, 0.0]]),
            (line([0.5, 1.0, 0.0], [0.5, 3.0, 0.0]), [[0.5, 0.0, 0.0], [0.5, 1.0, 0.0]]),
            (line([-2.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), [[0.0; 3], [-1.0, 0.0, 1.0]]),
            (line([0.25, 0.0, 1.0], [0.25, 0.0, 1.0]), [[0.25, 0.0, 0.0], [0.25, 0.0, 1.0]]),
        ] {
            assert_eq!(nearest(&one, &other).map(|point| point.to_array()), expected);
        }
    }
}
