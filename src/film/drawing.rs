//! Solids and floor as pixels.

use tiny_skia::{Color, FillRule, LineCap, Paint, PathBuilder, Pixmap, Rect, Stroke, Transform};

use crate::figures::palette::{OKABE_ITO, Rgb};
use crate::film::camera::{Camera, GROUND, HEIGHT, WIDTH};
use crate::film::solids::Solid;

const SKY: Rgb = [244, 246, 248];
const EARTH: Rgb = [222, 226, 230];
const FLOOR: Rgb = [90, 98, 106];
/// Colour of links that no agent drives.
const UNDRIVEN: Rgb = [152, 158, 164];
/// Width of the edge around a solid, pixels.
const EDGE: f32 = 1.5;
/// Radius of a disc that holds a number, pixels.
pub(super) const SIGN: f32 = 9.0;
/// Length of a metre's mark on the floor, pixels.
const TICK: f32 = 8.0;

/// One frame without its captions. `solids` are painted in their order.
pub(super) fn panel(solids: &[Solid], camera: &Camera) -> Pixmap {
    let mut pixmap = sky();
    floor(&mut pixmap, camera);
    draw_all(&mut pixmap, solids, camera);
    pixmap
}

/// Solids alone, painted in their order.
pub(super) fn panel_without_floor(solids: &[Solid], camera: &Camera) -> Pixmap {
    let mut pixmap = sky();
    draw_all(&mut pixmap, solids, camera);
    pixmap
}

/// A white disc for a number.
pub(super) fn sign(pixmap: &mut Pixmap, x: f32, y: f32) {
    rounded(pixmap, [(x, y); 2], SIGN, FLOOR);
    rounded(pixmap, [(x, y); 2], SIGN - EDGE, [255; 3]);
}

/// An agent's mark in the legend.
pub(super) fn mark(pixmap: &mut Pixmap, x: f32, y: f32, agent: usize) {
    let fill = colour(Some(agent));
    rounded(pixmap, [(x, y); 2], 8.0, darker(fill));
    rounded(pixmap, [(x, y); 2], 8.0 - EDGE, fill);
}

/// Colour of a link whose joint this agent drives.
pub(super) fn colour(agent: Option<usize>) -> Rgb {
    agent.map_or(UNDRIVEN, |agent| OKABE_ITO[agent % OKABE_ITO.len()])
}

fn floor(pixmap: &mut Pixmap, camera: &Camera) {
    let top = (HEIGHT - GROUND) as f32;
    rectangle(pixmap, [0.0, top, WIDTH as f32, GROUND as f32], EARTH);
    rectangle(pixmap, [0.0, top, WIDTH as f32, 2.0], FLOOR);
    for (_, x) in camera.metres() {
        rectangle(pixmap, [x - 1.0, top, 2.0, TICK], FLOOR);
    }
}

fn sky() -> Pixmap {
    let mut pixmap = Pixmap::new(WIDTH, HEIGHT).expect("a frame has a size");
    pixmap.fill(Color::from_rgba8(SKY[0], SKY[1], SKY[2], 255));
    pixmap
}

fn draw_all(pixmap: &mut Pixmap, solids: &[Solid], camera: &Camera) {
    for solid in solids {
        draw(pixmap, solid, camera);
    }
}

fn draw(pixmap: &mut Pixmap, solid: &Solid, camera: &Camera) {
    let ends = solid.ends.map(|end| camera.pixel(end));
    let radius = solid.radius * camera.pixels_per_metre;
    let fill = colour(solid.agent);
    rounded(pixmap, ends, radius, darker(fill));
    rounded(pixmap, ends, (radius - EDGE).max(0.0), fill);
}

/// Dark enough for an edge; black, which cannot be darker, gets a lighter one.
fn darker(colour: Rgb) -> Rgb {
    if colour == [0; 3] { [96; 3] } else { colour.map(|part| (f32::from(part) * 0.6) as u8) }
}

/// Fills everything within the radius of a line, pixels.
fn rounded(pixmap: &mut Pixmap, [from, to]: [(f32, f32); 2], radius: f32, colour: Rgb) {
    let (paint, still) = (paint(colour), Transform::identity());
    // Lines that end where they begin may be left out by a stroke.
    if (to.0 - from.0).abs() + (to.1 - from.1).abs() < 0.1 {
        if let Some(disc) = PathBuilder::from_circle(from.0, from.1, radius) {
            pixmap.fill_path(&disc, &paint, FillRule::Winding, still, None);
        }
        return;
    }
    let mut line = PathBuilder::new();
    line.move_to(from.0, from.1);
    line.line_to(to.0, to.1);
    let stroke = Stroke { width: 2.0 * radius, line_cap: LineCap::Round, ..Stroke::default() };
    if let Some(line) = line.finish() {
        pixmap.stroke_path(&line, &paint, &stroke, still, None);
    }
}

/// Left, top, width and height in pixels.
fn rectangle(pixmap: &mut Pixmap, [left, top, width, height]: [f32; 4], colour: Rgb) {
    if let Some(area) = Rect::from_xywh(left, top, width, height) {
        pixmap.fill_rect(area, &paint(colour), Transform::identity(), None);
    }
}

fn paint([red, green, blue]: Rgb) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color_rgba8(red, green, blue, 255);
    paint
}
