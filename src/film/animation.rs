//! An episode as an animation: a GIF, or a video that ffmpeg encodes.

use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::Context as _;
use gif::{DisposalMethod, Encoder, Frame, Repeat};
use tiny_skia::{Pixmap, PremultipliedColorU8};

use super::{RobotShapes, TimedPose, drawing};
use crate::figures::style::Rgb;
use crate::film::drawing::{Camera, HEIGHT, ProjectedCapsule, ViewDirection, WIDTH};

/// The program that encodes videos.
pub(crate) const FFMPEG: &str = "ffmpeg";

/// Frames at equal intervals, with a legend of the agents' colours. The camera follows the robot.
pub(crate) struct Animation {
    /// The legend below the place of a frame.
    sheet: Pixmap,
    views: Vec<(Camera, Vec<ProjectedCapsule>)>,
    every_secs: f64,
}

impl Animation {
    /// `frames` at one scale, `every_secs` seconds apart.
    ///
    /// # Errors
    /// If the legend cannot be drawn.
    pub(crate) fn of(
        robot: &RobotShapes,
        frames: &[TimedPose<'_>],
        view: ViewDirection,
        every_secs: f64,
    ) -> anyhow::Result<Self> {
        let height = HEIGHT + super::legend_height(WIDTH, robot.agents);
        let (mut sheet, captions) = super::white((WIDTH, height))?;
        super::label(&mut sheet, captions, robot.agents)?;
        Ok(Self { sheet, views: super::views(robot, frames, view), every_secs })
    }

    /// Draws one picture after the other.
    fn pictures(&self) -> impl Iterator<Item = Pixmap> {
        self.views.iter().map(|(camera, capsules)| {
            let mut picture = self.sheet.clone();
            super::paste(&mut picture, &drawing::panel(capsules, camera), 0, 0);
            picture
        })
    }

    /// A GIF that repeats for ever. Pixels that stay as they were are transparent, which compresses well.
    ///
    /// # Errors
    /// If the pictures cannot be encoded.
    pub(crate) fn gif(&self) -> anyhow::Result<Vec<u8>> {
        let palette = Palette::of(self.pictures());
        let (width, height) = (self.sheet.width() as u16, self.sheet.height() as u16);
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, width, height, palette.colours.as_flattened())?;
        encoder.set_repeat(Repeat::Infinite)?;
        let mut shown = vec![TRANSPARENT; self.sheet.pixels().len()];
        for (index, picture) in self.pictures().enumerate() {
            let pixels = palette.indices(&picture);
            let changes = pixels.iter().zip(&shown);
            let changes =
                changes.map(|(now, before)| if now == before { TRANSPARENT } else { *now });
            let frame = Frame {
                width,
                height,
                delay: (self.hundredths(index + 1) - self.hundredths(index)) as u16,
                transparent: Some(TRANSPARENT),
                dispose: DisposalMethod::Keep,
                buffer: Cow::Owned(changes.collect()),
                ..Frame::default()
            };
            encoder.write_frame(&frame).context("cannot encode the animation")?;
            shown = pixels;
        }
        drop(encoder);
        Ok(bytes)
    }

    /// When picture `index` is shown, in hundredths of a second, the unit of a GIF.
    fn hundredths(&self, index: usize) -> f64 {
        (index as f64 * self.every_secs * 100.0).round()
    }

    /// Has ffmpeg write a video to `path`, whose extension selects the format.
    ///
    /// # Errors
    /// If ffmpeg cannot be started or fails; the message is its own.
    pub(crate) fn video(&self, path: &Path) -> anyhow::Result<()> {
        let size = format!("{}x{}", self.sheet.width(), self.sheet.height());
        let rate = (1.0 / self.every_secs).to_string();
        // Without this prefix a colon in the path would end the name of a protocol.
        let mut file = OsString::from("file:");
        file.push(path);
        let mut ffmpeg = Command::new(FFMPEG)
            .args(["-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgba", "-s", &size])
            .args(["-r", &rate, "-i", "-", "-fflags", "+bitexact", "-pix_fmt", "yuv420p"])
            .arg(file)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .context("cannot start ffmpeg")?;
        let mut input = ffmpeg.stdin.take().expect("it was requested");
        let mut messages = ffmpeg.stderr.take().expect("it was requested");
        // A full pipe of messages would stop ffmpeg from reading.
        let (sent, said) = std::thread::scope(|scope| {
            let read = move || {
                let mut said = Vec::new();
                messages.read_to_end(&mut said).map(|_| said)
            };
            let reader = std::thread::Builder::new().name("ffmpeg".to_owned());
            let reader = reader.spawn_scoped(scope, read)?;
            let sent = self.pictures().try_for_each(|picture| input.write_all(picture.data()));
            drop(input);
            anyhow::Ok((sent, reader.join().expect("reading does not panic")?))
        })?;
        let status = ffmpeg.wait().context("cannot wait for ffmpeg")?;
        let said = String::from_utf8_lossy(&said);
        let said = said.lines().next().unwrap_or("no message");
        anyhow::ensure!(status.success(), "ffmpeg failed ({status}): {said}");
        sent.context("ffmpeg did not read all pictures")
    }
}

/// Index of the colour that leaves a pixel of a GIF as it was.
const TRANSPARENT: u8 = 0;

/// Colours of a GIF.
struct Palette {
    /// By index; the first is that of transparency.
    colours: Vec<Rgb>,
    /// Index of the nearest colour for each colour of the pictures.
    nearest: BTreeMap<Rgb, u8>,
}

impl Palette {
    /// The most frequent colours. Others are blends at the edges of shapes, which have near ones.
    fn of(pictures: impl Iterator<Item = Pixmap>) -> Self {
        let mut counts: BTreeMap<Rgb, usize> = BTreeMap::new();
        for picture in pictures {
            for (colour, count) in runs(&picture) {
                *counts.entry(colour).or_default() += count;
            }
        }
        let mut colours: Vec<Rgb> = counts.keys().copied().collect();
        colours.sort_by_key(|colour| Reverse(counts[colour]));
        colours.truncate(usize::from(u8::MAX));
        colours.insert(usize::from(TRANSPARENT), [0; 3]);
        let nearest = |colour: &Rgb| {
            let indices = TRANSPARENT + 1..=u8::MAX;
            let opaque = indices.zip(&colours[1..]);
            opaque.min_by_key(|(_, other)| distance(*colour, **other)).map(|(index, _)| index)
        };
        let pairs = counts.keys().filter_map(|colour| Some((*colour, nearest(colour)?)));
        let nearest = pairs.collect();
        Self { colours, nearest }
    }

    /// The index of each pixel, row by row.
    fn indices(&self, picture: &Pixmap) -> Vec<u8> {
        let indices = runs(picture)
            .flat_map(|(colour, count)| std::iter::repeat_n(self.nearest[&colour], count));
        indices.collect()
    }
}

/// Neighbouring pixels of one colour, row by row: the colour, and how many there are.
fn runs(picture: &Pixmap) -> impl Iterator<Item = (Rgb, usize)> {
    let runs = picture.pixels().chunk_by(PremultipliedColorU8::eq);
    runs.map(|run| ([run[0].red(), run[0].green(), run[0].blue()], run.len()))
}

/// Square of the distance of two colours.
fn distance(from: Rgb, to: Rgb) -> u32 {
    from.iter().zip(to).map(|(a, b)| u32::from(a.abs_diff(b)).pow(2)).sum()
}
