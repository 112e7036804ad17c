//! Contacts of shapes of all sizes against a search among all directions.

use std::f32::consts::{GOLDEN_RATIO, TAU};
use std::sync::Arc;

use rapier3d::math::Rotation;
use rapier3d::parry::query::{DefaultQueryDispatcher, PersistentQueryDispatcher as _};
use rapier3d::prelude::SharedShape;

use super::super::convex::sharpen;
use super::*;
use crate::robot::Convex;
use crate::scene::{Hull, Shape as Form};

/// Directions from which the reference searches, and how many of them it follows.
const DIRECTIONS: usize = 400;
const FOLLOWED: usize = 12;

/// Numbers from -1 to 1.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 40) as f32 / 8_388_608.0 - 1.0
    }

    fn vector(&mut self) -> Vector {
        Vector::new(self.next(), self.next(), self.next())
    }

    fn rotation(&mut self) -> Rotation {
        let (axis, angle) = (self.vector().normalize_or(Vector::X), 3.0 * self.next());
        Rotation::from_axis_angle(axis, angle)
    }
}

/// A box, a long one, a capsule, a tetrahedron and a hull of many corners, with sizes of about 1, times a scale.
fn shapes(scale: f32) -> Vec<SharedShape> {
    let solid = |form| Convex::shared(&form, &Pose::from_translation(Vector::X * scale));
    let sizes = |sizes: [f32; 3]| sizes.map(|size| size * scale);
    let hull = |points: Vec<[f32; 3]>, triangles| {
        let points = points.into_iter().map(sizes).collect();
        solid(Form::Hull(Arc::new(Hull { points, triangles })))
    };
    let tetrahedron =
        vec![[0.9, 0.0, -0.5], [-0.4, 0.8, -0.5], [-0.5, -0.8, -0.4], [0.0, 0.1, 1.0]];
    let faces = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    let round = (0..60).map(|index| direction(index, 60).to_array()).collect();
    vec![
        solid(Form::Box { half_sizes: sizes([0.6, 0.5, 0.4]) }),
        solid(Form::Box { half_sizes: sizes([1.0, 0.1, 0.2]) }),
        solid(Form::Capsule { half_length: 0.7 * scale, radius: 0.2 * scale }),
        hull(tetrahedron, faces),
        hull(round, Vec::new()),
    ]
}

/// Evenly spread directions.
fn direction(index: usize, count: usize) -> Vector {
    let z = 1.0 - (2 * index + 1) as f32 / count as f32;
    let (sine, cosine) = libm::sincosf(TAU * (index as f32 / GOLDEN_RATIO).fract());
    let aside = (1.0 - z * z).sqrt();
    Vector::new(aside * cosine, aside * sine, z)
}

/// The largest distance along any direction, m, and the direction.
fn separation(both: [&dyn Shape; 2], between: &Pose) -> (f32, Vector) {
    let pair = Pair::in_units(both, between).unwrap();
    let mut starts: Vec<Vector> = (0..DIRECTIONS).map(|at| direction(at, DIRECTIONS)).collect();
    starts.sort_by(|one, other| pair.distance(*other).total_cmp(&pair.distance(*one)));
    let ends = starts.into_iter().take(FOLLOWED).flat_map(|start| {
        let once = pair.climb(start);
        [once, pair.climb(once)]
    });
    let found = ends.map(|along| (pair.distance(along) / pair.parts[0].scale, along));
    found.max_by(|one, other| one.0.total_cmp(&other.0)).unwrap()
}

/// A pose of the second shape in which the largest distance is `gap`, and that distance, m.
fn placed(both: [&dyn Shape; 2], rough: Pose, gap: f32) -> (Pose, f32) {
    let mut between = rough;
    for _ in 0..3 {
        let (apart, along) = separation(both, &between);
        between.translation += along * (gap - apart);
    }
    (between, separation(both, &between).0)
}

fn contact(both: [&dyn Shape; 2], between: &Pose, margin: f32) -> ContactManifold<(), ()> {
    let mut manifold = ContactManifold::new();
    let engine = DefaultQueryDispatcher;
    let [one, other] = both;
    engine
        .contact_manifold_convex_convex(between, one, other, None, None, margin, &mut manifold)
        .expect("the engine has contacts of convex shapes");
    sharpen(both, between, margin, &mut manifold);
    manifold
}

/// The deepest point that is found, against the largest of the distances along all directions. Sizes in m; gaps as fractions
/// of the smaller size.
#[test]
fn shapes_of_all_sizes_touch_where_they_are_deepest() {
    let mut numbers = Numbers(5);
    for (scales, gap) in [
        ([0.002, 0.002], -0.02),
        ([0.002, 0.002], 0.01),
        ([0.01, 0.01], -0.02),
        ([0.01, 0.3], -0.02),
        ([0.3, 0.01], 0.01),
        ([1.0, 0.01], -0.1),
        ([0.1, 0.1], -0.02),
        // Large shapes: the engine's own contacts.
        ([10.0, 10.0], -0.02),
    ] {
        let [ones, others] = scales.map(shapes);
        let pairs = ones.iter().flat_map(|one| others.iter().map(move |other| [one, other]));
        for both in pairs.map(|both| both.map(|shape| &**shape)) {
            let capsules = both.iter().filter(|shape| shape.as_capsule().is_some());
            if capsules.count() == 2 {
                continue;
            }
            for _ in 0..8 {
                let rough = Pose::from_parts(numbers.vector() * scales[0], numbers.rotation());
                let size = Pair::new(both, &rough).unwrap().size();
                let (between, expected) = placed(both, rough, gap * size);
                let manifold = contact(both, &between, 0.02 * size);
                let case = format!("{scales:?} m, {gap}, {expected} m");
                let Some(point) = manifold.points.last() else { panic!("{case}: no contact") };
                let off = (point.dist - expected).abs();
                assert!(off < 2e-3 * size, "{case}: {} m", point.dist);
                let pair = Pair::new(both, &between).unwrap();
                let ends = pair.distance(manifold.local_n1);
                assert!((ends - expected).abs() < 2e-3 * size, "{case}: {ends} m along it");
                let along = manifold.local_n1;
                let end = pair.ends(along)[0].dot(along) + pair.parts[0].radius;
                assert!((point.local_p1.dot(along) - end).abs() < 2e-3 * size, "{case}");
                let line = between * point.local_p2 - point.local_p1 - along * point.dist;
                assert!(line.length() < 2e-3 * size, "{case}: {line}");
            }
        }
    }
}
