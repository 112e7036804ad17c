//! The contact of two convex shapes. The engine's tolerances are lengths, so that it finds contacts of small shapes roughly or
//! not at all. Where its result is not right, the engine computes the contact again with lengths in units of about the size of the
//! smaller shape; if that is not right either, a search finds the normal.

use rapier3d::glamx::{DMat2, DVec2};
use rapier3d::math::{Pose, Vector};
use rapier3d::parry::query::details::contact_manifold_pfm_pfm;
use rapier3d::parry::query::{ContactManifold, TrackedContact};
use rapier3d::parry::shape::{
    PackedFeatureId, PolygonalFeature, PolygonalFeatureMap, Segment, Shape, SupportMap,
};

use super::segments::nearest;

/// Tangent of the largest angle between the first guess and the normal.
const FARTHEST: f64 = 1.0;
/// Steps of the search for a normal. Each keeps 0.77 of the area in which it is; all of them 6e-11.
const STEPS: usize = 90;
/// Distances that differ less are equal, as a fraction of the size of the smaller shape.
const ROUNDING: f32 = 1e-5;
/// Error of a distance with which the engine's contact is right, as a fraction of the size of the smaller shape.
const RIGHT: f32 = 1e-4;
/// Size of the smaller shape, m, from which the engine's tolerances are small beside it: its contacts stay as they are.
const LARGE: f32 = 0.1;
/// Depth beyond which the engine's contact is not trusted, as a fraction of the size of the smaller shape.
const DEEP: f32 = 0.2;
/// Change of a normal that shows the edges of a shape, rad.
const TILT: f32 = 3e-4;
/// Shortest edge that another one can cross, as a fraction of the smaller shape's size: longer than where a round shape touches.
const EDGE: f32 = 0.03;

/// A convex shape, of a capsule its axis, about a centre and with lengths in a unit of `1 / scale` m.
struct Part<'a> {
    map: &'a dyn PolygonalFeatureMap,
    centre: Vector,
    /// Middle of the shape's bounds about the centre.
    middle: Vector,
    scale: f32,
    /// Radius of a capsule, else 0, and half the diagonal of the shape's bounds, in the unit.
    radius: f32,
    size: f32,
}

/// Two convex shapes.
pub(super) struct Pair<'a> {
    parts: [Part<'a>; 2],
    /// Pose of the second shape in the frame of the first.
    between: Pose,
}

impl Part<'_> {
    /// A place in the shape's frame about the centre, in the unit.
    fn scaled(&self, place: Vector) -> Vector {
        (place - self.centre) * self.scale
    }

    /// The place in the shape's frame, m.
    fn unscaled(&self, place: Vector) -> Vector {
        place / self.scale + self.centre
    }
}

impl SupportMap for Part<'_> {
    fn local_support_point(&self, along: Vector) -> Vector {
        self.scaled(self.map.local_support_point(along))
    }
}

impl PolygonalFeatureMap for Part<'_> {
    fn local_support_feature(&self, along: Vector, feature: &mut PolygonalFeature) {
        self.map.local_support_feature(along, feature);
        for vertex in &mut feature.vertices[..feature.num_vertices] {
            *vertex = self.scaled(*vertex);
        }
    }
}

impl<'a> Pair<'a> {
    /// Two shapes with lengths in metres; `None` if one has no corners, as a ball.
    pub(super) fn new(shapes: [&'a dyn Shape; 2], between: &Pose) -> Option<Self> {
        let part = |shape: &'a dyn Shape| {
            let (map, radius) = shape.as_polygonal_feature_map()?;
            let bounds = shape.compute_local_aabb();
            let (middle, size) = (bounds.center(), bounds.half_extents().length());
            Some(Part { map, centre: Vector::ZERO, middle, scale: 1.0, radius, size })
        };
        let [one, other] = shapes;
        Some(Self { parts: [part(one)?, part(other)?], between: *between })
    }

    /// The same shapes about the centres of their bounds, with lengths in units of the smaller one's size or up to half of it:
    /// a power of two, so that scaling rounds nothing.
    fn in_units(shapes: [&'a dyn Shape; 2], between: &Pose) -> Option<Self> {
        let mut pair = Self::new(shapes, between)?;
        let size = Some(pair.size()).filter(|size| size.is_normal())?;
        let scale = libm::scalbnf(1.0, -libm::ilogbf(size));
        for part in &mut pair.parts {
            (part.centre, part.middle) = (part.middle, Vector::ZERO);
            (part.scale, part.radius, part.size) = (scale, part.radius * scale, part.size * scale);
        }
        let [one, other] = &pair.parts;
        pair.between.translation = one.scaled(*between * other.centre);
        Some(pair)
    }

    /// Size of the smaller shape.
    fn size(&self) -> f32 {
        self.parts[0].size.min(self.parts[1].size)
    }

    fn radii(&self) -> f32 {
        self.parts[0].radius + self.parts[1].radius
    }

    /// The farthest point of the first shape along a direction, and that of the second against it.
    fn ends(&self, along: Vector) -> [Vector; 2] {
        let [one, other] = &self.parts;
        let against = self.between.rotation.inverse() * -along;
        [one.local_support_point(along), self.between * other.local_support_point(against)]
    }

    /// Distance along a direction; negative if the shapes overlap.
    fn distance(&self, along: Vector) -> f32 {
        let [one, other] = self.ends(along);
        (other - one).dot(along) - self.radii()
    }

    /// The direction from the middle of the first shape to that of the second.
    fn towards(&self) -> Vector {
        let [one, other] = &self.parts;
        (self.between * other.middle - one.middle).normalize_or(Vector::X)
    }

    /// Whether the engine's contact, or that there is none, is right: its deepest points are the ends of the shapes along its
    /// normal, or the shapes are farther apart along it than `margin`. Large shapes have the engine's contact unchecked.
    pub(super) fn is_right(&self, manifold: &ContactManifold<(), ()>, margin: f32) -> bool {
        let normal = manifold.local_n1;
        let is_large = self.size() >= LARGE * self.parts[0].scale;
        let Some(deepest) = manifold.points.last() else {
            return normal != Vector::ZERO && (is_large || self.distance(normal) >= margin);
        };
        let apart = deepest.dist + self.radii();
        // The engine has no normal where the axis of a capsule just touches a shape.
        if self.radii() > 0.0 && apart.abs() < ROUNDING * self.size() {
            return false;
        }
        if is_large {
            return true;
        }
        // The engine's normal may be that of the far side, which a deep contact shows.
        let beyond = self.distance(self.towards()) - deepest.dist;
        let is_deep = deepest.dist < -DEEP * self.size();
        let line = self.between * deepest.local_p2 - deepest.local_p1 - normal * deepest.dist;
        let error = (self.distance(normal) - deepest.dist).abs().max(line.length());
        !is_deep && beyond.max(error) <= RIGHT * self.size()
    }

    /// Finds the contact of two shapes anew; of round ones the engine's normal is only a guess.
    pub(super) fn find(
        shapes: [&'a dyn Shape; 2],
        between: &Pose,
        (margin, is_round): (f32, bool),
        manifold: &mut ContactManifold<(), ()>,
    ) {
        let Some(pair) = Self::in_units(shapes, between) else { return };
        let [one, other] = &pair.parts;
        let margin = margin * one.scale;
        let rough = manifold.local_n1;
        *manifold = ContactManifold::new();
        contact_manifold_pfm_pfm(
            &pair.between,
            one,
            one.radius,
            None,
            other,
            other.radius,
            None,
            margin,
            manifold,
        );
        if is_round || !pair.is_right(manifold, margin) {
            manifold.points.clear();
            let normal = pair.normal([manifold.local_n1, rough, pair.towards()]);
            if let Some(normal) = normal.filter(|it| pair.distance(*it) < margin) {
                pair.touch(normal, manifold);
            }
        }
        for point in &mut manifold.points {
            point.local_p1 = one.unscaled(point.local_p1);
            point.local_p2 = other.unscaled(point.local_p2);
            point.dist /= one.scale;
        }
    }

    /// The direction near one of the guesses along which the distance is largest: the normal of the contact.
    fn normal(&self, guesses: [Vector; 3]) -> Option<Vector> {
        let starts = guesses.into_iter().filter_map(Vector::try_normalize);
        // The engine has the normals of faces exactly.
        let ends = starts.flat_map(|start| [self.climb(start), start]);
        ends.reduce(|best, next| {
            let gain = self.distance(next) - self.distance(best);
            if gain > ROUNDING * self.size() { next } else { best }
        })
    }

    /// The direction near another one along which the distance is largest. As the distance is nearly concave in it, an ellipse
    /// in which it is shrinks by the half in which it is not (the ellipsoid method).
    fn climb(&self, start: Vector) -> Vector {
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
        at(centre).normalize()
    }

    /// Sets the points of a contact with this normal: those in which the farthest faces and edges meet, then the deepest.
    fn touch(&self, normal: Vector, manifold: &mut ContactManifold<(), ()>) {
        let inside = self.between.rotation.inverse() * -normal;
        (manifold.local_n1, manifold.local_n2) = (normal, inside);
        let mut features = [PolygonalFeature::default(), PolygonalFeature::default()];
        for ((feature, part), along) in features.iter_mut().zip(&self.parts).zip([normal, inside]) {
            part.local_support_feature(along, feature);
        }
        let [first, second] = &features;
        let back = self.between.inverse();
        PolygonalFeature::contacts(
            &self.between,
            &back,
            normal,
            inside,
            first,
            second,
            manifold,
            false,
        );
        let apart = self.distance(normal) + self.radii();
        let [one, other] = self.ends(normal);
        let edges = [0, 1].map(|shape| self.edge(normal, shape));
        let lengths = [edges[0].length(), edges[1].length()];
        let is_long = |shape: usize| lengths[shape] > EDGE * self.size();
        // Of a face only some line is known, which does not count.
        let deepest = if is_long(0) && is_long(1) {
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
            point.local_p1 += normal * self.parts[0].radius;
            point.local_p2 += inside * self.parts[1].radius;
            point.dist -= self.radii();
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
mod tests;
