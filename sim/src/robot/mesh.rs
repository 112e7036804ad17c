//! Triangle meshes of a model: binary STL, OBJ and MSH files, their convex hulls, and the masses that they enclose.

mod hull;
mod obj;
mod polygon;

use std::collections::BTreeSet;
use std::sync::Arc;

use super::document::bounds;
use super::frame::{Frame, IDENTITY, cross, dot, rotated};
use super::inertia::{Matrix, Solid};
use crate::scene::Hull;
use hull::NoHull;

const STL_HEADER_BYTES: usize = 84;
const STL_TRIANGLE_BYTES: usize = 50;
/// Most points of a mesh; the time that a hull takes grows with them.
const MOST_CORNERS: usize = 150_000;

/// A closed surface of triangles.
#[derive(Clone, Debug)]
pub(super) struct Mesh {
    /// m.
    points: Vec<[f64; 3]>,
    /// Indices of points, anticlockwise seen from outside.
    triangles: Vec<[usize; 3]>,
}

/// Volume whose mass a mesh has: MuJoCo's `inertia` of meshes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Volume {
    /// All pyramids between a point and the triangles, counted as positive: the surface's centroid gives the mass centre,
    /// the mass centre gives mass and inertia.
    Legacy,
    /// The enclosed volume.
    Exact,
    /// The convex hull.
    Convex,
    /// The surface, with a density in kg/m^2.
    Shell,
}

impl Mesh {
    /// Reads a file by the ending of its name.
    pub(super) fn read(path: &str, bytes: &[u8]) -> Result<Self, String> {
        let ending = path.rsplit_once('.').map(|(_, ending)| ending.to_ascii_lowercase());
        let mesh = match ending.as_deref() {
            Some("stl") => read_stl(bytes),
            Some("obj") => obj::read(bytes),
            Some("msh") => read_msh(bytes),
            _ => Err("it is not an STL, OBJ or MSH file; convert it to one".to_owned()),
        };
        // Only OBJ files count vertices from 1.
        let mesh =
            mesh.and_then(|mesh| mesh.checked(usize::from(ending.as_deref() == Some("obj"))));
        mesh.map_err(|reason| format!("{path}: {reason}"))
    }

    /// A mesh of the given points; without faces, their convex hull.
    pub(super) fn new(points: Vec<[f64; 3]>, triangles: Vec<[usize; 3]>) -> Result<Self, String> {
        let mesh = Self { points, triangles };
        if mesh.triangles.is_empty() {
            mesh.hull().map(|hull| Self::of_hull(&hull))
        } else {
            mesh.checked(0)
        }
    }

    /// Refuses an invalid mesh; `first` is the number of the first vertex in messages.
    fn checked(self, first: usize) -> Result<Self, String> {
        let count = self.points.len();
        if self.triangles.is_empty() {
            return Err("it has no triangles".to_owned());
        }
        if !self.points.iter().flatten().all(|x| x.is_finite()) {
            return Err("a coordinate is not finite".to_owned());
        }
        match self.triangles.iter().flatten().find(|index| **index >= count) {
            Some(index) => {
                let [named, last] = [index + first, count - 1 + first];
                Err(format!("a face names vertex {named}; the last one is {last}"))
            }
            None => Ok(self),
        }
    }

    /// The mesh in the coordinates of a frame.
    pub(super) fn seen_from(mut self, frame: &Frame) -> Self {
        if *frame != IDENTITY {
            let [x, y, z, w] = frame.rotation;
            for point in &mut self.points {
                let offset = [0, 1, 2].map(|axis| point[axis] - frame.position[axis]);
                *point = rotated([-x, -y, -z, w], offset);
            }
        }
        self
    }

    /// Multiplies coordinates by `scale`. A reflection also reverses the triangles.
    pub(super) fn scaled(mut self, scale: [f64; 3]) -> Self {
        self.points.iter_mut().for_each(|point| (0..3).for_each(|i| point[i] *= scale[i]));
        if scale.iter().product::<f64>() < 0.0 {
            self.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        self
    }

    /// The convex hull.
    pub(super) fn hull(&self) -> Result<Hull, String> {
        if let Some(why) = self.points.iter().flatten().find_map(|x| bounds::refusal("vertex", *x))
        {
            return Err(format!("a coordinate {why}; check its `scale`, and its `vertex` or file"));
        }
        let unique: BTreeSet<[u32; 3]> =
            self.points.iter().map(|point| point.map(|x| (x as f32 + 0.0).to_bits())).collect();
        let points: Vec<[f32; 3]> =
            unique.into_iter().map(|bits| bits.map(f32::from_bits)).collect();
        let count = points.len();
        if count > MOST_CORNERS {
            return Err(format!(
                "it has {count} different points, at most {MOST_CORNERS} are allowed; simplify it"
            ));
        }
        hull::convex_hull(&points).map_err(|why| match why {
            NoHull::Flat => {
                "its points do not span a volume; check its `scale`, and its `vertex` or file, or \
                remove the shapes that it has"
                    .to_owned()
            }
            NoHull::Wrong => {
                "its convex hull cannot be computed; simplify it, for example to its hull"
                    .to_owned()
            }
        })
    }

    fn of_hull(hull: &Hull) -> Self {
        Self {
            points: hull.points.iter().map(|point| point.map(f64::from)).collect(),
            triangles: hull.triangles.iter().map(|triangle| triangle.map(|i| i as usize)).collect(),
        }
    }

    /// Mass, mass centre and inertia of the volume with a density of 1 kg/m^3.
    pub(super) fn solid_of(&self, volume: Volume, hull: &Arc<Hull>) -> Result<Solid, String> {
        let solid = match volume {
            Volume::Convex => Self::of_hull(hull).solid(Volume::Exact),
            volume => self.solid(volume),
        };
        if solid.mass > 0.0 { Ok(solid) } else { Err("its triangles enclose no volume".to_owned()) }
    }

    fn solid(&self, volume: Volume) -> Solid {
        let (area, apex) = self.centroid();
        if volume == Volume::Shell {
            return self.shell(area, apex);
        }
        let pyramids = |apex: [f64; 3]| {
            self.triangles.iter().map(move |triangle| {
                let corners = triangle.map(|i| sub(self.points[i], apex));
                let signed = dot(corners[0], cross(corners[1], corners[2])) / 6.0;
                (corners, if volume == Volume::Legacy { signed.abs() } else { signed })
            })
        };
        let mass: f64 = pyramids(apex).map(|(_, volume)| volume).sum();
        let mut centre = apex;
        for (corners, part) in pyramids(apex) {
            for i in 0..3 {
                centre[i] +=
                    part * corners.iter().map(|corner| corner[i]).sum::<f64>() / 4.0 / mass;
            }
        }
        let mut moments: Matrix = [[0.0; 3]; 3];
        // As in MuJoCo, mass and inertia are those of the pyramids on the mass centre.
        let mass = pyramids(centre).map(|(_, volume)| volume).sum();
        for (corners, part) in pyramids(centre) {
            add_moments(&mut moments, &corners, part / 20.0);
        }
        Solid::from_moments(mass, centre, moments)
    }

    /// The surface with a density of 1 kg/m^2.
    fn shell(&self, area: f64, centroid: [f64; 3]) -> Solid {
        let mut moments: Matrix = [[0.0; 3]; 3];
        for triangle in &self.triangles {
            let corners = triangle.map(|i| sub(self.points[i], centroid));
            let normal = cross(sub(corners[1], corners[0]), sub(corners[2], corners[0]));
            add_moments(&mut moments, &corners, dot(normal, normal).sqrt() / 2.0 / 12.0);
        }
        Solid::from_moments(area, centroid, moments)
    }

    /// Area of the surface, m^2, and its centroid.
    fn centroid(&self) -> (f64, [f64; 3]) {
        let (mut area, mut sum) = (0.0, [0.0; 3]);
        for triangle in &self.triangles {
            let corners = triangle.map(|i| self.points[i]);
            let normal = cross(sub(corners[1], corners[0]), sub(corners[2], corners[0]));
            let size = dot(normal, normal).sqrt();
            area += size;
            (0..3).for_each(|i| {
                sum[i] += size * corners.iter().map(|corner| corner[i]).sum::<f64>() / 3.0;
            });
        }
        (area / 2.0, sum.map(|x| if area > 0.0 { x / area } else { 0.0 }))
    }
}

/// Adds second moments, `integral x x^T dm`, with a part of the mass: a twentieth of that of the tetrahedron between the
/// origin and three corners, or a twelfth of that of the triangle between the corners.
fn add_moments(moments: &mut Matrix, corners: &[[f64; 3]; 3], part: f64) {
    for row in 0..3 {
        for column in 0..3 {
            let squares: f64 = corners.iter().map(|corner| corner[row] * corner[column]).sum();
            let sums: [f64; 2] = [row, column].map(|i| corners.iter().map(|c| c[i]).sum());
            moments[row][column] += part * (squares + sums[0] * sums[1]);
        }
    }
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn read_stl(bytes: &[u8]) -> Result<Mesh, String> {
    let count = bytes.get(80..84).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let count = count.ok_or("an STL file has at least 84 bytes")? as usize;
    let (needed, has) =
        (count.saturating_mul(STL_TRIANGLE_BYTES).saturating_add(STL_HEADER_BYTES), bytes.len());
    if needed != has {
        return Err(if bytes.starts_with(b"solid") {
            "it is an ASCII STL file; save it as a binary one".to_owned()
        } else {
            format!(
                "it is not a binary STL file: {count} triangles need {needed} bytes, it has {has}"
            )
        });
    }
    let number = |at: &[u8]| f64::from(f32::from_le_bytes([at[0], at[1], at[2], at[3]]));
    let points: Vec<[f64; 3]> = bytes[STL_HEADER_BYTES..]
        .chunks_exact(STL_TRIANGLE_BYTES)
        // A triangle starts with its normal, which its points give as well.
        .flat_map(|triangle| triangle[12..48].chunks_exact(12))
        .map(|point| [number(&point[0..4]), number(&point[4..8]), number(&point[8..12])])
        .collect();
    let triangles = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Ok(Mesh { points, triangles })
}

/// Reads MuJoCo's own format: numbers of points, normals, texture coordinates and triangles, then all of them.
fn read_msh(bytes: &[u8]) -> Result<Mesh, String> {
    let words = bytes.as_chunks::<4>().0;
    let [points, normals, coordinates, triangles, words @ ..] = words else {
        return Err("an MSH file has at least 16 bytes".to_owned());
    };
    let counts = [points, normals, coordinates, triangles];
    let counts = counts.map(|word| u64::from(u32::from_le_bytes(*word)));
    let needed: u64 = counts.iter().zip([12, 12, 8, 12]).map(|(count, size)| count * size).sum();
    if needed + 16 != bytes.len() as u64 {
        return Err(format!(
            "it is not an MSH file: its numbers need {} bytes, it has {}",
            needed + 16,
            bytes.len()
        ));
    }
    let [points, _, _, triangles] = counts.map(|count| 3 * count as usize);
    let (faces, rest) = (&words[words.len() - triangles..], &words[..points]);
    let number = |word: &[u8; 4]| f64::from(f32::from_le_bytes(*word));
    Ok(Mesh {
        points: rest.as_chunks::<3>().0.iter().map(|point| point.each_ref().map(number)).collect(),
        triangles: faces
            .as_chunks::<3>()
            .0
            .iter()
            .map(|face| face.map(|index| u32::from_le_bytes(index) as usize))
            .collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CUBE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n\
        f 4 3 2 1\nf 5 6 7 8\nf 1/1 2/2 6/6 5/5\nf 2 3 7 6\nf 3 4 8 7\nf -8 -4 -1 -5\n";

    /// A binary STL file of the same triangles.
    fn stl(mesh: &Mesh) -> Vec<u8> {
        let mut bytes = vec![0; 80];
        bytes.extend((mesh.triangles.len() as u32).to_le_bytes());
        for triangle in &mesh.triangles {
            bytes.extend([0; 12]);
            for number in triangle.iter().flat_map(|i| mesh.points[*i]) {
                bytes.extend((number as f32).to_le_bytes());
            }
            bytes.extend([0; 2]);
        }
        bytes
    }

    #[test]
    fn obj_and_stl_files_of_a_cube_have_its_volume_and_hull() {
        let obj = Mesh::read("cube.obj", CUBE.as_bytes()).unwrap();
        for mesh in [Mesh::read("cube.STL", &stl(&obj)).unwrap(), obj] {
            let hull = Arc::new(mesh.hull().unwrap());
            assert_eq!((hull.points.len(), hull.triangles.len()), (8, 12));
            for volume in [Volume::Legacy, Volume::Exact, Volume::Convex] {
                let solid = mesh.solid_of(volume, &hull).unwrap();
                assert!((solid.mass - 1.0).abs() < 1e-9, "{solid:?}");
                assert!((solid.inertia[0][0] - 1.0 / 6.0).abs() < 1e-9, "{solid:?}");
                assert!(solid.centre.iter().all(|x| (x - 0.5).abs() < 1e-9), "{solid:?}");
            }
        }
    }

    /// A mesh as MuJoCo's own format, with a normal and two texture coordinates.
    fn msh(mesh: &Mesh) -> Vec<u8> {
        let counts = [mesh.points.len(), 1, 2, mesh.triangles.len()].map(|count| count as u32);
        let points = mesh.points.iter().flatten().map(|x| (*x as f32).to_bits());
        let triangles = mesh.triangles.iter().flatten().map(|index| *index as u32);
        let words = counts.into_iter().chain(points).chain([7; 3 + 2 * 2]).chain(triangles);
        words.flat_map(u32::to_le_bytes).collect()
    }

    #[test]
    fn a_file_in_mujocos_format_has_the_points_and_triangles_of_its_mesh() {
        let cube = Mesh::read("cube.obj", CUBE.as_bytes()).unwrap();
        let bytes = msh(&cube);
        let read = Mesh::read("cube.msh", &bytes).unwrap();
        assert_eq!((read.points, read.triangles), (cube.points, cube.triangles));
        let refusal = |bytes: &[u8]| Mesh::read("cube.msh", bytes).unwrap_err();
        assert!(
            refusal(&bytes[..bytes.len() - 4]).contains("its numbers need 284 bytes, it has 280")
        );
        assert!(refusal(&[255; 16]).contains("its numbers need"));
        assert!(refusal(&bytes[..15]).contains("at least 16 bytes"));
        let mut far = bytes.clone();
        far[bytes.len() - 1] = 0x70;
        assert!(refusal(&far).contains("a face names vertex"));
    }

    #[test]
    fn the_faces_of_an_obj_file_are_those_of_its_first_object() {
        let first = CUBE.replace("f 4 3 2 1", "o a\ng b\nf 4 3 2 1");
        let mesh = Mesh::read("a.obj", format!("{first}g c\nf 1 2 3\no d\nf 1 2 4\n").as_bytes());
        assert_eq!(mesh.unwrap().triangles.len(), 12);
    }

    #[test]
    fn damaged_files_are_rejected_with_the_reason() {
        let reason = |path: &str, bytes: &[u8]| Mesh::read(path, bytes).unwrap_err();
        let mut cut = stl(&Mesh::read("cube.obj", CUBE.as_bytes()).unwrap());
        cut.pop();
        for (path, bytes, part) in [
            ("a.stl", &cut[..], "12 triangles need 684 bytes, it has 683"),
            ("a.stl", b"cube", "at least 84 bytes"),
            ("a.stl", &[&b"solid cube"[..], &[b' '; 99]].concat(), "save it as a binary one"),
            ("a.obj", b"v 0 0\n", "line 1 is invalid: v 0 0"),
            ("a.obj", b"v 0 0 0\nf 1 2 9\n", "a face names vertex 2; the last one is 1"),
            ("a.dae", b"", "not an STL, OBJ or MSH file"),
        ] {
            assert!(reason(path, bytes).contains(part), "{path}: {part}");
        }
        let named = Mesh::new(vec![[0.0; 3]; 4], vec![[0, 1, 9]]).unwrap_err();
        assert_eq!(named, "a face names vertex 9; the last one is 3");
        let flat = Mesh::read("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
        assert!(flat.hull().unwrap_err().contains("do not span a volume"));
    }
}
