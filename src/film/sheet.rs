//! The sheet of a picture: its size, its panels and its legend.

use tiny_skia::{Pixmap, PixmapPaint, Transform};

use crate::film::captions::Captions;
use crate::film::{camera, drawing};

/// Frames side by side in a full row.
pub(super) const COLUMNS: u32 = 4;
/// Pixels between frames and around them.
pub(super) const GAP: u32 = 12;
/// Height of the line under a frame that holds its time, pixels.
pub(super) const CAPTION: u32 = 26;
/// Height of a row of the legend, pixels.
const LEGEND: u32 = 30;
/// Width of an agent in the legend, pixels.
const LEGEND_ENTRY: u32 = 100;

/// Width and height of a strip, pixels.
pub(super) fn size(frames: usize, agents: usize) -> (u32, u32) {
    let frames = frames as u32;
    let width = GAP + frames.min(COLUMNS) * (camera::WIDTH + GAP);
    let rows = frames.div_ceil(COLUMNS) * (camera::HEIGHT + CAPTION);
    (width, GAP + rows + LEGEND * (agents as u32).div_ceil(entries(width)))
}

/// Agents in a row of the legend.
fn entries(width: u32) -> u32 {
    (width - GAP) / LEGEND_ENTRY
}

/// A disc and a name for each agent, below the frames.
pub(super) fn legend(sheet: &mut Pixmap, captions: &mut Captions, agents: usize) {
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

pub(super) fn paste(sheet: &mut Pixmap, picture: &Pixmap, left: u32, top: u32) {
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
