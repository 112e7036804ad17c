//! The captions of a strip: times, metres, agents. kuva renders them with its own font.

use anyhow::Context as _;
use kuva::backend::png::PngBackend;
use kuva::render::render::{Primitive, Scene, TextAnchor};
use tiny_skia::{BlendMode, Pixmap, PixmapPaint, Transform};

use crate::film::camera::{Camera, HEIGHT, WIDTH};

/// Height of letters, pixels.
const TIME: u32 = 17;
const METRE: u32 = 13;
/// Smallest distance between a frame's edge and the middle of a number, pixels.
const HALF_NUMBER: f32 = 22.0;
const GREY: &str = "#3a4148";

/// Captions on their own white sheet.
pub(super) struct Captions(Scene);

impl Captions {
    /// An empty sheet; the size is in pixels.
    pub(super) fn new(width: u32, height: u32) -> Self {
        Self(Scene::new(f64::from(width), f64::from(height)))
    }

    /// A frame's time below it and its metres on the ground; `left` and `top` are its corner.
    pub(super) fn frame(&mut self, camera: &Camera, time_secs: f64, left: u32, top: u32) {
        let middle = left + WIDTH / 2;
        let below = f64::from(top + HEIGHT + 18);
        self.write(format!("{time_secs:.2} s"), f64::from(middle), below, TIME, TextAnchor::Middle);
        let inside = HALF_NUMBER..=WIDTH as f32 - HALF_NUMBER;
        for (metre, x) in camera.metres().filter(|(_, x)| inside.contains(x)) {
            let (x, y) = (f64::from(left) + f64::from(x), f64::from(top + HEIGHT - 10));
            self.write(format!("{metre} m"), x, y, METRE, TextAnchor::Middle);
        }
    }

    /// An agent's name right of `x`, its middle at the height `y`.
    pub(super) fn agent(&mut self, agent: usize, x: u32, y: u32) {
        let baseline = f64::from(y + 5);
        self.write(format!("agent {agent}"), f64::from(x), baseline, TIME, TextAnchor::Start);
    }

    /// A joint's number around a point, pixels.
    pub(super) fn number(&mut self, number: usize, x: f32, y: f32) {
        let baseline = f64::from(y) + 4.5;
        self.write(number.to_string(), f64::from(x), baseline, METRE, TextAnchor::Middle);
    }

    /// Draws the captions onto the sheet.
    pub(super) fn print_on(self, sheet: &mut Pixmap) -> anyhow::Result<()> {
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
