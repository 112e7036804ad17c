//! Collision shapes that rapier lacks or places otherwise: boxes, cylinders, ellipsoids and hulls in the frame of a link.
//!
//! They have no mass and no pose of their own, so the engine adds exactly nothing to a link's mass properties. Contacts
//! need the corners of the shape that are farthest in a direction: the support feature.

mod edges;
mod nearest;

use std::sync::Arc;

use rapier3d::math::{Pose, Vector};
use rapier3d::parry::bounding_volume::{Aabb, BoundingSphere};
use rapier3d::parry::query::{Ray, RayCast, RayIntersection};
use rapier3d::parry::shape::{
    PackedFeatureId, PolygonalFeature, PolygonalFeatureMap, Shape as RapierShape, ShapeType,
    SupportMap, TypedShape,
};
use rapier3d::prelude::{MassProperties, SharedShape};

use crate::scene::{Hull, Shape};

/// Tilt of a cylinder's end, as a sine, below which its contacts keep their places.
const LEVEL: f32 = 0.02;
/// Cosine of the angle to the normal of a face, 0.01 rad, up to which a face touches as a whole.
const ON_FACE: f32 = 0.99995;
/// Slope of an edge, 0.0016 as in MuJoCo, up to which both its ends touch.
const LEVEL_EDGE: f32 = 0.0016;
/// The sine of the angle of [`ON_FACE`].
const OFF_FACE: f32 = 0.01;

/// A convex shape in the frame of its link.
#[derive(Clone)]
pub(crate) struct Convex {
    form: Form,
    /// Pose of the form in the link.
    pose: Pose,
    bounds: Aabb,
}

/// Form and size, m.
#[derive(Clone)]
enum Form {
    Box(Vector),
    /// Half the length along z, and the radius.
    Cylinder([f32; 2]),
    Ellipsoid(Vector),
    /// Corners and size of a hull.
    Hull(Arc<Hull>, f32),
    /// Corners of a part of a height field.
    Prism([[f32; 3]; 6]),
}

impl Convex {
    /// A shape with the pose `pose` in its link; `None` for capsules and balls, which rapier has.
    pub(crate) fn new(shape: &Shape, pose: &Pose) -> Option<Self> {
        let form = match shape {
            Shape::Box { half_sizes } => Form::Box(Vector::from_array(*half_sizes)),
            Shape::Cylinder { half_length, radius } => Form::Cylinder([*half_length, *radius]),
            Shape::Ellipsoid { half_sizes } => Form::Ellipsoid(Vector::from_array(*half_sizes)),
            Shape::Hull(hull) => {
                let [low, high] = hull.bounds().map(Vector::from_array);
                Form::Hull(Arc::clone(hull), (high - low).length())
            }
            Shape::Capsule { .. } | Shape::Sphere { .. } => return None,
        };
        Some(Self::placed(form, *pose))
    }

    /// A prism with these corners.
    pub(crate) fn prism(corners: [[f32; 3]; 6]) -> Self {
        Self::placed(Form::Prism(corners), Pose::IDENTITY)
    }

    fn placed(form: Form, pose: Pose) -> Self {
        let mut convex = Self { form, pose, bounds: Aabb::new(Vector::ZERO, Vector::ZERO) };
        let end = |axis: Vector| convex.local_support_point(axis).dot(axis);
        let axes = [Vector::X, Vector::Y, Vector::Z];
        let [low, high] =
            [-1.0, 1.0].map(|sign| Vector::from_array(axes.map(|axis| sign * end(sign * axis))));
        convex.bounds = Aabb::new(low, high);
        convex
    }

    /// The shape of a collider with this pose in the collider's frame; a sphere's position is left to the collider.
    pub(crate) fn shared(shape: &Shape, pose: &Pose) -> SharedShape {
        if let Some(convex) = Self::new(shape, pose) {
            return SharedShape::new(convex);
        }
        match *shape {
            Shape::Capsule { half_length, radius } => {
                let half = pose.rotation * Vector::new(0.0, 0.0, half_length);
                SharedShape::capsule(pose.translation - half, pose.translation + half, radius)
            }
            Shape::Sphere { radius } => SharedShape::ball(radius),
            _ => unreachable!("all other shapes are convex"),
        }
    }

    /// Calls `add` with the corners of the feature farthest along `along`, in the form's frame, and their ids.
    fn corners(&self, along: Vector, mut add: impl FnMut(Vector, u32)) {
        match &self.form {
            Form::Box(half) => box_face(*half, along, add),
            Form::Cylinder(sizes) => cylinder_feature(*sizes, along, add),
            Form::Ellipsoid(half) => {
                let stretched = *half * along;
                add(*half * stretched / stretched.length(), 0);
            }
            Form::Hull(hull, size) => {
                let mut touching = within(&hull.points, LEVEL_EDGE * size, along);
                touching.extend(level_faces(hull, *size, along).flatten());
                touching.sort_unstable();
                touching.dedup();
                spread(&hull.points, &touching, along, add);
            }
            // Only its deepest point touches.
            Form::Prism(points) => add(farthest(points, along), 0),
        }
    }
}

/// The four corners of the face of a box that points most towards `along`.
fn box_face(half: Vector, along: Vector, mut add: impl FnMut(Vector, u32)) {
    let (along, half) = (along.to_array(), half.to_array());
    let mut face = 0;
    for axis in 1..3 {
        if along[axis].abs() > along[face].abs() {
            face = axis;
        }
    }
    let sides = [(face + 1) % 3, (face + 2) % 3];
    for signs in [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]] {
        let mut corner = [0.0; 3];
        corner[face] = half[face].copysign(along[face]);
        corner[sides[0]] = signs[0] * half[sides[0]];
        corner[sides[1]] = signs[1] * half[sides[1]];
        let id = (0..3).map(|axis| u32::from(corner[axis] > 0.0) << axis).sum();
        add(Vector::from_array(corner), id);
    }
}

/// Four points on the rim of an end, or the line along the side.
fn cylinder_feature([half, radius]: [f32; 2], along: Vector, mut add: impl FnMut(Vector, u32)) {
    let aside = (along.x * along.x + along.y * along.y).sqrt();
    let lying = along.z.abs() < 0.5;
    let level = aside < LEVEL * along.length();
    let [x, y] = if level { [1.0, 0.0] } else { [along.x / aside, along.y / aside] };
    let [x, y] = [radius * x, radius * y];
    if lying {
        add(Vector::new(x, y, half), 0);
        add(Vector::new(x, y, -half), 4);
        return;
    }
    let z = half.copysign(along.z);
    let first = if z > 0.0 { 0 } else { 4 };
    for (id, [x, y]) in (first..).zip([[x, y], [-y, x], [-x, -y], [y, -x]]) {
        add(Vector::new(x, y, z), id);
    }
}

/// The farthest of the corners of a hull, the first of several.
fn farthest(points: &[[f32; 3]], along: Vector) -> Vector {
    let mut best = (Vector::ZERO, f32::NEG_INFINITY);
    for point in points {
        let corner = Vector::from_array(*point);
        let height = corner.dot(along);
        if height > best.1 {
            best = (corner, height);
        }
    }
    best.0
}

/// The corners of a hull that are at most `band` below the farthest one along `along`, in the order of their indices.
fn within(points: &[[f32; 3]], band: f32, along: Vector) -> Vec<u32> {
    let height = |point: &[f32; 3]| Vector::from_array(*point).dot(along);
    let top = points.iter().map(height).fold(f32::NEG_INFINITY, f32::max);
    let lowest = top - band * along.length();
    let all = (0..).zip(points);
    all.filter(|(_, point)| height(point) >= lowest).map(|(index, _)| index).collect()
}

/// The triangles of a hull of this size whose normal is `along`, up to the angle of [`ON_FACE`].
fn level_faces(hull: &Hull, size: f32, along: Vector) -> impl Iterator<Item = [u32; 3]> {
    let along = along.normalize_or_zero();
    let corner = |index: u32| Vector::from_array(hull.points[index as usize]);
    let top = farthest(&hull.points, along).dot(along);
    // A level face reaches no farther below the farthest corner.
    let is_high = move |index: u32| corner(index).dot(along) >= top - OFF_FACE * size;
    hull.triangles.iter().copied().filter(move |triangle| {
        let [a, b, c] = triangle.map(corner);
        triangle.iter().all(|index| is_high(*index))
            && (b - a).cross(c - a).normalize_or_zero().dot(along) > ON_FACE
    })
}

/// At most four of the corners of a hull with these indices: the farthest one along `along`, and others far from each other.
fn spread(points: &[[f32; 3]], touching: &[u32], along: Vector, mut add: impl FnMut(Vector, u32)) {
    let corner = |index: u32| Vector::from_array(points[index as usize]);
    let best = |score: &dyn Fn(Vector) -> f32| {
        let all = touching.iter().map(|&index| (index, score(corner(index))));
        all.fold((0, f32::NEG_INFINITY), |best, next| if next.1 > best.1 { next } else { best })
    };
    let (first, _) = best(&|place| place.dot(along));
    let from = |place: Vector| place - corner(first);
    add(corner(first), first);
    let (second, distance) = best(&|place| from(place).length_squared());
    if distance <= 0.0 {
        return;
    }
    let side = from(corner(second)).cross(along);
    let beside = |sign: f32| best(&|place| sign * from(place).dot(side));
    // In turn around the feature, as the engine clips features against each other.
    for (index, offset) in [beside(1.0), (second, 1.0), beside(-1.0)] {
        if offset > 0.0 {
            add(corner(index), index);
        }
    }
}

impl Convex {
    /// At most four corners of a hull that are at most `reach` above the lowest one along `along`, in the link's frame; of other
    /// forms nothing.
    pub(crate) fn corners_within(
        &self,
        along: Vector,
        reach: f32,
        mut add: impl FnMut(Vector, u32),
    ) {
        if let Form::Hull(hull, _) = &self.form {
            let inside = self.pose.rotation.inverse() * along;
            let touching = within(&hull.points, reach, inside);
            spread(&hull.points, &touching, inside, |corner, id| add(self.pose * corner, id));
        }
    }

    /// Whether it is an ellipsoid or a cylinder.
    pub(crate) fn is_round(&self) -> bool {
        matches!(self.form, Form::Ellipsoid(_) | Form::Cylinder(_))
    }

    /// Whether a direction in the link's frame is that of a face.
    pub(crate) fn has_face(&self, along: Vector) -> bool {
        let inside = self.pose.rotation.inverse() * along;
        match &self.form {
            Form::Box(_) => inside.abs().max_element() > ON_FACE,
            Form::Cylinder(_) => inside.z.abs() > ON_FACE,
            Form::Ellipsoid(_) | Form::Prism(_) => false,
            Form::Hull(hull, size) => level_faces(hull, *size, inside).next().is_some(),
        }
    }

    /// Whether it is a cylinder that is tilted against a face with this normal in the link's frame: neither an end nor a line along its
    /// side lies on the face.
    pub(crate) fn is_tilted(&self, along: Vector) -> bool {
        let slope = (self.pose.rotation.inverse() * along).z.abs();
        matches!(self.form, Form::Cylinder(_)) && slope > OFF_FACE && slope <= ON_FACE
    }

    /// Whether it and `other` are boxes that touch at two crossing edges. `between` is the pose of the other's link in this one's.
    pub(crate) fn edges_touch(&self, other: &Self, between: &Pose) -> bool {
        match (&self.form, &other.form) {
            (Form::Box(own), Form::Box(theirs)) => {
                let between = self.pose.inv_mul(&(*between * other.pose));
                edges::overlap_least([*own, *theirs], &between)
            }
            _ => false,
        }
    }

    /// Pose, and half the length and the radius (m) of a cylinder.
    pub(crate) fn cylinder(&self) -> Option<(&Pose, [f32; 2])> {
        match self.form {
            Form::Cylinder(sizes) => Some((&self.pose, sizes)),
            _ => None,
        }
    }

    /// Whether it is a hull.
    pub(crate) fn is_hull(&self) -> bool {
        matches!(self.form, Form::Hull(..))
    }
}

impl SupportMap for Convex {
    fn local_support_point(&self, along: Vector) -> Vector {
        let inside = self.pose.rotation.inverse() * along;
        match &self.form {
            Form::Box(half) => {
                let (half, along) = (half.to_array(), inside.to_array());
                let end = |axis: usize| if along[axis] < 0.0 { -half[axis] } else { half[axis] };
                self.pose * Vector::from_array([0, 1, 2].map(end))
            }
            Form::Hull(hull, _) => self.pose * farthest(&hull.points, inside),
            Form::Prism(points) => self.pose * farthest(points, inside),
            Form::Cylinder([half, radius]) => {
                let aside = (inside.x * inside.x + inside.y * inside.y).sqrt();
                let scale = if aside > 0.0 { radius / aside } else { 0.0 };
                let end = half.copysign(inside.z);
                self.pose * Vector::new(scale * inside.x, scale * inside.y, end)
            }
            Form::Ellipsoid(half) => {
                let stretched = *half * inside;
                self.pose * (*half * stretched / stretched.length())
            }
        }
    }
}

impl PolygonalFeatureMap for Convex {
    fn local_support_feature(&self, along: Vector, feature: &mut PolygonalFeature) {
        let mut count = 0;
        self.corners(self.pose.rotation.inverse() * along, |corner, id| {
            feature.vertices[count] = self.pose * corner;
            feature.vids[count] = PackedFeatureId::vertex(id);
            count += 1;
        });
        feature.num_vertices = count;
    }
}

impl RapierShape for Convex {
    fn compute_local_aabb(&self) -> Aabb {
        self.bounds
    }

    fn compute_local_bounding_sphere(&self) -> BoundingSphere {
        self.bounds.bounding_sphere()
    }

    fn clone_dyn(&self) -> Box<dyn RapierShape> {
        Box::new(self.clone())
    }

    fn scale_dyn(&self, _: Vector, _: u32) -> Option<Box<dyn RapierShape>> {
        None
    }

    fn mass_properties(&self, _: f32) -> MassProperties {
        MassProperties::default()
    }

    fn shape_type(&self) -> ShapeType {
        ShapeType::Custom
    }

    fn as_typed_shape(&self) -> TypedShape<'_> {
        TypedShape::Custom(self)
    }

    fn ccd_thickness(&self) -> f32 {
        self.bounds.half_extents().min_element()
    }

    fn ccd_angular_thickness(&self) -> f32 {
        std::f32::consts::FRAC_PI_4
    }

    fn is_convex(&self) -> bool {
        true
    }

    fn as_support_map(&self) -> Option<&dyn SupportMap> {
        Some(self)
    }

    fn as_polygonal_feature_map(&self) -> Option<(&dyn PolygonalFeatureMap, f32)> {
        Some((self, 0.0))
    }
}

/// Queries are answered for the bounding box. The simulator makes none.
impl RayCast for Convex {
    fn cast_local_ray_and_get_normal(
        &self,
        ray: &Ray,
        longest: f32,
        solid: bool,
    ) -> Option<RayIntersection> {
        self.bounds.cast_local_ray_and_get_normal(ray, longest, solid)
    }
}
