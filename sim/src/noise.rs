//! Random draws for start states, from a generator that the caller passes.

use rand::RngCore;

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
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

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
}
