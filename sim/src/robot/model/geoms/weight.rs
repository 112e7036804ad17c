//! Volumes and surfaces of shapes, and how their mass is distributed.

use crate::scene::Shape;

/// Thickness of the shell of an ellipsoid, m, as in MuJoCo.
const THICKNESS: f64 = 1e-6;

/// Volume of a box, cylinder or ellipsoid, m^3, and the mean squares of its points' coordinates, m^2.
pub(super) fn volume(shape: &Shape) -> (f64, [f64; 3]) {
    let double = |sizes: [f32; 3]| sizes.map(f64::from);
    match *shape {
        Shape::Box { half_sizes } => {
            let [x, y, z] = double(half_sizes);
            (8.0 * x * y * z, [x, y, z].map(|half| half * half / 3.0))
        }
        Shape::Ellipsoid { half_sizes } => {
            let [x, y, z] = double(half_sizes);
            let volume = 4.0 / 3.0 * std::f64::consts::PI * x * y * z;
            (volume, [x, y, z].map(|half| half * half / 5.0))
        }
        Shape::Cylinder { half_length, radius } => {
            let [half, radius] = [half_length, radius].map(f64::from);
            let across = radius * radius / 4.0;
            let volume = std::f64::consts::PI * radius * radius * 2.0 * half;
            (volume, [across, across, half * half / 3.0])
        }
        _ => unreachable!("other shapes have their own mass properties"),
    }
}

/// Area of a shape's surface, m^2, and its moments of inertia for each kg, m^2, by MuJoCo's equations; those of an ellipsoid are
/// approximate.
pub(super) fn shell(shape: &Shape) -> (f64, [f64; 3]) {
    match *shape {
        Shape::Sphere { radius } => tube(f64::from(radius), 0.0, End::Hemisphere),
        Shape::Capsule { half_length, radius } => {
            tube(f64::from(radius), f64::from(half_length), End::Hemisphere)
        }
        Shape::Cylinder { half_length, radius } => {
            tube(f64::from(radius), f64::from(half_length), End::Disc)
        }
        Shape::Box { half_sizes } => plates(half_sizes.map(f64::from)),
        Shape::Ellipsoid { half_sizes } => skin(half_sizes.map(f64::from)),
        Shape::Hull(_) => unreachable!("a mesh has its own mass properties"),
    }
}

/// Form of the ends of a tube.
#[derive(Clone, Copy)]
enum End {
    Hemisphere,
    Disc,
}

/// A tube along z with two closed ends.
fn tube(radius: f64, half: f64, end: End) -> (f64, [f64; 3]) {
    let square = radius * radius;
    // Both ends: their area in parts of a disc, and their moments for each kg.
    let (discs, across, along) = match end {
        End::Hemisphere => {
            let [inside, out] = [radius / 2.0, half + radius / 2.0];
            let own = 2.0 / 3.0 * square;
            (4.0, own + out * out - inside * inside, own)
        }
        End::Disc => (2.0, square / 4.0 + half * half, square / 2.0),
    };
    let [ends, side] =
        [discs * square, 4.0 * radius * half].map(|area| area * std::f64::consts::PI);
    let area = ends + side;
    let mean = |of_ends: f64, of_side: f64| (ends * of_ends + side * of_side) / area;
    let across = mean(across, square / 2.0 + half * half / 3.0);
    (area, [across, across, mean(along, square)])
}

/// The six sides of a box with these half edges.
fn plates(half: [f64; 3]) -> (f64, [f64; 3]) {
    let sides = [0, 1, 2].map(|axis| 8.0 * half[(axis + 1) % 3] * half[(axis + 2) % 3]);
    let area = sides[0] + sides[1] + sides[2];
    // Mean square of the coordinate along each axis: the two sides across it lie at its ends.
    let squares = [0, 1, 2].map(|axis| {
        let square = half[axis] * half[axis];
        (sides[axis] * square + (area - sides[axis]) * square / 3.0) / area
    });
    let [x, y, z] = squares;
    (area, [y + z, z + x, x + y])
}

/// The surface of an ellipsoid: an approximate area, and the moments of a thin layer.
fn skin(half: [f64; 3]) -> (f64, [f64; 3]) {
    // Thomsen's formula, https://www.numericana.com/answer/ellipsoid.htm#thomsen
    let exponent = 1.6075;
    let [x, y, z] = half;
    let sum: f64 = [x * y, y * z, z * x].map(|part| libm::pow(part, exponent)).iter().sum();
    let area = 4.0 * std::f64::consts::PI * libm::pow(sum / 3.0, 1.0 / exponent);
    let outer = half.map(|length| length + THICKNESS);
    let [solid, whole] = [half, outer].map(|[x, y, z]| x * y * z);
    let squares = [0, 1, 2].map(|axis| {
        let [inside, out] = [half[axis], outer[axis]].map(|length| length * length / 5.0);
        (whole * out - solid * inside) / (whole - solid)
    });
    let [x, y, z] = squares;
    (area, [y + z, z + x, x + y])
}
