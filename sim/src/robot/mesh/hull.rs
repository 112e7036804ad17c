//! The convex hull of points.

use std::collections::BTreeMap;

use parry3d_f64::math::Vector;
use parry3d_f64::transformation::try_convex_hull;

use crate::scene::Hull;

/// Share of the points' variance below which they are flat: a thickness of a millionth of their size.
const FLAT: f64 = 1e-12;
/// Distance from a face beyond which a point is outside, in standard deviations of the points.
const OUTSIDE: f64 = 1e-6;
/// Twice the area of the smallest face that has a normal, in the same unit.
const SMALLEST: f64 = 1e-9;
/// Most pairs of a face and a point that are compared.
const MOST_COMPARED: usize = 1 << 22;
/// Most orientations in which a hull is computed.
const TRIES: usize = 8;

/// Why points have no convex hull.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NoHull {
    /// They do not span a volume.
    Flat,
    /// The one that was computed does not contain them.
    Wrong,
}

/// The convex hull of distinct points, in metres. It is computed where the points have a standard deviation of one in every direction, so
/// that thin and slender shapes have as many digits as others, and checked. Where many points are on one plane, rounding errors make it
/// wrong in a few orientations.
pub(super) fn convex_hull(points: &[[f32; 3]]) -> Result<Hull, NoHull> {
    let mut scaled = whitened(points).ok_or(NoHull::Flat)?;
    for _ in 0..TRIES {
        let found = try_convex_hull(&scaled).ok();
        let right = found.filter(|(corners, triangles)| is_convex(corners, triangles, &scaled));
        if let Some((corners, triangles)) = right {
            let bits = |point: &Vector| point.to_array().map(f64::to_bits);
            let known: BTreeMap<[u64; 3], [f32; 3]> =
                scaled.iter().map(bits).zip(points.iter().copied()).collect();
            let points = corners.iter().map(|corner| known[&bits(corner)]).collect();
            return Ok(Hull { points, triangles });
        }
        scaled.iter_mut().for_each(|point| *point = turned(*point));
    }
    Err(NoHull::Wrong)
}

/// The point after a rotation about z, then about x, with the sine 0.8.
fn turned(Vector { x, y, z }: Vector) -> Vector {
    let [x, y] = [0.6 * x - 0.8 * y, 0.8 * x + 0.6 * y];
    Vector::new(x, 0.6 * y - 0.8 * z, 0.8 * y + 0.6 * z)
}

/// `L^-1 (p - mean)` with `L L^T` the covariance of the points: affine, so hulls stay hulls. `None` if they are flat.
fn whitened(points: &[[f32; 3]]) -> Option<Vec<Vector>> {
    let count = points.len() as f64;
    let exact = || points.iter().map(|point| Vector::from_array(point.map(f64::from)));
    let mean = exact().sum::<Vector>() / count;
    let covariance = |row: usize, column: usize| {
        exact().map(|point| (point - mean)[row] * (point - mean)[column]).sum::<f64>() / count
    };
    let least = FLAT * (covariance(0, 0) + covariance(1, 1) + covariance(2, 2));
    let pivot = |square: f64| (square > least).then(|| square.sqrt());
    let l00 = pivot(covariance(0, 0))?;
    let [l10, l20] = [covariance(1, 0) / l00, covariance(2, 0) / l00];
    let l11 = pivot(covariance(1, 1) - l10 * l10)?;
    let l21 = (covariance(2, 1) - l20 * l10) / l11;
    let l22 = pivot(covariance(2, 2) - l20 * l20 - l21 * l21)?;
    let scaled = |point: Vector| {
        let from = point - mean;
        let x = from.x / l00;
        let y = (from.y - l10 * x) / l11;
        Vector::new(x, y, (from.z - l20 * x - l21 * y) / l22)
    };
    Some(exact().map(scaled).collect())
}

/// Whether the triangles are closed, and neither the next triangles nor, unless they are too many, any points are outside one.
fn is_convex(corners: &[Vector], triangles: &[[u32; 3]], points: &[Vector]) -> bool {
    let edges = |[a, b, c]: &[u32; 3]| [([*a, *b], *c), ([*b, *c], *a), ([*c, *a], *b)];
    let third: BTreeMap<[u32; 2], u32> = triangles.iter().flat_map(edges).collect();
    let corner = |index: u32| corners[index as usize];
    let holds = |triangle: &[u32; 3], point: Vector| {
        let [a, b, c] = triangle.map(corner);
        let normal = (b - a).cross(c - a);
        (point - a).dot(normal) <= OUTSIDE * normal.length().max(SMALLEST)
    };
    let beside = |([from, to], _): ([u32; 2], u32)| third.get(&[to, from]).copied().map(corner);
    let is_bent = |triangle: &[u32; 3]| {
        edges(triangle)
            .into_iter()
            .all(|edge| beside(edge).is_some_and(|next| holds(triangle, next)))
    };
    let are_few = triangles.len().saturating_mul(points.len()) <= MOST_COMPARED;
    third.len() == 3 * triangles.len()
        && triangles.iter().all(is_bent)
        && (!are_few || triangles.iter().all(|own| points.iter().all(|point| holds(own, *point))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotated(point: [f64; 3], angles: [f64; 2]) -> [f32; 3] {
        let turn = |[x, y]: [f64; 2], angle: f64| {
            let (sine, cosine) = libm::sincos(angle);
            [x * cosine - y * sine, x * sine + y * cosine]
        };
        let [x, y] = turn([point[0], point[1]], angles[0]);
        let [y, z] = turn([y, point[2]], angles[1]);
        [x, y, z].map(|x| x as f32)
    }

    fn volume(hull: &Hull) -> f64 {
        let corner = |index: u32| Vector::from_array(hull.points[index as usize].map(f64::from));
        let apex = corner(0);
        let signed = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|index| corner(index) - apex);
            a.dot(b.cross(c)) / 6.0
        };
        hull.triangles.iter().map(signed).sum()
    }

    /// Cylinders of `sides` sides and `rings` rings of points in 40 orientations.
    #[test]
    fn rings_of_points_between_the_ends_of_a_cylinder_do_not_change_its_hull() {
        for (sides, rings) in [(20, 6), (100, 20), (7, 3)] {
            let angle = std::f64::consts::TAU / f64::from(sides);
            let expected = 0.5 * f64::from(sides) * libm::sin(angle) * 0.04 * 0.5;
            for turn in 0..40 {
                let angles = [0.37 * f64::from(turn), 0.91 * f64::from(turn)];
                let points: Vec<[f32; 3]> = (0..sides * rings)
                    .map(|index| {
                        let (side, ring) = (f64::from(index % sides), f64::from(index / sides));
                        let (sine, cosine) = libm::sincos(angle * side);
                        let height = 0.5 * ring / f64::from(rings - 1);
                        rotated([0.2 * cosine, 0.2 * sine, height], angles)
                    })
                    .collect();
                let hull = convex_hull(&points).unwrap();
                let found = volume(&hull);
                assert!((found / expected - 1.0).abs() < 1e-5, "{sides} {rings} {turn}: {found}");
            }
        }
    }

    #[test]
    fn thin_and_slender_boxes_have_their_volume_and_a_plane_none() {
        for sizes in [[2.0, 2.0, 1e-3], [2.0, 2.0, 1e-5], [1e-3, 1e-3, 4.0], [1.0, 2.0, 3.0]] {
            for turn in 0..10 {
                let angles = [0.5 * f64::from(turn), 0.3 * f64::from(turn)];
                let corner = |index: usize| {
                    let side = |axis: usize| if index >> axis & 1 == 1 { sizes[axis] } else { 0.0 };
                    rotated([side(0), side(1), side(2)], angles)
                };
                let points: Vec<[f32; 3]> = (0..8).map(corner).collect();
                let found = volume(&convex_hull(&points).unwrap());
                let expected = sizes[0] * sizes[1] * sizes[2];
                // Single precision leaves fewer digits of a thin side.
                let digits = 1e-6 * 3.0 / sizes.iter().fold(f64::INFINITY, |a, b| a.min(*b));
                assert!((found / expected - 1.0).abs() < digits.max(1e-5), "{sizes:?}: {found}");
                let flat: Vec<[f32; 3]> = (0..4)
                    .map(|i| rotated([f64::from(i & 1), f64::from(i >> 1), 0.0], angles))
                    .collect();
                assert_eq!(convex_hull(&flat), Err(NoHull::Flat));
            }
        }
    }
}
