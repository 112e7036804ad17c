//! One picture of a robot: every link in its driver's colour, every joint with its number.

use anyhow::Context as _;
use sim::Pose;
use tiny_skia::{Color, Pixmap};

use crate::film::camera::{self, Camera};
use crate::film::captions::Captions;
use crate::film::drawing;
use crate::film::shapes::RobotShapes;
use crate::film::sheet::{GAP, legend, paste, size};
use crate::film::solids::{self, Solid, View};

/// The PNG of a robot in a pose, seen from the side or, if it is wider than high, from above. `joints` are the places
/// in the world, metres, that get the numbers from 1 on.
///
/// # Errors
/// If the picture cannot be encoded.
pub(crate) fn portrait(
    robot: &RobotShapes,
    joints: &[[f32; 3]],
    pose: &Pose,
) -> anyhow::Result<Vec<u8>> {
    let view = view(robot, pose);
    let mut solids = solids::of_pose(robot, pose, view);
    let lift = match view {
        View::Side => 0.0,
        View::Above => -edges(&solids).0,
    };
    for [_, height] in solids.iter_mut().flat_map(|solid| &mut solid.ends) {
        *height += lift;
    }
    let middle = pose.links[0].position[0];
    let pixels_per_metre = camera::scale(std::slice::from_ref(&solids), &[middle]);
    let camera = Camera { middle, pixels_per_metre };
    let (width, height) = size(1, robot.agents);
    let mut sheet = Pixmap::new(width, height).context("cannot allocate a picture of this size")?;
    sheet.fill(Color::WHITE);
    let mut panel = match view {
        View::Side => drawing::panel(&solids, &camera),
        View::Above => drawing::panel_without_floor(&solids, &camera),
    };
    let mut captions = Captions::new(width, height);
    let places = joints.iter().map(|&point| {
        let [x, height] = view.plane(point);
        camera.pixel([x, height + lift])
    });
    for (number, (x, y)) in (1..).zip(side_by_side(places)) {
        drawing::sign(&mut panel, x, y);
        captions.number(number, GAP as f32 + x, GAP as f32 + y);
    }
    paste(&mut sheet, &panel, GAP, GAP);
    legend(&mut sheet, &mut captions, robot.agents);
    captions.print_on(&mut sheet)?;
    sheet.encode_png().context("cannot encode the picture")
}

/// From above if the robot is wider than high.
fn view(robot: &RobotShapes, pose: &Pose) -> View {
    let extent = |view| {
        let (low, high) = edges(&solids::of_pose(robot, pose, view));
        high - low
    };
    if extent(View::Above) > extent(View::Side) { View::Above } else { View::Side }
}

/// The lowest and the highest edge of all solids in the picture's plane, metres.
fn edges(solids: &[Solid]) -> (f32, f32) {
    let edges = solids.iter().flat_map(|solid| {
        solid.ends.map(|[_, height]| (height - solid.radius, height + solid.radius))
    });
    edges.fold((f32::MAX, f32::MIN), |(low, high), (bottom, top)| (low.min(bottom), high.max(top)))
}

/// The places of signs, pixels; those that would cover one before, such as the second of two hips, move to the right.
fn side_by_side(places: impl Iterator<Item = (f32, f32)>) -> Vec<(f32, f32)> {
    let apart = 2.0 * drawing::SIGN;
    let mut signs: Vec<(f32, f32)> = Vec::new();
    for (mut x, y) in places {
        while signs.iter().any(|sign| (sign.0 - x).abs() < apart && (sign.1 - y).abs() < apart) {
            x += apart;
        }
        signs.push((x, y));
    }
    signs
}
