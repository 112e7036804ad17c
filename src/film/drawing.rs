//! A robot's shapes as pixels: its capsules seen from the side or from above, the camera that keeps its root in the middle of
//! the frame, and the floor.

use sim::Pose;
use tiny_skia::{Color, FillRule, LineCap, Paint, PathBuilder, Pixmap, Rect, Stroke, Transform};

use crate::figures::style::{OKABE_ITO, Rgb};
use crate::film::RobotShapes;

/// All points of the picture's plane within the radius of the line between the ends: a capsule from any side, or a ball
/// if the ends are equal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ProjectedCapsule {
    /// In the picture's plane, metres: x, and z or y.
    pub(super) ends: [[f32; 2]; 2],
    /// Metres.
    pub(super) radius: f32,
    /// Distance of the middle behind the plane, metres.
    pub(super) depth: f32,
    /// The agent that drives the joint of its link.
    pub(super) agent: Option<usize>,
}

/// Direction of view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ViewDirection {
    /// Along y.
    Side,
    /// Down along z.
    Above,
}

impl ViewDirection {
    /// A point of the world in the picture's plane, metres.
    pub(super) fn plane(self, [x, y, z]: [f32; 3]) -> [f32; 2] {
        match self {
            Self::Side => [x, z],
            Self::Above => [x, y],
        }
    }

    /// Distance of a point behind the plane, metres.
    fn depth(self, [_, y, z]: [f32; 3]) -> f32 {
        match self {
            Self::Side => y,
            Self::Above => -z,
        }
    }
}

/// The capsules of a pose, the farthest first.
pub(super) fn capsules(
    robot: &RobotShapes,
    pose: &Pose,
    view: ViewDirection,
) -> Vec<ProjectedCapsule> {
    let links = pose.links.iter().zip(&robot.drivers);
    let mut capsules: Vec<ProjectedCapsule> = links
        .flat_map(|(link, &agent)| {
            let shapes = robot.shapes.iter().filter(|shape| shape.link == link.name);
            shapes.flat_map(|shape| shape.capsules()).map(move |capsule| {
                let ends = capsule.ends.map(|end| link.in_world(end));
                let (radius, depth) = (capsule.radius, ends.map(|end| view.depth(end)));
                let (ends, depth) = (ends.map(|end| view.plane(end)), (depth[0] + depth[1]) / 2.0);
                ProjectedCapsule { ends, radius, depth, agent }
            })
        })
        .collect();
    capsules.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    capsules
}

/// Size of a frame, pixels.
pub(super) const WIDTH: u32 = 400;
pub(super) const HEIGHT: u32 = 270;
/// Height of the ground under the floor's line, pixels.
pub(super) const GROUND: u32 = 34;
/// Pixels that stay free between a robot and the frame's edge.
const MARGIN: f32 = 16.0;
/// Largest scale, for small robots.
const LARGEST: f32 = 400.0;

/// One frame's view.
pub(super) struct Camera {
    /// The x in the middle of the frame, metres.
    pub(super) middle: f32,
    /// Scale.
    pub(super) pixels_per_metre: f32,
}

impl Camera {
    /// Pixels right of and below the frame's upper left corner, for an x and z in the world.
    pub(super) fn pixel(&self, [x, z]: [f32; 2]) -> (f32, f32) {
        let right = WIDTH as f32 / 2.0 + (x - self.middle) * self.pixels_per_metre;
        (right, (HEIGHT - GROUND) as f32 - z * self.pixels_per_metre)
    }

    /// The whole metres in the frame and how many pixels from its left edge they are.
    pub(super) fn metres(&self) -> impl Iterator<Item = (i64, f32)> {
        let half = WIDTH as f32 / 2.0 / self.pixels_per_metre;
        let first = (self.middle - half).ceil();
        let last = (self.middle + half).floor();
        (first as i64..=last as i64).map(|metre| (metre, self.pixel([metre as f32, 0.0]).0))
    }
}

/// Pixels per metre at which every frame's capsules fit, given each frame's middle.
pub(super) fn scale(frames: &[Vec<ProjectedCapsule>], middles: &[f32]) -> f32 {
    let mut scale = LARGEST;
    for (capsules, middle) in frames.iter().zip(middles) {
        for capsule in capsules {
            for [x, z] in capsule.ends {
                let aside = (x - middle).abs() + capsule.radius;
                let across = (WIDTH as f32 / 2.0 - MARGIN) / aside.max(f32::EPSILON);
                let upwards =
                    ((HEIGHT - GROUND) as f32 - MARGIN) / (z + capsule.radius).max(f32::EPSILON);
                scale = scale.min(across).min(upwards);
            }
        }
    }
    scale
}

const SKY: Rgb = [244, 246, 248];
const EARTH: Rgb = [222, 226, 230];
const FLOOR: Rgb = [90, 98, 106];
/// Colour of links that no agent drives.
const UNDRIVEN: Rgb = [152, 158, 164];
/// Width of the edge around a capsule, pixels.
const EDGE: f32 = 1.5;
/// Radius of a disc that holds a number, pixels.
pub(super) const SIGN: f32 = 9.0;
/// Length of a metre's mark on the floor, pixels.
const TICK: f32 = 8.0;

/// One frame without its captions. `capsules` are painted in their order.
pub(super) fn panel(capsules: &[ProjectedCapsule], camera: &Camera) -> Pixmap {
    let mut pixmap = sky();
    floor(&mut pixmap, camera);
    draw_all(&mut pixmap, capsules, camera);
    pixmap
}

/// Solids alone, painted in their order.
pub(super) fn panel_without_floor(capsules: &[ProjectedCapsule], camera: &Camera) -> Pixmap {
    let mut pixmap = sky();
    draw_all(&mut pixmap, capsules, camera);
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

fn draw_all(pixmap: &mut Pixmap, capsules: &[ProjectedCapsule], camera: &Camera) {
    for capsule in capsules {
        draw(pixmap, capsule, camera);
    }
}

fn draw(pixmap: &mut Pixmap, capsule: &ProjectedCapsule, camera: &Camera) {
    let ends = capsule.ends.map(|end| camera.pixel(end));
    let radius = capsule.radius * camera.pixels_per_metre;
    let fill = colour(capsule.agent);
    rounded(pixmap, ends, radius, darker(fill));
    rounded(pixmap, ends, (radius - EDGE).max(0.0), fill);
}

/// Dark enough for an edge; black, which cannot be darker, gets a lighter one.
fn darker(colour: Rgb) -> Rgb {
    if colour == [0; 3] { [96; 3] } else { colour.map(|part| (f32::from(part) * 0.6) as u8) }
}

/// Fills everything within the radius of a line, pixels.
fn rounded(pixmap: &mut Pixmap, [from, to]: [(f32, f32); 2], radius: f32, colour: Rgb) {
    let paint = paint(colour);
    let still = Transform::identity();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_metre_to_the_right_and_up_is_the_scale_in_pixels() {
        let camera = Camera { middle: 5.0, pixels_per_metre: 100.0 };
        assert_eq!(camera.pixel([5.0, 0.0]), (200.0, 236.0));
        assert_eq!(camera.pixel([6.0, 1.0]), (300.0, 136.0));
    }

    #[test]
    fn whole_metres_are_those_in_the_frame() {
        let camera = Camera { middle: 5.5, pixels_per_metre: 100.0 };
        let metres: Vec<_> = camera.metres().collect();
        assert_eq!(metres, [(4, 50.0), (5, 150.0), (6, 250.0), (7, 350.0)]);
    }

    #[test]
    fn the_farthest_point_of_any_frame_decides_the_scale() {
        let ball = |x: f32, z: f32| {
            vec![ProjectedCapsule { ends: [[x, z]; 2], radius: 0.5, depth: 0.0, agent: None }]
        };
        let wide = scale(&[ball(0.0, 0.5), ball(12.3, 0.5)], &[0.0, 10.0]);
        assert!((wide - 184.0 / 2.8).abs() < 1e-3, "{wide}");
        let tall = scale(&[ball(0.0, 3.9)], &[0.0]);
        assert_eq!(tall, 50.0);
    }
}
