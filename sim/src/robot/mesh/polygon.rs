//! Cuts the polygons of OBJ files into triangles as tinyobjloader does, with which MuJoCo reads them: a quadrangle along the
//! shorter diagonal, polygons with more corners by ears. All numbers have single precision, as there.

/// Triangles of a face, as indices of points; fewer than two less than its corners if no ear is left, and a fan if a corner
/// is not among the points.
pub(super) fn triangles(corners: &[usize], points: &[[f64; 3]]) -> Vec<[usize; 3]> {
    if let [a, b, c] = *corners {
        return vec![[a, b, c]];
    }
    let known = corners.iter().map(|corner| points.get(*corner));
    let known: Option<Vec<[f32; 3]>> =
        known.map(|point| point.map(|point| point.map(|x| x as f32))).collect();
    let parts = match known {
        Some(points) if points.len() == 4 => halves(&points).to_vec(),
        Some(points) => ears(&points),
        None => (1..corners.len() - 1).map(|second| [0, second, second + 1]).collect(),
    };
    parts.into_iter().map(|part| part.map(|corner| corners[corner])).collect()
}

/// The two triangles of a quadrangle.
fn halves(points: &[[f32; 3]]) -> [[usize; 3]; 2] {
    let squared = |from: usize, to: usize| {
        let [x, y, z] = [0, 1, 2].map(|axis| points[to][axis] - points[from][axis]);
        x * x + y * y + z * z
    };
    if squared(0, 2) < squared(1, 3) { [[0, 1, 2], [0, 2, 3]] } else { [[0, 1, 3], [1, 2, 3]] }
}

/// Cuts ears from a polygon until three corners are left or none of the remaining corners is an ear.
fn ears(points: &[[f32; 3]]) -> Vec<[usize; 3]> {
    let axes = plane(points);
    let flat: Vec<[f32; 2]> = points.iter().map(|point| axes.map(|axis| point[axis])).collect();
    let mut rest: Vec<usize> = (0..points.len()).collect();
    let mut found = Vec::new();
    let (mut first, mut before, mut tries) = (0, points.len(), points.len());
    while rest.len() > 3 && tries > 0 {
        let count = rest.len();
        first %= count;
        tries = if before == count { tries - 1 } else { count };
        before = count;
        let ear = [0, 1, 2].map(|next| rest[(first + next) % count]);
        let corners = ear.map(|corner| flat[corner]);
        let mut others = (3..count).map(|next| flat[rest[(first + next) % count]]);
        if bends_inwards(&corners) || others.any(|other| is_inside(&corners, other)) {
            first += 1;
        } else {
            found.push(ear);
            rest.remove((first + 1) % count);
        }
    }
    if let [a, b, c] = rest[..] {
        found.push([a, b, c]);
    }
    found
}

/// The two axes of the plane along coordinate axes onto which a polygon is projected, by its first corner that is not straight.
fn plane(points: &[[f32; 3]]) -> [usize; 2] {
    let count = points.len();
    let normal = |first: usize| {
        let [a, b, c] = [0, 1, 2].map(|next| points[(first + next) % count]);
        let [from, to] = [[a, b], [b, c]].map(|[a, b]| [0, 1, 2].map(|axis| b[axis] - a[axis]));
        let area = |i: usize, j: usize| (from[i] * to[j] - from[j] * to[i]).abs();
        [area(1, 2), area(2, 0), area(0, 1)]
    };
    let is_corner = |normal: &[f32; 3]| normal.iter().any(|x| *x > f32::EPSILON);
    match (0..count).map(normal).find(is_corner) {
        Some([x, y, z]) if x > y && x > z => [1, 2],
        Some([x, y, z]) if z > x && z > y => [0, 1],
        Some(_) => [0, 2],
        None => [1, 2],
    }
}

/// Whether tinyobjloader takes three corners for a bend to the inside. The sign of its area depends on the origin, so that it
/// may be wrong.
fn bends_inwards([a, b, c]: &[[f32; 2]; 3]) -> bool {
    let turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]);
    let area = (a[0] * b[1] - a[1] * b[0]) * 0.5;
    turn * area < 0.0
}

/// Whether a point is inside a triangle: a ray from it crosses the sides an odd number of times.
fn is_inside(corners: &[[f32; 2]; 3], [x, y]: [f32; 2]) -> bool {
    let crosses = |side: &usize| {
        let ([to_x, to_y], [from_x, from_y]) = (corners[*side], corners[(*side + 2) % 3]);
        (to_y > y) != (from_y > y) && x < (from_x - to_x) * (y - to_y) / (from_y - to_y) + to_x
    };
    (0..3).filter(crosses).count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    const L: [[f64; 2]; 6] =
        [[0.0, 0.0], [0.3, 0.0], [0.3, 0.1], [0.1, 0.1], [0.1, 0.3], [0.0, 0.3]];
    const PENTAGON: [[f64; 2]; 5] =
        [[1.0, 0.0], [0.3, 0.95], [-0.8, 0.6], [-0.8, -0.6], [0.3, -0.95]];
    const STAR: [[f64; 3]; 8] = [
        [1.0, 0.0, 0.0],
        [0.2, 0.2, 0.1],
        [0.0, 1.0, 0.0],
        [-0.2, 0.2, 0.0],
        [-1.0, 0.0, 0.1],
        [-0.2, -0.2, 0.0],
        [0.0, -1.0, 0.0],
        [0.2, -0.2, 0.0],
    ];

    fn level(points: &[[f64; 2]]) -> Vec<[f64; 3]> {
        points.iter().map(|[x, y]| [*x, *y, 0.0]).collect()
    }

    /// `mesh_face` of an OBJ file with this face in MuJoCo 4.0.0.
    #[test]
    fn a_face_is_cut_into_mujocos_triangles() {
        let bent = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.05], [0.2, 0.2, 0.0], [0.0, 0.2, 0.05]];
        let upright: Vec<[f64; 3]> = L.iter().map(|[x, y]| [2.0, *x, *y]).collect();
        // Seen from the origin, its corners turn the other way.
        let far = L.iter().map(|[x, y]| [x - 1.0, 1.0, y + 0.5]).collect();
        let fan = vec![[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]];
        for (points, expected) in [
            (bent.to_vec(), vec![[0, 1, 3], [1, 2, 3]]),
            (bent.map(|[x, y, z]| [x, y, z * y * 99.0]).to_vec(), vec![[0, 1, 2], [0, 2, 3]]),
            (level(&L), fan.clone()),
            (upright, fan.clone()),
            (
                level(&L).into_iter().rev().collect(),
                vec![[0, 1, 2], [2, 3, 4], [2, 4, 5], [0, 2, 5]],
            ),
            (far, vec![[4, 5, 0]]),
            (level(&PENTAGON), fan[..3].to_vec()),
            (STAR.to_vec(), vec![[1, 2, 3], [1, 3, 4], [1, 4, 5], [1, 5, 6], [7, 0, 1], [1, 6, 7]]),
        ] {
            let corners: Vec<usize> = (0..points.len()).collect();
            assert_eq!(triangles(&corners, &points), expected, "{points:?}");
        }
    }

    #[test]
    fn a_corner_that_is_no_point_remains_in_a_triangle() {
        assert_eq!(triangles(&[0, 1, 2, 9], &level(&L)), [[0, 1, 2], [0, 2, 9]]);
    }
}
