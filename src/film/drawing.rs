//! A robot's shapes as pixels: its capsules in a direction of view, the camera that keeps its root in the middle of the frame,
//! and the floor.

use clap::ValueEnum;
use sim::{LinkPose, Pose, link_colour};
use tiny_skia::{Color, FillRule, LineCap, Paint, PathBuilder, Pixmap, Rect, Stroke, Transform};

use crate::figures::style::Rgb;
use crate::film::RobotShapes;

/// All points of the picture's plane within the radius of the line between the ends: a capsule from any side, or a ball
/// if the ends are equal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ProjectedCapsule {
    /// In the picture's plane, metres: to the right and up.
    pub(super) ends: [[f32; 2]; 2],
    /// The ends of its shadow under a light straight above, in the picture's plane.
    pub(super) shadow: [[f32; 2]; 2],
    /// Metres.
    pub(super) radius: f32,
    /// Distance of the middle behind the plane, metres.
    pub(super) depth: f32,
    /// The agent that drives the joint of its link.
    pub(super) agent: Option<usize>,
}

/// Direction of view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ViewDirection {
    /// Along y: motion along x, and heights.
    Side,
    /// Down along z: the paths of all feet.
    Top,
    /// From the front right and 30 degrees above.
    ThreeQuarter,
}

impl ViewDirection {
    /// Unit vectors in the world: to the right, up, and away from the viewer.
    fn axes(self) -> [[f32; 3]; 3] {
        match self {
            Self::Side => [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
            Self::Top => [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]],
            Self::ThreeQuarter => {
                // Sine and cosine of 30 degrees.
                let (s, c) = (0.5, 0.75_f32.sqrt());
                [[c, s, 0.0], [-s * s, c * s, c], [-s * c, c * c, -s]]
            }
        }
    }

    /// A point of the world in the picture's plane, metres.
    pub(super) fn plane(self, point: [f32; 3]) -> [f32; 2] {
        let [right, up, _] = self.axes();
        [along(right, point), along(up, point)]
    }

    /// Distance of a point behind the plane, metres.
    fn depth(self, point: [f32; 3]) -> f32 {
        along(self.axes()[2], point)
    }
}

/// Scalar product.
fn along(axis: [f32; 3], point: [f32; 3]) -> f32 {
    axis.iter().zip(point).map(|(a, b)| a * b).sum()
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
                let ends = capsule.ends.map(|end| robot.above_floor(link.in_world(end)));
                let shadow = ends.map(|[x, y, _]| view.plane([x, y, 0.0]));
                let (radius, depth) = (capsule.radius, ends.map(|end| view.depth(end)));
                let (ends, depth) = (ends.map(|end| view.plane(end)), (depth[0] + depth[1]) / 2.0);
                ProjectedCapsule { ends, shadow, radius, depth, agent }
            })
        })
        .collect();
    capsules.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    capsules
}

/// What is fixed around a robot. It is painted before the robot, so that it hides nothing, and has no shadow.
pub(super) fn fixed(robot: &RobotShapes, view: ViewDirection) -> Vec<ProjectedCapsule> {
    let capsules = robot.fixed.iter().map(|capsule| {
        let ends = capsule.ends.map(|end| view.plane(robot.above_floor(end)));
        ProjectedCapsule { ends, shadow: ends, radius: capsule.radius, depth: 0.0, agent: None }
    });
    capsules.collect()
}

/// Size of a frame, pixels.
pub(super) const WIDTH: u32 = 480;
pub(super) const HEIGHT: u32 = 270;
/// Height of the ground under the floor's line in a view from the side, pixels.
pub(super) const GROUND: u32 = 34;
/// Pixels that stay free between a robot and the frame's edge.
const MARGIN: f32 = 16.0;
/// Largest scale, for small robots.
const LARGEST: f32 = 400.0;

/// One frame's view.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    /// Its direction.
    pub(super) view: ViewDirection,
    /// The point of the floor that the camera follows, which is in the middle between left and right.
    pub(super) on: [f32; 2],
    /// Scale.
    pub(super) pixels_per_metre: f32,
    /// Whether there is a floor to be seen.
    pub(super) has_floor: bool,
}

impl Camera {
    /// The camera that follows the root of a robot, at the largest scale at which its capsules fit.
    pub(super) fn of(
        (robot, view): (&RobotShapes, ViewDirection),
        capsules: &[ProjectedCapsule],
        root: &LinkPose,
    ) -> Self {
        let [x, y, _] = root.position;
        let has_floor = robot.floor.is_some();
        let camera = Self { view, on: [x, y], pixels_per_metre: LARGEST, has_floor };
        Self { pixels_per_metre: camera.fitting(capsules), ..camera }
    }

    /// Pixels right of and below the frame's upper left corner, for a point of the picture's plane.
    pub(super) fn pixel(&self, point: [f32; 2]) -> (f32, f32) {
        let [right, up] = self.offset(point).map(|metres| metres * self.pixels_per_metre);
        (WIDTH as f32 / 2.0 + right, self.horizon() - up)
    }

    /// From the followed point to one of the picture's plane, metres to the right and up.
    fn offset(&self, [right, up]: [f32; 2]) -> [f32; 2] {
        let [x, y] = self.on;
        let on = self.view.plane([x, y, 0.0]);
        [right - on[0], up - on[1]]
    }

    /// Pixels from the frame's upper edge to the followed point.
    fn horizon(&self) -> f32 {
        match self.view {
            ViewDirection::Side => (HEIGHT - GROUND) as f32,
            ViewDirection::Top => HEIGHT as f32 / 2.0,
            ViewDirection::ThreeQuarter => HEIGHT as f32 * 0.62,
        }
    }

    /// The whole metres of x in a frame from the side, and how many pixels from its left edge they are; none from above.
    pub(super) fn metres(&self) -> Vec<(i64, f32)> {
        if self.view != ViewDirection::Side {
            return Vec::new();
        }
        let half = WIDTH as f32 / 2.0 / self.pixels_per_metre;
        let spacing = spacing(half);
        let [first, last] = [self.on[0] - half, self.on[0] + half].map(|end| end / spacing);
        let marks = (first.ceil() as i64..=last.floor() as i64).map(|mark| mark as f32 * spacing);
        marks.map(|metre| (metre as i64, self.pixel([metre, 0.0]).0)).collect()
    }

    /// The largest scale at which the capsules fit, pixels per metre.
    fn fitting(&self, capsules: &[ProjectedCapsule]) -> f32 {
        let above = self.horizon() - MARGIN;
        let below = HEIGHT as f32 - self.horizon();
        let aside = WIDTH as f32 / 2.0 - MARGIN;
        let mut scale = LARGEST;
        for capsule in capsules {
            for [right, up] in capsule.ends.map(|end| self.offset(end)) {
                for (room, metres) in [(aside, right.abs()), (above, up), (below, -up)] {
                    let metres = metres + capsule.radius;
                    if metres > 0.0 {
                        scale = scale.min(room / metres);
                    }
                }
            }
        }
        scale
    }
}

const SKY: Rgb = [244, 246, 248];
const EARTH: Rgb = [222, 226, 230];
const FLOOR: Rgb = [90, 98, 106];
/// The floor's lines where it fills the frame.
const LINES: Rgb = [204, 210, 216];
const SHADOW: Rgb = [196, 201, 206];
/// Width of the edge around a capsule, pixels.
const EDGE: f32 = 1.5;
/// Length of a metre's mark on the floor, pixels.
const TICK: f32 = 8.0;

/// One frame without its captions. `capsules` are painted in their order.
pub(super) fn panel(capsules: &[ProjectedCapsule], camera: &Camera) -> Pixmap {
    let mut pixmap = Pixmap::new(WIDTH, HEIGHT).expect("a frame has a size");
    match camera.view {
        ViewDirection::Side => horizon(&mut pixmap, camera),
        ViewDirection::Top | ViewDirection::ThreeQuarter => {
            lines(&mut pixmap, camera);
            let shadows = capsules.iter().filter(|_| camera.has_floor);
            shadows.for_each(|capsule| shadow(&mut pixmap, capsule, camera));
        }
    }
    capsules.iter().for_each(|capsule| draw(&mut pixmap, capsule, camera));
    pixmap
}

/// An agent's mark in the legend.
pub(super) fn mark(pixmap: &mut Pixmap, x: f32, y: f32, agent: usize) {
    let fill = link_colour(Some(agent));
    rounded(pixmap, [(x, y); 2], 8.0, darker(fill));
    rounded(pixmap, [(x, y); 2], 8.0 - EDGE, fill);
}

/// The floor seen from its side, if there is one, with a mark at each whole metre.
fn horizon(pixmap: &mut Pixmap, camera: &Camera) {
    fill(pixmap, SKY);
    let top = camera.horizon();
    if camera.has_floor {
        rectangle(pixmap, [0.0, top, WIDTH as f32, GROUND as f32], EARTH);
        rectangle(pixmap, [0.0, top, WIDTH as f32, 2.0], FLOOR);
    }
    for (_, x) in camera.metres() {
        rectangle(pixmap, [x - 1.0, top, 2.0, TICK], FLOOR);
    }
}

/// Metres between the lines of a floor that is seen as far as `reach` metres: a whole number of which a picture holds few.
fn spacing(reach: f32) -> f32 {
    (reach / 50.0).ceil().max(1.0)
}

/// The floor seen from above, with lines at the whole metres of x and y.
fn lines(pixmap: &mut Pixmap, camera: &Camera) {
    fill(pixmap, SKY);
    let [x, y] = camera.on;
    // Twice the frame's width, because a view from obliquely above shortens the floor by half.
    let reach = 2.0 * WIDTH as f32 / camera.pixels_per_metre;
    let spacing = spacing(reach);
    let whole = |middle: f32| {
        let lines = ((middle - reach) / spacing).ceil() as i64
            ..=((middle + reach) / spacing).floor() as i64;
        lines.map(move |line| line as f32 * spacing)
    };
    let place = |x, y| camera.pixel(camera.view.plane([x, y, 0.0]));
    for metre in whole(x) {
        rounded(pixmap, [place(metre, y - reach), place(metre, y + reach)], 0.75, LINES);
    }
    for metre in whole(y) {
        rounded(pixmap, [place(x - reach, metre), place(x + reach, metre)], 0.75, LINES);
    }
}

fn shadow(pixmap: &mut Pixmap, capsule: &ProjectedCapsule, camera: &Camera) {
    let ends = capsule.shadow.map(|end| camera.pixel(end));
    rounded(pixmap, ends, capsule.radius * camera.pixels_per_metre, SHADOW);
}

fn draw(pixmap: &mut Pixmap, capsule: &ProjectedCapsule, camera: &Camera) {
    let ends = capsule.ends.map(|end| camera.pixel(end));
    let radius = capsule.radius * camera.pixels_per_metre;
    let fill = link_colour(capsule.agent);
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

fn fill(pixmap: &mut Pixmap, [red, green, blue]: Rgb) {
    pixmap.fill(Color::from_rgba8(red, green, blue, 255));
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

    fn side(x: f32) -> Camera {
        let has_floor = true;
        Camera { view: ViewDirection::Side, on: [x, 7.0], pixels_per_metre: 100.0, has_floor }
    }

    #[test]
    fn a_metre_to_the_right_and_up_is_the_scale_in_pixels() {
        let camera = side(5.0);
        assert_eq!(camera.pixel([5.0, 0.0]), (240.0, 236.0));
        assert_eq!(camera.pixel([6.0, 1.0]), (340.0, 136.0));
    }

    #[test]
    fn whole_metres_are_those_in_the_frame() {
        assert_eq!(side(5.5).metres(), [(4, 90.0), (5, 190.0), (6, 290.0), (7, 390.0)]);
    }

    #[test]
    fn the_axes_of_a_view_are_at_right_angles_of_length_one_and_right_handed() {
        for view in ViewDirection::value_variants() {
            let [right, up, away] = view.axes();
            for (first, second, product) in
                [(right, right, 1.0), (up, up, 1.0), (right, up, 0.0), (right, away, 0.0)]
            {
                assert!((along(first, second) - product).abs() < 1e-6, "{view:?}");
            }
            let [[a, b, c], [d, e, f]] = [right, up];
            let towards_viewer = [b * f - c * e, c * d - a * f, a * e - b * d];
            assert!((along(towards_viewer, away) + 1.0).abs() < 1e-6, "{view:?}");
        }
    }

    #[test]
    fn the_farthest_point_decides_the_scale() {
        let ball = |x: f32, z: f32| {
            let ends = [[x, z]; 2];
            [ProjectedCapsule { ends, shadow: ends, radius: 0.5, depth: 0.0, agent: None }]
        };
        let wide = side(10.0).fitting(&ball(12.3, 0.5));
        assert!((wide - 224.0 / 2.8).abs() < 1e-3, "{wide}");
        assert_eq!(side(0.0).fitting(&ball(0.0, 3.9)), 50.0);
        // In the middle of a frame from above, the followed point has room below it, too.
        let above = Camera {
            view: ViewDirection::Top,
            on: [0.0, 0.0],
            pixels_per_metre: 1.0,
            has_floor: true,
        };
        assert_eq!(above.fitting(&ball(0.0, -1.75)), 60.0);
    }
}
