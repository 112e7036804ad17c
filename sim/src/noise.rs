//! Random draws of an episode: generators, which follow from the episode's key, and distributions.

use rand::RngCore;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// Purpose of a draw of an episode. Each has streams of its own, so no draw depends on how many others a task has. The
/// numbers are part of a run's identity and never change.
#[derive(Clone, Copy, Debug)]
#[repr(u32)]
pub(crate) enum DrawPurpose {
    /// Start state.
    Start = 0,
    /// Target velocity.
    Command = 1,
    /// Factor of the friction of all contacts.
    Friction = 2,
    /// Masses on links.
    Payload = 3,
    /// Strength of the motors.
    MotorStrength = 4,
    /// Damping of the joints.
    JointDamping = 5,
    /// Delay of the actions.
    ActionDelay = 6,
    /// Delay of the observations.
    ObservationDelay = 7,
    /// Bias of the sensors.
    SensorBias = 8,
    /// Noise of the sensors; the index is the step.
    SensorNoise = 9,
    /// Time, size and direction of a push; the index has the push and its window.
    Push = 10,
    /// Slope of the ground.
    Slope = 11,
    /// Heights of fixed shapes.
    Terrain = 12,
}

/// The generator of a draw: ChaCha8 with the episode's key, on the stream `purpose * 2^32 + index`.
pub(crate) fn generator(key: [u8; 32], purpose: DrawPurpose, index: u32) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::from_seed(key);
    rng.set_stream((u64::from(purpose as u32) << 32) | u64::from(index));
    rng
}

/// Draws uniformly from `[-width, width)`, using the upper 24 bits of one `u32`.
pub(crate) fn symmetric(rng: &mut impl RngCore, width: f32) -> f32 {
    (2.0 * unit(rng) - 1.0) * width
}

/// Draws from the standard normal distribution by the Box-Muller method from two `u32`:
/// `sqrt(-2 ln u) cos(2 pi v)`, `u` in `(0, 1]`.
pub(crate) fn normal(rng: &mut impl RngCore) -> f32 {
    let radius = (-2.0 * libm::log(f64::from(1.0 - unit(rng)))).sqrt();
    let angle = 2.0 * std::f64::consts::PI * f64::from(unit(rng));
    (radius * libm::cos(angle)) as f32
}

/// Draws uniformly from `[low, high]`; `low` if both are equal.
pub(crate) fn within(rng: &mut impl RngCore, [low, high]: [f32; 2]) -> f32 {
    low + (high - low) * unit(rng)
}

/// Draws a whole number from `low..=high`.
pub(crate) fn whole(rng: &mut impl RngCore, [low, high]: [u32; 2]) -> u32 {
    low + choice(rng, (high - low) as usize + 1) as u32
}

/// Draws from `0..count` as the high half of one `u32` times `count`; probabilities are equal up to `count / 2^32`.
pub(crate) fn choice(rng: &mut impl RngCore, count: usize) -> usize {
    ((u64::from(rng.next_u32()) * count as u64) >> 32) as usize
}

/// Draws uniformly from `[0, 1)` on a grid of 2^-24, so that `1 - unit` is exact and never zero.
fn unit(rng: &mut impl RngCore) -> f32 {
    (rng.next_u32() >> 8) as f32 / 16_777_216.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn draws_have_the_moments_of_their_distributions() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let count = 100_000;
        let (mut square, mut fourth, mut width) = (0.0_f64, 0.0_f64, 0.0_f64);
        for _ in 0..count {
            let x = f64::from(normal(&mut rng));
            square += x * x;
            fourth += x * x * x * x;
            let u = symmetric(&mut rng, 0.1);
            assert!((-0.1..0.1).contains(&u));
            width += f64::from(u * u);
        }
        let count = f64::from(count);
        assert!((square / count - 1.0).abs() < 0.02);
        assert!((fourth / count - 3.0).abs() < 0.15);
        assert!((width / count - 0.01 / 3.0).abs() < 5e-5);
    }
    #[test]
    fn key_purpose_and_index_each_change_the_draws_and_the_start_has_the_plain_stream() {
        let first = |key, purpose, index| generator([key; 32], purpose, index).next_u64();
        let firsts = [
            first(1, DrawPurpose::Start, 0),
            first(2, DrawPurpose::Start, 0),
            first(1, DrawPurpose::Push, 0),
            first(1, DrawPurpose::Push, 1),
            first(1, DrawPurpose::SensorNoise, 1),
        ];
        assert_eq!(BTreeSet::from(firsts).len(), 5);
        assert_eq!(firsts[0], ChaCha8Rng::from_seed([1; 32]).next_u64());
    }

    #[test]
    fn whole_numbers_include_both_ends_of_their_range() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let drawn: BTreeSet<u32> = (0..100).map(|_| whole(&mut rng, [2, 4])).collect();
        assert_eq!(drawn, BTreeSet::from([2, 3, 4]));
        assert_eq!((whole(&mut rng, [7, 7]), within(&mut rng, [0.5, 0.5])), (7, 0.5));
    }
}
