//! From metres to pixels: a camera that looks along y, keeps the root in the middle of the frame and stands level.

use crate::film::solids::Solid;

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
    /// The x that stands in the middle, metres.
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
        let (first, last) = ((self.middle - half).ceil(), (self.middle + half).floor());
        (first as i64..=last as i64).map(|metre| (metre, self.pixel([metre as f32, 0.0]).0))
    }
}

/// Pixels per metre at which every frame's solids fit, given each frame's middle.
pub(super) fn scale(frames: &[Vec<Solid>], middles: &[f32]) -> f32 {
    let mut scale = LARGEST;
    for (solids, middle) in frames.iter().zip(middles) {
        for solid in solids {
            for [x, z] in solid.ends {
                let aside = (x - middle).abs() + solid.radius;
                let across = (WIDTH as f32 / 2.0 - MARGIN) / aside.max(f32::EPSILON);
                let upwards =
                    ((HEIGHT - GROUND) as f32 - MARGIN) / (z + solid.radius).max(f32::EPSILON);
                scale = scale.min(across).min(upwards);
            }
        }
    }
    scale
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
            vec![Solid { ends: [[x, z]; 2], radius: 0.5, depth: 0.0, agent: None }]
        };
        let wide = scale(&[ball(0.0, 0.5), ball(12.3, 0.5)], &[0.0, 10.0]);
        assert!((wide - 184.0 / 2.8).abs() < 1e-3, "{wide}");
        let tall = scale(&[ball(0.0, 3.9)], &[0.0]);
        assert_eq!(tall, 50.0);
    }
}
