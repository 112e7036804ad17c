//! OBJ files.

use super::{Mesh, polygon};

/// Most corners of a face; the time to cut it grows with their square.
const MOST_IN_FACE: usize = 2_000;

/// Reads `v` and `f` lines. Faces with more than three corners are cut into triangles. As in MuJoCo, the faces are those of
/// the first object or group that has any, and one with fewer than three corners counts for nothing.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "it is not UTF-8 text".to_owned())?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let (mut points, mut faces): (Vec<[f64; 3]>, Vec<Vec<usize>>) = (Vec::new(), Vec::new());
    let mut has_ended = false;
    for (row, line) in text.lines().enumerate() {
        let invalid = || format!("line {} is invalid: {}", row + 1, line.trim());
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let numbers: Vec<f64> = words
                    .take(3)
                    .map(str::parse)
                    .collect::<Result<_, _>>()
                    .map_err(|_| invalid())?;
                points.push(numbers.try_into().map_err(|_| invalid())?);
            }
            Some("o" | "g") => has_ended = !faces.is_empty(),
            Some("f") if !has_ended => {
                let corners: Option<Vec<usize>> =
                    words.map(|word| corner(word, points.len())).collect();
                let corners = corners.ok_or_else(invalid)?;
                if corners.len() > MOST_IN_FACE {
                    let found = corners.len();
                    return Err(format!(
                        "a face has {found} corners, at most {MOST_IN_FACE} are allowed; cut it"
                    ));
                }
                faces.extend(Some(corners).filter(|corners| corners.len() >= 3));
            }
            _ => {}
        }
    }
    // A face may name points that follow it.
    let triangles = faces.iter().flat_map(|face| polygon::triangles(face, &points)).collect();
    Ok(Mesh { points, triangles })
}

/// Index of a corner such as `7/1/3`; negative numbers count from the last vertex.
fn corner(word: &str, points: usize) -> Option<usize> {
    let number: isize = word.split('/').next()?.parse().ok()?;
    match number {
        0 => None,
        1.. => usize::try_from(number - 1).ok(),
        _ => points.checked_add_signed(number),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::Volume;
    use super::*;

    /// A pyramid whose base is a quadrangle that is not flat, and a prism with the base of an L.
    const PYRAMID: &str = "v 0 0 0\nv .2 0 .05\nv .2 .2 0\nv 0 .2 .05\nv .1 .1 .3\n\
        f 4 3 2 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";
    const PRISM: &str = "v 0 0 0\nv .3 0 0\nv .3 .1 0\nv .1 .1 0\nv .1 .3 0\nv 0 .3 0\n\
        v 0 0 .1\nv .3 0 .1\nv .3 .1 .1\nv .1 .1 .1\nv .1 .3 .1\nv 0 .3 .1\nf 6 5 4 3 2 1\nf 7 8 9 10 11 12\n\
        f 1 2 8 7\nf 2 3 9 8\nf 3 4 10 9\nf 4 5 11 10\nf 5 6 12 11\nf 6 1 7 12\n";

    /// Mass with a density of 1000 kg/m^3.
    fn mass(file: &str, volume: Volume) -> f64 {
        let mesh = read(file.as_bytes()).unwrap();
        let hull = Arc::new(mesh.hull().unwrap());
        mesh.solid_of(volume, &hull).unwrap().mass * 1000.0
    }

    /// `body_mass` in MuJoCo 4.0.0.
    #[test]
    fn meshes_of_polygons_have_mujocos_masses() {
        for (file, volume, expected) in [
            (PYRAMID, Volume::Legacy, 4.0),
            (PYRAMID, Volume::Exact, 4.0),
            (PRISM, Volume::Legacy, 5.322548),
            (PRISM, Volume::Exact, 5.0),
        ] {
            let found = mass(file, volume);
            assert!((found - expected).abs() < 2e-6, "{volume:?}: {found} of {file}");
        }
    }

    #[test]
    fn a_byte_order_mark_and_faces_with_fewer_than_three_corners_count_for_nothing() {
        let expected = read(PYRAMID.as_bytes()).unwrap();
        for file in [
            format!("\u{feff}{PYRAMID}"),
            format!("{PYRAMID}f 1 2\nf 1\nf\n"),
            format!("g a\nf 1 2\ng b\n{PYRAMID}"),
        ] {
            let found = read(file.as_bytes()).unwrap();
            assert_eq!(found.points, expected.points, "{file}");
            assert_eq!(found.triangles, expected.triangles, "{file}");
        }
        assert_eq!(read(b"v 0 0 0\nf 1 0\n").unwrap_err(), "line 2 is invalid: f 1 0");
        let wide = format!("v 0 0 0\nf{}\n", " 1".repeat(MOST_IN_FACE + 1));
        assert!(read(wide.as_bytes()).unwrap_err().starts_with("a face has 2001 corners, "));
    }
}
