//! Returns and advantages over `[T, B]` rows.
//!
//! After termination the value of the next state is 0. After truncation and at the end of the slot the episode
//! continues, so the next state has the value of the true final state. The trace of advantages is cut at all three,
//! because the next row belongs to another episode or does not exist.

use crate::data::batch::Batch;
use crate::shape::assert_shape;

/// Discount and trace decay of the advantage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Horizon {
    /// Discount per step.
    pub gamma: f64,
    /// Decay of the trace, GAE's lambda.
    pub lambda: f64,
}

/// Eq. (1): `sum_t gamma^t r_t` of one episode's rewards `[T]`, the objective of every policy.
#[must_use]
pub fn discounted_return(reward: &[f32], gamma: f64) -> f64 {
    reward.iter().rev().fold(0.0, |later, &reward| f64::from(reward) + gamma * later)
}

/// Value of each row's true next state, `[T, B]`: the next row's value; after a done step and after the last step, the
/// value of the final state (`final_values`, one per `batch.finals`); after termination, 0.
///
/// # Panics
/// If the shapes differ.
#[must_use]
pub fn next_values(batch: &Batch, values: &[f64], final_values: &[f64]) -> Vec<f64> {
    assert_shape("values", values.len(), batch.rows());
    assert_shape("final_values", final_values.len(), batch.finals.len());
    let mut next: Vec<f64> = values[batch.environments..].to_vec();
    next.resize(batch.rows(), 0.0);
    for (last, &value) in batch.finals.iter().zip(final_values) {
        let row = last.step * batch.environments + last.environment;
        next[row] = if batch.terminated[row] { 0.0 } else { value };
    }
    next
}

/// Generalised advantage estimation: `delta_t = r_t + gamma V'_t - V_t`, `A_t = delta_t + gamma lambda A_(t+1)`. The
/// last term is omitted if step `t` ended an episode or is the slot's last. `reward`, `values`, `next` (from
/// [`next_values`]) and the result are `[T, B]`.
///
/// # Panics
/// If the shapes differ.
#[must_use]
pub fn advantage(
    batch: &Batch,
    reward: &[f32],
    values: &[f64],
    next: &[f64],
    horizon: Horizon,
) -> Vec<f64> {
    assert_shape("reward", reward.len(), batch.rows());
    assert_shape("values", values.len(), batch.rows());
    assert_shape("next", next.len(), batch.rows());
    let width = batch.environments;
    let mut advantage = vec![0.0; batch.rows()];
    for environment in 0..width {
        let mut later = 0.0;
        for row in (environment..batch.rows()).step_by(width).rev() {
            if batch.done(row) {
                later = 0.0;
            }
            let future = horizon.gamma * next[row];
            let delta = f64::from(reward[row]) + future - values[row];
            later = delta + horizon.gamma * horizon.lambda * later;
            advantage[row] = later;
        }
    }
    advantage
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::batch::Final;

    const HALF: Horizon = Horizon { gamma: 0.5, lambda: 0.5 };

    /// Steps of one environment, some of which end an episode.
    fn batch(steps: usize, terminated: &[usize], truncated: &[usize]) -> Batch {
        let ended = |at: &[usize]| (0..steps).map(|step| at.contains(&step)).collect::<Vec<_>>();
        let (terminated, truncated) = (ended(terminated), ended(truncated));
        let ends = (0..steps).filter(|&at| terminated[at] || truncated[at] || at + 1 == steps);
        let finals = ends.map(|step| Final { step, ..Final::default() }).collect();
        Batch { steps, environments: 1, terminated, truncated, finals, ..Batch::default() }
    }

    #[test]
    fn advantages_with_every_kind_of_end_match_a_worked_case() {
        // Steps 0 1 | 2 3 | 4: termination after 1, truncation after 3, slot's end after 4.
        let batch = batch(5, &[1], &[3]);
        let values = [1.0, 2.0, 3.0, 4.0, 5.0];
        let next = next_values(&batch, &values, &[100.0, 8.0, 6.0]);
        assert_eq!(next, vec![2.0, 0.0, 4.0, 8.0, 6.0]);
        let found = advantage(&batch, &[1.0; 5], &values, &next, HALF);
        // A4 = 1 + 3 - 5 = -1; A3 = 1 + 4 - 4 = 1; A2 = (1 + 2 - 3) + A3 / 4 = .25;
        // A1 = 1 + 0 - 2 = -1; A0 = (1 + 1 - 1) + A1 / 4 = .75
        assert_eq!(found, vec![0.75, -1.0, 0.25, 1.0, -1.0]);
    }

    #[test]
    fn with_lambda_one_the_advantage_is_the_discounted_return_minus_the_value() {
        let whole = batch(4, &[3], &[]);
        let reward = [1.0, -2.0, 3.0, 0.5];
        let values = [0.3, 0.1, -0.7, 0.9];
        let next = next_values(&whole, &values, &[123.0]);
        let full = Horizon { gamma: 0.9, lambda: 1.0 };
        let found = advantage(&whole, &reward, &values, &next, full);
        let expected = discounted_return(&reward, 0.9) - 0.3;
        assert!((found[0] - expected).abs() < 1e-6);
    }

    #[test]
    fn with_lambda_zero_the_advantage_is_the_one_step_error() {
        let whole = batch(2, &[], &[]);
        let next = next_values(&whole, &[1.0, 2.0], &[3.0]);
        let short = Horizon { gamma: 0.5, lambda: 0.0 };
        assert_eq!(advantage(&whole, &[1.0, 1.0], &[1.0, 2.0], &next, short), vec![1.0, 0.5]);
    }
}
