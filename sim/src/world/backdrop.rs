//! What is fixed to the world around a robot, at the heights of the current episode, for pictures.

use std::sync::Arc;

use rapier3d::math::{Pose, Vector};

use super::World;
use crate::robot::{GroundForm, HeightField};
use crate::scene::{Capsule, Hull, LinkShape, Shape, WORLD, parts};

/// Most points of a drawn height field along x, and along y.
const MOST_ALONG: usize = 24;
/// Radius of lines, m.
const LINE: f32 = 0.02;
/// Smallest height of the normal, of length one, of a level plane.
const LEVEL: f32 = 0.999;
/// Half the sizes of the drawn part of another plane, m.
const SLAB: [f32; 3] = [10.0, 10.0, 0.01];
/// Largest coordinate and radius of what is drawn, m.
const FARTHEST: f32 = 1e3;

impl World {
    /// Height of the floor, m: of the highest level plane; `None` without one.
    #[must_use]
    pub fn floor_height(&self) -> Option<f32> {
        let planes = self.grounds().filter(|(form, _)| matches!(form, GroundForm::Plane));
        let levels = planes.filter(|(_, pose)| is_level(pose)).map(|(_, pose)| pose.translation.z);
        levels.reduce(f32::max)
    }

    /// Shapes that are fixed to the world, in its frame, without level planes. Other planes are slabs. Height fields are meshes of limited size.
    pub fn fixed_shapes(&self) -> Vec<LinkShape> {
        let grounds = self.grounds().filter_map(|(form, pose)| {
            let (shape, pose) = match form {
                GroundForm::Plane if is_level(&pose) => return None,
                GroundForm::Plane => slab(&pose),
                GroundForm::Solid(shape) => (shape.clone(), pose),
                GroundForm::Field(field) => (Shape::Hull(Arc::new(mesh(field))), pose),
            };
            let (position, quaternion) = parts(&pose);
            Some(LinkShape { link: WORLD.to_owned(), shape, position, quaternion })
        });
        grounds.collect()
    }

    /// Capsules in the world that show these shapes from the side, along y: one for each, and a line of several along the
    /// highest points of a height field. Shapes of more than a kilometre are left out.
    #[must_use]
    pub fn fixed_capsules(&self) -> Vec<Capsule> {
        self.fixed_as(|shape, pose| vec![bar(shape, pose)], crest)
    }

    /// Capsules in the world that show these shapes from everywhere: balls and capsules themselves, and lines along the edges
    /// of the boxes around others and along rows and columns of a height field. Shapes of more than a kilometre are left out.
    #[must_use]
    pub fn fixed_outlines(&self) -> Vec<Capsule> {
        self.fixed_as(outline, grid)
    }

    fn fixed_as(
        &self,
        solid: impl Fn(&Shape, &Pose) -> Vec<Capsule>,
        field: impl Fn(&HeightField, &Pose) -> Vec<Capsule>,
    ) -> Vec<Capsule> {
        let grounds = self.grounds().flat_map(|(form, pose)| match form {
            GroundForm::Plane if is_level(&pose) => Vec::new(),
            GroundForm::Plane => {
                let (shape, pose) = slab(&pose);
                solid(&shape, &pose)
            }
            GroundForm::Solid(shape) => solid(shape, &pose),
            GroundForm::Field(heights) => field(heights, &pose),
        });
        let is_near = |number: &f32| number.abs() <= FARTHEST;
        let is_drawn = |capsule: &Capsule| {
            is_near(&capsule.radius) && capsule.ends.as_flattened().iter().all(is_near)
        };
        grounds.filter(is_drawn).collect()
    }

    /// Forms and poses of what is fixed.
    fn grounds(&self) -> impl Iterator<Item = (&GroundForm, Pose)> {
        let rises = self.conditions.as_ref().map_or(&[][..], |conditions| &conditions.rises);
        self.robot.blueprint.grounds.iter().enumerate().map(|(index, ground)| {
            let mut pose = ground.pose;
            if let Some((_, rise)) = rises.iter().find(|(raised, _)| *raised == index) {
                pose.translation.z += rise;
            }
            (&ground.form, pose)
        })
    }
}

/// The capsule that a shape's bounding box shows of the two of its axes that are least along y.
fn bar(shape: &Shape, pose: &Pose) -> Capsule {
    let [middle, half_sizes] = shape.bounding_box();
    let mut axes = [0, 1, 2].map(|axis| {
        let mut unit = Vector::ZERO;
        unit[axis] = 1.0;
        (pose.rotation * unit, half_sizes[axis])
    });
    axes.sort_by(|(a, _), (b, _)| a.y.abs().total_cmp(&b.y.abs()));
    axes[..2].sort_by(|(_, a), (_, b)| b.total_cmp(a));
    let [(axis, long), (_, radius), _] = axes;
    let centre = *pose * Vector::from_array(middle);
    let arm = axis * (long - radius);
    Capsule { ends: [centre - arm, centre + arm].map(|end| end.to_array()), radius }
}

/// A line along the highest points of a height field, seen along y.
fn crest(field: &HeightField, pose: &Pose) -> Vec<Capsule> {
    let runs_along_x = (pose.rotation * Vector::X).x.abs() >= (pose.rotation * Vector::Y).x.abs();
    let (rows, columns) = (field.rows(), field.columns);
    let points = if runs_along_x {
        sampled(columns)
            .map(|column| {
                let highest = (0..rows).map(|row| field.point(row, column).z).fold(0.0, f32::max);
                field.point(0, column).with_y(0.0).with_z(highest - LINE)
            })
            .collect::<Vec<_>>()
    } else {
        sampled(rows)
            .map(|row| {
                let highest =
                    (0..columns).map(|column| field.point(row, column).z).fold(0.0, f32::max);
                field.point(row, 0).with_x(0.0).with_z(highest - LINE)
            })
            .collect()
    };
    line(&points, pose)
}

/// Thin capsules from point to point.
fn line(points: &[Vector], pose: &Pose) -> Vec<Capsule> {
    let ends = points.windows(2).map(|ends| [ends[0], ends[1]]);
    ends.map(|ends| Capsule { ends: ends.map(|end| (*pose * end).to_array()), radius: LINE })
        .collect()
}

/// A ball or capsule itself, or the edges of the box around another shape.
fn outline(shape: &Shape, pose: &Pose) -> Vec<Capsule> {
    if let Shape::Sphere { .. } | Shape::Capsule { .. } = shape {
        let (position, quaternion) = parts(pose);
        let (link, shape) = (WORLD.to_owned(), shape.clone());
        return LinkShape { link, shape, position, quaternion }.capsules();
    }
    let [middle, half_sizes] = shape.bounding_box().map(Vector::from_array);
    let edge = |axis: usize, [a, b]: [f32; 2]| {
        let ends = [-1.0, 1.0].map(|end| {
            let mut signs = Vector::splat(end);
            (signs[(axis + 1) % 3], signs[(axis + 2) % 3]) = (a, b);
            middle + half_sizes * signs
        });
        line(&ends, pose)
    };
    let beside = [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]];
    (0..3).flat_map(|axis| beside.into_iter().flat_map(move |signs| edge(axis, signs))).collect()
}

/// Lines along rows and columns of a height field.
fn grid(field: &HeightField, pose: &Pose) -> Vec<Capsule> {
    let rows: Vec<usize> = sampled(field.rows()).collect();
    let columns: Vec<usize> = sampled(field.columns).collect();
    let along_x = rows.iter().map(|row| {
        columns.iter().map(|column| field.point(*row, *column)).collect::<Vec<Vector>>()
    });
    let along_y = columns
        .iter()
        .map(|column| rows.iter().map(|row| field.point(*row, *column)).collect::<Vec<Vector>>());
    along_x.chain(along_y).flat_map(|points| line(&points, pose)).collect()
}

fn is_level(plane: &Pose) -> bool {
    (plane.rotation * Vector::Z).z > LEVEL
}

/// A part of a plane, and the pose of its middle.
fn slab(plane: &Pose) -> (Shape, Pose) {
    let middle = Pose::from_translation(Vector::new(0.0, 0.0, -SLAB[2]));
    (Shape::Box { half_sizes: SLAB }, *plane * middle)
}

/// The top of a height field.
fn mesh(field: &HeightField) -> Hull {
    let rows: Vec<usize> = sampled(field.rows()).collect();
    let columns: Vec<usize> = sampled(field.columns).collect();
    let width = columns.len() as u32;
    let points = rows
        .iter()
        .flat_map(|row| columns.iter().map(|column| field.point(*row, *column).to_array()));
    let corners =
        (1..rows.len() as u32).flat_map(|row| (1..width).map(move |column| (row, column)));
    let triangles = corners.flat_map(|(row, column)| {
        // The first row has the largest y.
        let [right, right_above] = [row * width + column, (row - 1) * width + column];
        [[right - 1, right, right_above], [right - 1, right_above, right_above - 1]]
    });
    Hull { points: points.collect(), triangles: triangles.collect() }
}

/// At most [`MOST_ALONG`] of `count` indices, from the first to the last.
fn sampled(count: usize) -> impl Iterator<Item = usize> {
    let drawn = count.min(MOST_ALONG);
    (0..drawn).map(move |index| index * (count - 1) / (drawn - 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;
    use crate::world::EpisodeConditions;

    /// A floor, a step that is turned by a quarter about the vertical, and heights in m: 0, 0.2, 0.4 in the row
    /// with the larger y, 0.1, 0, 0.2 in the other.
    const WORLD_OF_A_BALL: &str = "<mujoco><asset><hfield name=\"field\" nrow=\"2\" ncol=\"3\" size=\"1 2 0.4 0.1\" \
        elevation=\"0 2 4 1 0 2\"/></asset><worldbody><geom type=\"plane\" size=\"1 1 1\"/>\
        <geom type=\"box\" size=\"2 0.3 0.1\" pos=\"5 0 0.1\" euler=\"0 0 90\"/>\
        <geom type=\"hfield\" hfield=\"field\" pos=\"0 0 1\"/>\
        <body pos=\"0 0 3\"><freejoint/><geom size=\"0.1\"/></body></worldbody></mujoco>";

    fn world() -> World {
        world_of(WORLD_OF_A_BALL)
    }

    fn world_of(model: &str) -> World {
        let model = |_: &str| Ok(model.as_bytes().to_vec());
        World::new(Arc::new(Robot::of_model("world.xml", model).unwrap()))
    }

    fn assert_near(found: &[f32], expected: &[f32]) {
        let is_near = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-6;
        assert!(found.len() == expected.len(), "{found:?}");
        assert!(found.iter().zip(expected).all(is_near), "{found:?} against {expected:?}");
    }

    #[test]
    fn fixed_shapes_are_the_solids_and_a_mesh_of_each_height_field() {
        let shapes = world().fixed_shapes();
        let [step, field] = &shapes[..] else { panic!("{shapes:?}") };
        assert_eq!((step.link.as_str(), step.position), ("world", [5.0, 0.0, 0.1]));
        assert_eq!(step.shape, Shape::Box { half_sizes: [2.0, 0.3, 0.1] });
        let Shape::Hull(mesh) = &field.shape else { panic!("{field:?}") };
        let heights: Vec<f32> = mesh.points.iter().map(|point| point[2]).collect();
        assert_near(&heights, &[0.0, 0.2, 0.4, 0.1, 0.0, 0.2]);
        assert_near(&mesh.points[0], &[-1.0, 2.0, 0.0]);
        assert_near(&mesh.points[5], &[1.0, -2.0, 0.2]);
        assert_eq!(mesh.triangles, [[3, 4, 1], [3, 1, 0], [4, 5, 2], [4, 2, 1]]);
    }

    #[test]
    fn from_the_side_a_step_is_a_bar_and_a_height_field_a_line_along_its_highest_points() {
        let capsules = world().fixed_capsules();
        let numbers: Vec<f32> = capsules
            .iter()
            .flat_map(|capsule| [capsule.ends.as_flattened(), &[capsule.radius]].concat())
            .collect();
        let expected = [
            [5.2, 0.0, 0.1, 4.8, 0.0, 0.1, 0.1],
            [-1.0, 0.0, 1.08, 0.0, 0.0, 1.18, 0.02],
            [0.0, 0.0, 1.18, 1.0, 0.0, 1.38, 0.02],
        ];
        assert_near(&numbers, expected.as_flattened());
    }

    #[test]
    fn outlines_are_the_edges_of_a_box_and_the_rows_and_columns_of_a_height_field() {
        let outlines = world().fixed_outlines();
        let lengths: Vec<f32> = outlines
            .iter()
            .map(|line| {
                let [from, to] = line.ends.map(Vector::from_array);
                (to - from).length()
            })
            .collect();
        assert_near(&lengths[..12], [[4.0; 4], [0.6; 4], [0.2; 4]].as_flattened());
        let rows: Vec<[[f32; 3]; 2]> = outlines[12..16].iter().map(|line| line.ends).collect();
        assert_near(rows[0].as_flattened(), &[-1.0, 2.0, 1.0, 0.0, 2.0, 1.2]);
        assert_near(rows[3].as_flattened(), &[0.0, -2.0, 1.0, 1.0, -2.0, 1.2]);
        // And a line along y for each of three columns.
        assert_eq!(outlines.len(), 19);
    }

    #[test]
    fn the_floor_is_the_highest_level_plane_at_the_height_of_the_episode() {
        let height = |planes: &str, rises: &[(usize, f32)]| {
            let ball = "<body pos=\"0 0 3\"><freejoint/><geom size=\"0.1\"/></body>";
            let mut world =
                world_of(&format!("<mujoco><worldbody>{planes}{ball}</worldbody></mujoco>"));
            world.set_conditions(EpisodeConditions { rises: rises.to_vec(), ..Default::default() });
            world.floor_height()
        };
        let plane = |place: &str| format!("<geom type=\"plane\" size=\"1 1 1\" {place}/>");
        let table = plane("pos=\"0 0 -0.4\"");
        let slope = plane("pos=\"0 0 2\" euler=\"0 20 0\"");
        assert_eq!(height("", &[]), None);
        assert_eq!(height(&slope, &[]), None);
        assert_eq!(height(&table, &[]), Some(-0.4));
        assert_eq!(height(&table, &[(0, 0.25)]), Some(-0.15));
        assert_eq!(height(&format!("{}{table}{slope}", plane("pos=\"0 0 -1\"")), &[]), Some(-0.4));
    }

    #[test]
    fn a_tilted_plane_is_a_slab_whose_upper_side_is_in_it() {
        let slope = "<geom type=\"plane\" size=\"1 1 1\" pos=\"0 0 2\" euler=\"0 90 0\"/>";
        let ball = "<body pos=\"0 0 3\"><freejoint/><geom size=\"0.1\"/></body>";
        let world = world_of(&format!("<mujoco><worldbody>{slope}{ball}</worldbody></mujoco>"));
        let shapes = world.fixed_shapes();
        assert_eq!(shapes[0].shape, Shape::Box { half_sizes: SLAB });
        assert_near(&shapes[0].position, &[-SLAB[2], 0.0, 2.0]);
        assert_eq!((world.fixed_capsules().len(), world.fixed_outlines().len()), (1, 12));
    }

    #[test]
    fn a_shape_that_the_episode_raises_is_drawn_at_its_height() {
        let mut world = world();
        let conditions = EpisodeConditions { rises: vec![(1, 0.25)], ..Default::default() };
        world.set_conditions(conditions);
        let shapes = world.fixed_shapes();
        assert_near(
            &[shapes[0].position, shapes[1].position].concat(),
            &[5.0, 0.0, 0.35, 0.0, 0.0, 1.0],
        );
        assert_near(&world.fixed_capsules()[0].ends[0], &[5.2, 0.0, 0.35]);
    }

    #[test]
    fn of_many_points_some_are_drawn_from_the_first_to_the_last() {
        assert_eq!(sampled(3).collect::<Vec<_>>(), [0, 1, 2]);
        let drawn: Vec<usize> = sampled(1000).collect();
        assert_eq!((drawn.len(), drawn[0], drawn[23]), (24, 0, 999));
    }
}
