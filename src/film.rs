//! Episodes and pictures of robots: animations, film strips, and what an episode measures.
//! Every link has the colour of the agent that drives it.

mod animation;
mod drawing;
mod episode;

use anyhow::Context as _;
use kuva::backend::png::PngBackend;
use kuva::render::render::{Primitive, Scene, TextAnchor};
use sim::{Capsule, EnvironmentBatch, LinkShape, Pose};
use tiny_skia::{BlendMode, Color, Pixmap, PixmapPaint, Transform};

use crate::film::drawing::{Camera, HEIGHT, ProjectedCapsule, WIDTH};

pub(crate) use animation::{Animation, FFMPEG};
pub(crate) use drawing::ViewDirection;
pub(crate) use episode::PlayedEpisode;

/// What stays the same from frame to frame of an episode.
pub(crate) struct RobotShapes {
    shapes: Vec<LinkShape>,
    /// What is fixed around it, in the world.
    fixed: Vec<Capsule>,
    /// Height of the floor in the world, metres, if there is one.
    floor: Option<f32>,
    /// For each link of a pose, the agent that drives its joint.
    drivers: Vec<Option<usize>>,
    agents: usize,
}

impl RobotShapes {
    /// The shapes of the simulated robot and its world in the current episode of environment 0; `None` for a game.
    pub(crate) fn of(world: &dyn EnvironmentBatch) -> Option<Self> {
        let description = world.description();
        let drivers = sim::drivers(world);
        let simulated = world.world(0)?;
        let (shapes, fixed) = (simulated.robot().shapes(), simulated.fixed_outlines());
        let floor = simulated.floor_height();
        Some(Self { shapes, fixed, floor, drivers, agents: description.agents.len() })
    }

    /// A point of the world in coordinates whose origin is on the floor, metres.
    fn above_floor(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        [x, y, z - self.floor.unwrap_or(0.0)]
    }
}

/// A pose to be drawn.
pub(crate) struct TimedPose<'a> {
    /// Time since the start of the episode.
    pub(crate) time_secs: f64,
    /// Where the links are.
    pub(crate) pose: &'a Pose,
}

/// The camera of each frame and what it shows, what is fixed first, at the one scale at which the robot fits into all frames.
fn views(
    robot: &RobotShapes,
    frames: &[TimedPose<'_>],
    view: ViewDirection,
) -> Vec<(Camera, Vec<ProjectedCapsule>)> {
    let shown = |frame: &TimedPose<'_>| {
        let capsules = drawing::capsules(robot, frame.pose, view);
        (Camera::of((robot, view), &capsules, frame.pose.root()), capsules)
    };
    let mut views: Vec<_> = frames.iter().map(shown).collect();
    let scales = views.iter().map(|(camera, _)| camera.pixels_per_metre);
    let pixels_per_metre = scales.fold(f32::INFINITY, f32::min);
    let fixed = drawing::fixed(robot, view);
    for (camera, capsules) in &mut views {
        camera.pixels_per_metre = pixels_per_metre;
        capsules.splice(0..0, fixed.iter().copied());
    }
    views
}

/// The PNG of a strip: the frames row by row at one scale, and a legend of the agents' colours.
///
/// # Errors
/// If the picture cannot be encoded.
pub(crate) fn strip(
    robot: &RobotShapes,
    frames: &[TimedPose<'_>],
    view: ViewDirection,
) -> anyhow::Result<Vec<u8>> {
    let (mut sheet, mut captions) = white(size(frames.len(), robot.agents))?;
    for (index, (camera, capsules)) in views(robot, frames, view).iter().enumerate() {
        let (left, top) = place(index as u32);
        paste(&mut sheet, &drawing::panel(capsules, camera), left, top);
        captions.frame(camera, frames[index].time_secs, left, top);
    }
    label(&mut sheet, captions, robot.agents)?;
    sheet.encode_png().context("cannot encode the picture")
}

/// A white sheet of a width and height in pixels, and its captions.
fn white((width, height): (u32, u32)) -> anyhow::Result<(Pixmap, Captions)> {
    let mut sheet = Pixmap::new(width, height).context("cannot allocate a picture of this size")?;
    sheet.fill(Color::WHITE);
    Ok((sheet, Captions::new(width, height)))
}

/// Draws the legend and all captions onto the sheet.
fn label(sheet: &mut Pixmap, mut captions: Captions, agents: usize) -> anyhow::Result<()> {
    legend(sheet, &mut captions, agents);
    captions.print_on(sheet)
}

/// Upper left corner of a frame, pixels.
fn place(index: u32) -> (u32, u32) {
    let row = index / COLUMNS;
    let column = index % COLUMNS;
    (GAP + column * (WIDTH + GAP), GAP + row * (HEIGHT + CAPTION))
}

/// The picture of a robot in a pose from the side, without captions: at the scale that leaves a margin around the pose
/// `rest`, so that pictures of a motion have one scale, or at a smaller one if the pose needs it.
pub(crate) fn still(robot: &RobotShapes, rest: &Pose, pose: &Pose) -> Pixmap {
    let [(at_rest, _), (mut camera, capsules)] = [rest, pose].map(|pose| {
        let capsules = drawing::capsules(robot, pose, ViewDirection::Side);
        (Camera::of((robot, ViewDirection::Side), &capsules, pose.root()), capsules)
    });
    camera.pixels_per_metre = camera.pixels_per_metre.min(REST_SCALE * at_rest.pixels_per_metre);
    drawing::panel(&capsules, &camera)
}

/// Scale of a picture as share of the largest at which the rest pose fits.
const REST_SCALE: f32 = 0.75;

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

/// Width and height of a strip, pixels.
fn size(frames: usize, agents: usize) -> (u32, u32) {
    let frames = frames as u32;
    let width = GAP + frames.min(COLUMNS) * (WIDTH + GAP);
    let rows = frames.div_ceil(COLUMNS) * (HEIGHT + CAPTION);
    (width, GAP + rows + legend_height(width, agents))
}

/// Height of the legend below pictures of this width, pixels.
fn legend_height(width: u32, agents: usize) -> u32 {
    LEGEND * (agents as u32).div_ceil(entries(width))
}

/// Agents in a row of the legend.
fn entries(width: u32) -> u32 {
    (width - GAP) / LEGEND_ENTRY
}

/// A disc and a name for each agent, below the frames.
fn legend(sheet: &mut Pixmap, captions: &mut Captions, agents: usize) {
    let in_row = entries(sheet.width());
    let top = sheet.height() - legend_height(sheet.width(), agents);
    for agent in 0..agents {
        let row = agent as u32 / in_row;
        let column = agent as u32 % in_row;
        let x = GAP + column * LEGEND_ENTRY;
        let y = top + row * LEGEND + LEGEND / 2;
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

/// Height of letters, pixels.
const TIME: u32 = 17;
const METRE: u32 = 13;
/// Smallest distance between a frame's edge and the middle of a number, pixels.
const HALF_NUMBER: f32 = 22.0;
const GREY: &str = "#3a4148";

/// Captions on their own white sheet.
struct Captions(Scene);

impl Captions {
    /// An empty sheet; the size is in pixels.
    fn new(width: u32, height: u32) -> Self {
        Self(Scene::new(f64::from(width), f64::from(height)))
    }

    /// A frame's time below it and its metres on the ground; `left` and `top` are its corner.
    fn frame(&mut self, camera: &Camera, time_secs: f64, left: u32, top: u32) {
        let middle = left + WIDTH / 2;
        let below = f64::from(top + HEIGHT + 18);
        self.write(format!("{time_secs:.2} s"), f64::from(middle), below, TIME, TextAnchor::Middle);
        let inside = HALF_NUMBER..=WIDTH as f32 - HALF_NUMBER;
        for (metre, x) in camera.metres().into_iter().filter(|(_, x)| inside.contains(x)) {
            let x = f64::from(left) + f64::from(x);
            let y = f64::from(top + HEIGHT - 10);
            self.write(format!("{metre} m"), x, y, METRE, TextAnchor::Middle);
        }
    }

    /// An agent's name right of `x`, its middle at the height `y`.
    fn agent(&mut self, agent: usize, x: u32, y: u32) {
        let baseline = f64::from(y + 5);
        self.write(format!("agent {agent}"), f64::from(x), baseline, TIME, TextAnchor::Start);
    }

    /// Draws the captions onto the sheet.
    fn print_on(self, sheet: &mut Pixmap) -> anyhow::Result<()> {
        let backend = PngBackend::new().with_scale(1.0);
        let png = backend.render_scene(&self.0).map_err(anyhow::Error::msg)?;
        let words = Pixmap::decode_png(&png).context("cannot read the captions")?;
        let paint = PixmapPaint { blend_mode: BlendMode::Multiply, ..PixmapPaint::default() };
        sheet.draw_pixmap(0, 0, words.as_ref(), &paint, Transform::identity(), None);
        Ok(())
    }

    fn write(&mut self, content: String, x: f64, y: f64, size: u32, anchor: TextAnchor) {
        let color = Some(GREY.into());
        self.0.add(Primitive::Text {
            x,
            y,
            content,
            size,
            anchor,
            rotate: None,
            bold: false,
            color,
        });
    }
}

#[cfg(test)]
mod tests;
