//! The point of a convex shape's surface that is nearest to a point. The engine finds it roughly, as its tolerances are lengths.

use rapier3d::glamx::DVec3;
use rapier3d::math::Vector;
use rapier3d::parry::query::details::local_point_projection_on_support_map;
use rapier3d::parry::query::gjk::VoronoiSimplex;
use rapier3d::parry::query::{PointProjection, PointQuery};
use rapier3d::parry::shape::{FeatureId, SupportMap as _};

use super::{Convex, Form};

/// Difference of two equal distances, as a fraction.
const SAME: f32 = 1e-5;
/// Triangles of the faces of a prism: the three corners of its lower face are followed by those of its upper one.
const PRISM: [[u32; 3]; 8] =
    [[0, 1, 2], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]];

/// Whether a point is inside a cylinder, and the nearest point of its surface.
fn on_cylinder([half, radius]: [f32; 2], point: Vector) -> (bool, Vector) {
    let aside = (point.x * point.x + point.y * point.y).sqrt();
    let [x, y] = if aside > 0.0 { [point.x / aside, point.y / aside] } else { [1.0, 0.0] };
    let at = |aside: f32, z: f32| Vector::new(x * aside, y * aside, z);
    let is_inside = aside < radius && point.z.abs() < half;
    if !is_inside {
        return (false, at(aside.min(radius), point.z.clamp(-half, half)));
    }
    let is_nearer_end = half - point.z.abs() < radius - aside;
    (true, if is_nearer_end { at(aside, half.copysign(point.z)) } else { at(radius, point.z) })
}

/// Bisections that find the nearest point of an ellipsoid in double precision.
const BISECTIONS: usize = 60;

/// Whether a point is inside an ellipsoid, and the nearest point of its surface: `x = a^2 p / (a^2 + t)` along each axis, with
/// the `t` at which it is on the surface.
fn on_ellipsoid(half: [f32; 3], point: [f32; 3]) -> (bool, Vector) {
    let squares = half.map(|a| f64::from(a) * f64::from(a));
    let p = point.map(f64::from);
    let place = |t: f64| -> [f64; 3] {
        // At the centre, both are 0.
        let part = |axis: usize| squares[axis] * p[axis] / (squares[axis] + t);
        std::array::from_fn(|axis| if p[axis] == 0.0 { 0.0 } else { part(axis) })
    };
    let level = |x: [f64; 3]| (0..3).map(|axis| x[axis] * x[axis] / squares[axis]).sum::<f64>();
    let least = squares.iter().copied().fold(f64::INFINITY, f64::min);
    let reach = (0..3).map(|axis| squares[axis] * p[axis] * p[axis]).sum::<f64>().sqrt();
    let (mut low, mut high) = (-least, reach - least);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if level(place(middle)) > 1.0 { low = middle } else { high = middle }
    }
    let mut nearest = place(high);
    // From the plane across the shortest axis, the nearest point may be on either side of it.
    let missing = 1.0 - level(nearest);
    if let Some(axis) = (0..3).find(|axis| squares[*axis] == least).filter(|_| missing > 1e-9) {
        nearest[axis] = (nearest[axis] * nearest[axis] + missing * least).sqrt().copysign(p[axis]);
    }
    (level(p) < 1.0, Vector::from_array(nearest.map(|x| x as f32)))
}

/// Whether a point is inside a box, and the nearest point of its surface.
fn on_box(half: Vector, point: Vector) -> (bool, Vector) {
    let nearest = point.clamp(-half, half);
    if nearest != point {
        return (false, nearest);
    }
    let depths = (half - point.abs()).to_array();
    let axis = (1..3).fold(0, |best, axis| if depths[axis] < depths[best] { axis } else { best });
    let mut nearest = point.to_array();
    nearest[axis] = half.to_array()[axis].copysign(nearest[axis]);
    (true, Vector::from_array(nearest))
}

/// Whether a point is inside a polyhedron with these corners and triangles, and the nearest point of its surface.
fn on_polyhedron(corners: &[[f32; 3]], triangles: &[[u32; 3]], point: Vector) -> (bool, Vector) {
    let corner = |index: usize| Vector::from_array(corners[index]).as_dvec3();
    let middle = (0..corners.len()).map(corner).sum::<DVec3>() / corners.len() as f64;
    let point = point.as_dvec3();
    let mut nearest = (DVec3::ZERO, f64::INFINITY);
    let mut highest = (DVec3::ZERO, f64::NEG_INFINITY);
    for triangle in triangles {
        let [a, b, c] = triangle.map(|index| corner(index as usize));
        let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
        let outward = if normal.dot(a - middle) < 0.0 { -normal } else { normal };
        let height = (point - a).dot(outward);
        if height > highest.1 {
            highest = (point - height * outward, height);
        }
        if height > 0.0 {
            let place = on_triangle([a, b, c], point);
            let apart = (place - point).length_squared();
            if apart < nearest.1 {
                nearest = (place, apart);
            }
        }
    }
    let is_inside = highest.1 <= 0.0;
    (is_inside, if is_inside { highest.0 } else { nearest.0 }.as_vec3())
}

/// The nearest point of a triangle (Ericson, Real-Time Collision Detection, section 5.1.5).
fn on_triangle([a, b, c]: [DVec3; 3], point: DVec3) -> DVec3 {
    let (right, up) = (b - a, c - a);
    let from = |start: DVec3| [right.dot(point - start), up.dot(point - start)];
    let [[d1, d2], [d3, d4], [d5, d6]] = [a, b, c].map(from);
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    if d1 <= 0.0 && d2 <= 0.0 {
        a
    } else if d3 >= 0.0 && d4 <= d3 {
        b
    } else if d6 >= 0.0 && d5 <= d6 {
        c
    } else if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        a + right * (d1 / (d1 - d3))
    } else if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        a + up * (d2 / (d2 - d6))
    } else if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
    } else {
        a + (right * vb + up * vc) / (va + vb + vc)
    }
}

impl Convex {
    /// Whether a point outside is as near to a point of the surface as to the whole shape, which is then beyond a plane through
    /// that point.
    fn is_nearest(&self, found: Vector, point: Vector) -> bool {
        let apart = (point - found).length();
        let along = (point - found) / apart;
        let excess = (self.local_support_point(along) - found).dot(along);
        apart > 0.0 && excess <= SAME * apart
    }

    /// The engine's nearest point of a box, hull or prism if it is right, else the exact one.
    fn nearest_on_faces(&self, point: Vector) -> PointProjection {
        let mut simplex = VoronoiSimplex::new();
        let found = local_point_projection_on_support_map(self, &mut simplex, point, false);
        if !found.is_inside && self.is_nearest(found.point, point) {
            return found;
        }
        let inside = self.pose.inverse_transform_point(point);
        let (is_inside, nearest) = match &self.form {
            Form::Box(half) => on_box(*half, inside),
            Form::Hull(hull, _) => on_polyhedron(&hull.points, &hull.triangles, inside),
            Form::Prism(corners) => on_polyhedron(corners, &PRISM, inside),
            Form::Cylinder(sizes) => on_cylinder(*sizes, inside),
            Form::Ellipsoid(half) => on_ellipsoid(half.to_array(), inside.to_array()),
        };
        let nearest = self.pose * nearest;
        let apart = (nearest - point).length();
        let is_right =
            found.is_inside == is_inside && (found.point - nearest).length() <= SAME * apart;
        if is_right { found } else { PointProjection::new(is_inside, nearest) }
    }
}

impl PointQuery for Convex {
    fn project_local_point(&self, point: Vector, solid: bool) -> PointProjection {
        let inside = self.pose.inverse_transform_point(point);
        let nearest = match &self.form {
            Form::Cylinder(sizes) => Some(on_cylinder(*sizes, inside)),
            Form::Ellipsoid(half) => Some(on_ellipsoid(half.to_array(), inside.to_array())),
            Form::Box(_) | Form::Hull(..) | Form::Prism(_) => None,
        };
        let found = match nearest {
            Some((is_inside, nearest)) => PointProjection::new(is_inside, self.pose * nearest),
            None => self.nearest_on_faces(point),
        };
        if found.is_inside && solid { PointProjection::new(true, point) } else { found }
    }

    fn project_local_point_and_get_feature(&self, point: Vector) -> (PointProjection, FeatureId) {
        (self.project_local_point(point, false), FeatureId::Unknown)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rapier3d::math::Pose;

    use super::*;
    use crate::scene::{Hull, Shape};

    /// The corners and triangles of a box with a low pyramid on it.
    fn hull(scale: f32) -> Hull {
        let corner = |i: usize| [0, 1, 2].map(|k| [0.03, 0.02, 0.005][k] * [-1.0, 1.0][i >> k & 1]);
        let mut points: Vec<[f32; 3]> = (0..8).map(corner).collect();
        points.push([0.0, 0.0, 0.007]);
        let points = points.into_iter().map(|point| point.map(|x| x * scale)).collect();
        let faces = [[0, 2, 3, 1], [0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6]];
        let mut triangles: Vec<[u32; 3]> =
            faces.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        triangles.extend([[4, 5, 8], [5, 7, 8], [7, 6, 8], [6, 4, 8]]);
        Hull { points, triangles }
    }

    /// Points beside, above and below the shape, at and between its edges. A point of the surface is nearest if the whole
    /// shape is beyond the plane through it.
    #[test]
    fn the_nearest_point_of_a_box_or_hull_of_any_size_supports_it() {
        for scale in [0.1, 0.3, 1.0, 3.0, 30.0] {
            let half_sizes = [0.03, 0.02, 0.005].map(|half| half * scale);
            for shape in [Shape::Hull(Arc::new(hull(scale))), Shape::Box { half_sizes }] {
                let convex = Convex::new(&shape, &Pose::IDENTITY).unwrap();
                for index in 0..1000 {
                    let place = [index % 10, index / 10 % 10, index / 100];
                    let part = place.map(|step| step as f32 / 4.5 - 1.0);
                    let point = Vector::new(0.035 * part[0], 0.025 * part[1], 0.012 * part[2]);
                    let point = point * scale;
                    let found = convex.project_local_point(point, false);
                    let apart = (point - found.point).length();
                    let outward =
                        if found.is_inside { found.point - point } else { point - found.point };
                    let along = outward / apart;
                    let excess = (convex.local_support_point(along) - found.point).dot(along);
                    assert!(excess < 2.0 * SAME * 0.04 * scale, "{scale} {point}: {excess}");
                }
            }
        }
    }
}
