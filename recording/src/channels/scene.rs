//! Shapes of a robot as a Foxglove scene.

use foxglove::messages::{
    Color, CubePrimitive, CylinderPrimitive, Point3, Pose, Quaternion, SceneEntity, SceneUpdate,
    SpherePrimitive, Timestamp, TriangleListPrimitive, Vector3,
};
use sim::{Hull, LinkShape, Shape, WORLD, link_colour};

const FLOOR: Color = Color { r: 0.55, g: 0.60, b: 0.65, a: 0.6 };
/// Length and width of the drawn part of the floor, metres.
const FLOOR_SIZE: f64 = 400.0;
const FLOOR_THICKNESS: f64 = 0.02;

/// A robot and what is fixed around it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Scenery {
    pub(crate) shapes: Vec<DrivenShape>,
    /// Height of the floor, metres, if there is one.
    pub(crate) floor: Option<f32>,
}

/// A shape, and the agent that drives the joint of its link.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DrivenShape {
    pub(crate) shape: LinkShape,
    pub(crate) driver: Option<usize>,
}

/// A vector or a position, metres.
pub(super) fn vector([x, y, z]: [f32; 3]) -> Vector3 {
    Vector3 { x: x.into(), y: y.into(), z: z.into() }
}

/// A rotation.
pub(super) fn quaternion([x, y, z, w]: [f32; 4]) -> Quaternion {
    Quaternion { x: x.into(), y: y.into(), z: z.into(), w: w.into() }
}

/// Builds a scene with one entity per shape, locked to its link's frame or the world's, in its agent's colour, and the floor.
pub(super) fn update(scenery: &Scenery, now: Timestamp) -> SceneUpdate {
    let shapes = scenery.shapes.iter().enumerate();
    let mut entities: Vec<SceneEntity> =
        scenery.floor.map(|height| floor(height, now)).into_iter().collect();
    entities.extend(shapes.map(|(index, shape)| entity(index, shape, now)));
    SceneUpdate { deletions: Vec::new(), entities }
}

fn entity(index: usize, driven: &DrivenShape, now: Timestamp) -> SceneEntity {
    let (shape, color) = (&driven.shape, Some(colour(driven)));
    let mut entity = SceneEntity {
        timestamp: Some(now),
        frame_id: shape.link.clone(),
        id: format!("{}-{index}", shape.link),
        frame_locked: true,
        ..SceneEntity::default()
    };
    match shape.shape {
        Shape::Sphere { radius } => {
            entity.spheres.push(ellipsoid((shape, color), 0.0, [radius; 3]))
        }
        Shape::Ellipsoid { half_sizes } => {
            entity.spheres.push(ellipsoid((shape, color), 0.0, half_sizes))
        }
        Shape::Capsule { half_length, radius } => {
            entity.cylinders.push(cylinder((shape, color), half_length, radius));
            entity.spheres.push(ellipsoid((shape, color), half_length, [radius; 3]));
            entity.spheres.push(ellipsoid((shape, color), -half_length, [radius; 3]));
        }
        Shape::Cylinder { half_length, radius } => {
            entity.cylinders.push(cylinder((shape, color), half_length, radius));
        }
        Shape::Box { half_sizes } => entity.cubes.push(cube((shape, color), half_sizes)),
        Shape::Hull(ref hull) => entity.triangles.push(triangles((shape, color), hull)),
    }
    entity
}

/// A shape in a colour.
type Coloured<'a> = (&'a LinkShape, Option<Color>);

fn cube((shape, color): Coloured<'_>, half_sizes: [f32; 3]) -> CubePrimitive {
    CubePrimitive {
        pose: Some(pose(shape, 0.0)),
        size: Some(vector(half_sizes.map(|half| 2.0 * half))),
        color,
    }
}

fn triangles((shape, color): Coloured<'_>, hull: &Hull) -> TriangleListPrimitive {
    let point = |[x, y, z]: [f32; 3]| Point3 { x: x.into(), y: y.into(), z: z.into() };
    TriangleListPrimitive {
        pose: Some(pose(shape, 0.0)),
        points: hull.points.iter().copied().map(point).collect(),
        indices: hull.triangles.concat(),
        color,
        ..TriangleListPrimitive::default()
    }
}

fn floor(height: f32, now: Timestamp) -> SceneEntity {
    let below = Vector3 { x: 0.0, y: 0.0, z: f64::from(height) - FLOOR_THICKNESS / 2.0 };
    let cube = CubePrimitive {
        pose: Some(Pose { position: Some(below), orientation: Some(quaternion([0., 0., 0., 1.])) }),
        size: Some(Vector3 { x: FLOOR_SIZE, y: FLOOR_SIZE, z: FLOOR_THICKNESS }),
        color: Some(FLOOR),
    };
    SceneEntity {
        timestamp: Some(now),
        frame_id: WORLD.to_owned(),
        id: "floor".to_owned(),
        frame_locked: true,
        cubes: vec![cube],
        ..SceneEntity::default()
    }
}

fn cylinder((shape, color): Coloured<'_>, half_length: f32, radius: f32) -> CylinderPrimitive {
    let (width, length) = (2.0 * radius, 2.0 * half_length);
    CylinderPrimitive {
        pose: Some(pose(shape, 0.0)),
        size: Some(vector([width, width, length])),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color,
    }
}

/// An ellipsoid on the shape's axis, `along` metres from its centre.
fn ellipsoid((shape, color): Coloured<'_>, along: f32, half_sizes: [f32; 3]) -> SpherePrimitive {
    SpherePrimitive {
        pose: Some(pose(shape, along)),
        size: Some(vector(half_sizes.map(|half| 2.0 * half))),
        color,
    }
}

/// A link has its agent's colour. What is fixed has the floor's.
fn colour(driven: &DrivenShape) -> Color {
    if driven.shape.link == WORLD {
        return FLOOR;
    }
    let [r, g, b] = link_colour(driven.driver).map(|part| f64::from(part) / 255.0);
    Color { r, g, b, a: 1.0 }
}

fn pose(shape: &LinkShape, along: f32) -> Pose {
    let axis = z_axis(shape.quaternion);
    let at = |i: usize| shape.position[i] + along * axis[i];
    Pose {
        position: Some(vector([at(0), at(1), at(2)])),
        orientation: Some(quaternion(shape.quaternion)),
    }
}

/// The z axis after a rotation.
fn z_axis([x, y, z, w]: [f32; 4]) -> [f32; 3] {
    [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_turn_about_y_rotates_z_to_x() {
        let half = core::f32::consts::FRAC_1_SQRT_2;
        let axis = z_axis([0.0, half, 0.0, half]);
        assert!((axis[0] - 1.0).abs() < 1e-6 && axis[1].abs() < 1e-6 && axis[2].abs() < 1e-6);
    }

    #[test]
    fn every_kind_of_shape_becomes_its_primitive() {
        let tetrahedron = Hull {
            points: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        };
        let half_sizes = [0.1, 0.2, 0.3];
        let drawn = |shape| {
            let (position, quaternion) = ([0.0; 3], [0.0, 0.0, 0.0, 1.0]);
            let shape = LinkShape { link: "hand".to_owned(), shape, position, quaternion };
            entity(0, &DrivenShape { shape, driver: None }, Timestamp::MIN)
        };
        let size = drawn(Shape::Box { half_sizes }).cubes[0].size.expect("a cube has a size");
        assert!((size.z - 0.6).abs() < 1e-6);
        let size = drawn(Shape::Ellipsoid { half_sizes }).spheres[0].size.expect("it has a size");
        assert!((size.y - 0.4).abs() < 1e-6);
        let cylinder = drawn(Shape::Cylinder { half_length: 0.5, radius: 0.1 });
        assert_eq!((cylinder.cylinders.len(), cylinder.spheres.len()), (1, 0));
        let hull = drawn(Shape::Hull(std::sync::Arc::new(tetrahedron)));
        assert_eq!((hull.triangles[0].points.len(), hull.triangles[0].indices.len()), (4, 12));
    }

    #[test]
    fn a_scene_has_two_spheres_per_capsule_and_a_floor() {
        let robot = sim::Robot::of_task("halfcheetah-2x3").expect("a task");
        let driven = |shape| DrivenShape { shape, driver: None };
        let shapes: Vec<DrivenShape> = robot.shapes().into_iter().map(driven).collect();
        let scene = update(&Scenery { shapes, floor: Some(0.5) }, Timestamp::MIN);
        let (cylinders, spheres): (usize, usize) =
            scene.entities.iter().fold((0, 0), |sum, entity| {
                (sum.0 + entity.cylinders.len(), sum.1 + entity.spheres.len())
            });
        assert_eq!((cylinders, spheres), (8, 16));
        let floor = scene.entities.iter().find(|entity| entity.id == "floor").expect("a floor");
        let place = floor.cubes[0].pose.as_ref().and_then(|pose| pose.position);
        assert_eq!(place.map(|place| place.z), Some(0.49));
    }

    #[test]
    fn a_fixed_shape_is_in_the_frame_of_the_world_and_has_the_floors_colour() {
        let shape = Shape::Box { half_sizes: [0.5; 3] };
        let (position, quaternion) = ([1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]);
        let wall = LinkShape { link: WORLD.to_owned(), shape, position, quaternion };
        let shapes = vec![DrivenShape { shape: wall, driver: None }];
        let scene = update(&Scenery { shapes, floor: None }, Timestamp::MIN);
        let wall = &scene.entities[0];
        assert_eq!((wall.frame_id.as_str(), wall.cubes[0].color), ("world", Some(FLOOR)));
    }
}
