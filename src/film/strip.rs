//! Film strips: a robot at chosen times, seen from the side, as one PNG.

use anyhow::Context as _;
use sim::Pose;
use tiny_skia::{Color, Pixmap};

use crate::film::camera::{self, Camera};
use crate::film::captions::Captions;
use crate::film::drawing;
use crate::film::shapes::RobotShapes;
use crate::film::sheet::{CAPTION, COLUMNS, GAP, legend, paste, size};
use crate::film::solids::{self, Solid, View};

/// A pose to be drawn.
pub(crate) struct Frame<'a> {
    /// Time since the start of the episode.
    pub(crate) time_secs: f64,
    /// Where the links are.
    pub(crate) pose: &'a Pose,
}

/// The PNG of a strip: the frames row by row at one scale, and a legend of the agents' colours.
///
/// # Errors
/// If the picture cannot be encoded.
pub(crate) fn strip(robot: &RobotShapes, frames: &[Frame<'_>]) -> anyhow::Result<Vec<u8>> {
    let seen: Vec<Vec<Solid>> =
        frames.iter().map(|frame| solids::of_pose(robot, frame.pose, View::Side)).collect();
    let roots: Vec<f32> = frames.iter().map(|frame| frame.pose.links[0].position[0]).collect();
    let pixels_per_metre = camera::scale(&seen, &roots);
    let (width, height) = size(frames.len(), robot.agents);
    let mut sheet = Pixmap::new(width, height).context("cannot allocate a picture of this size")?;
    sheet.fill(Color::WHITE);
    let mut captions = Captions::new(width, height);
    for (index, frame) in frames.iter().enumerate() {
        let (left, top) = place(index as u32);
        let camera = Camera { middle: roots[index], pixels_per_metre };
        let panel = drawing::panel(&seen[index], &camera);
        paste(&mut sheet, &panel, left, top);
        captions.frame(&camera, frame.time_secs, left, top);
    }
    legend(&mut sheet, &mut captions, robot.agents);
    captions.print_on(&mut sheet)?;
    sheet.encode_png().context("cannot encode the picture")
}

/// Upper left corner of a frame, pixels.
fn place(index: u32) -> (u32, u32) {
    let (row, column) = (index / COLUMNS, index % COLUMNS);
    (GAP + column * (camera::WIDTH + GAP), GAP + row * (camera::HEIGHT + CAPTION))
}
