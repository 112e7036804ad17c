//! Film strips: a robot seen from the side at chosen moments, as one PNG; and a robot's portrait. Draws what shapes and poses say; knows
//! no robot by its name, no policy and no file.

mod camera;
mod captions;
mod drawing;
mod portrait;
mod solids;

use anyhow::Context as _;
use sim::{Description, LinkShape, Pose};
use tiny_skia::{Color, Pixmap, PixmapPaint, Transform};

use crate::film::camera::Camera;
use crate::film::captions::Captions;
pub(crate) use crate::film::portrait::portrait;
use crate::film::solids::{Solid, View};

/// Frames side by side in a full row.
const COLUMNS: u32 = 4;
/// Pixels between frames and around them.
const GAP: u32 = 12;
/// Height of the line under a frame that holds its time, pixels.
const CAPTION: u32 = 26;
/// Height of a row of the legend, pixels.
const LEGEND: u32 = 30;
/// Width of an agent in the legend, pixels.
const LEGEND_ENTRY: u32 = 100;

/// Who is seen: what stays the same from frame to frame.
pub(crate) struct Cast {
    shapes: Vec<LinkShape>,
    /// For each link of a pose the agent that drives its joint, if any does.
    drivers: Vec<Option<usize>>,
    agents: usize,
}

impl Cast {
    /// The shapes of a robot, and of any of its poses who drives what.
    pub(crate) fn new(description: &Description, shapes: Vec<LinkShape>, pose: &Pose) -> Self {
        let drivers = sim::drivers(description, pose);
        Self { shapes, drivers, agents: description.agents.len() }
    }
}

/// A moment to be drawn.
pub(crate) struct Frame<'a> {
    /// Since the episode began.
    pub(crate) time_secs: f64,
    /// Where the links are.
    pub(crate) pose: &'a Pose,
}

/// Whether the root's upper side points down.
pub(crate) fn is_upside_down(pose: &Pose) -> bool {
    sim::rotated(pose.links[0].quaternion, [0.0, 0.0, 1.0])[2] < 0.0
}

/// Width and height of a strip, pixels.
pub(crate) fn size(frames: usize, agents: usize) -> (u32, u32) {
    let frames = frames as u32;
    let width = GAP + frames.min(COLUMNS) * (camera::WIDTH + GAP);
    let rows = frames.div_ceil(COLUMNS) * (camera::HEIGHT + CAPTION);
    (width, GAP + rows + LEGEND * (agents as u32).div_ceil(entries(width)))
}

/// The PNG of a strip: the frames row by row, all at the same scale, and whose colour is which.
///
/// # Errors
/// If the picture cannot be encoded.
pub(crate) fn strip(cast: &Cast, frames: &[Frame<'_>]) -> anyhow::Result<Vec<u8>> {
    let seen: Vec<Vec<Solid>> =
        frames.iter().map(|frame| solids::of_pose(cast, frame.pose, View::Side)).collect();
    let roots: Vec<f32> = frames.iter().map(|frame| frame.pose.links[0].position[0]).collect();
    let pixels_per_metre = camera::scale(&seen, &roots);
    let (width, height) = size(frames.len(), cast.agents);
    let mut sheet = Pixmap::new(width, height).context("a picture of this size has no room")?;
    sheet.fill(Color::WHITE);
    let mut captions = Captions::new(width, height);
    for (index, frame) in frames.iter().enumerate() {
        let (left, top) = place(index as u32);
        let camera = Camera { middle: roots[index], pixels_per_metre };
        let panel = drawing::panel(&seen[index], &camera);
        paste(&mut sheet, &panel, left, top);
        captions.frame(&camera, frame.time_secs, left, top);
    }
    legend(&mut sheet, &mut captions, cast.agents);
    captions.print_on(&mut sheet)?;
    sheet.encode_png().context("cannot encode the picture")
}

/// Upper left corner of a frame, pixels.
fn place(index: u32) -> (u32, u32) {
    let (row, column) = (index / COLUMNS, index % COLUMNS);
    (GAP + column * (camera::WIDTH + GAP), GAP + row * (camera::HEIGHT + CAPTION))
}

/// Agents in a row of the legend.
fn entries(width: u32) -> u32 {
    (width - GAP) / LEGEND_ENTRY
}

/// A disc and a name for each agent, below the frames.
fn legend(sheet: &mut Pixmap, captions: &mut Captions, agents: usize) {
    let in_row = entries(sheet.width());
    let rows = (agents as u32).div_ceil(in_row);
    let top = sheet.height() - rows * LEGEND;
    for agent in 0..agents {
        let (row, column) = (agent as u32 / in_row, agent as u32 % in_row);
        let (x, y) = (GAP + column * LEGEND_ENTRY, top + row * LEGEND + LEGEND / 3);
        drawing::mark(sheet, x as f32 + 8.0, y as f32, agent);
        captions.agent(agent, x + 22, y);
    }
}

fn paste(sheet: &mut Pixmap, picture: &Pixmap, left: u32, top: u32) {
    let paint = PixmapPaint::default();
    sheet.draw_pixmap(
        left as i32,
        top as i32,
        picture.as_ref(),
        &paint,
        Transform::identity(),
        None,
    );
}

#[cfg(test)]
mod tests;
