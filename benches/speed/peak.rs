//! Share of a core's peak rate of multiply-adds that an update reaches. Both are measured directly after each other.

use marl::Problem;

use crate::Effort;
use crate::clock::{median, typical};
use crate::settings::CaseSettings;
use crate::table::CaseRow;
use crate::update::{Case, Updates, cases};

/// Side of the matrices of the peak rate.
const SIDE: usize = 512;

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    cases()?.iter().map(|case| row(case, effort)).collect()
}

fn row(case: &Case, effort: Effort) -> anyhow::Result<CaseRow> {
    let batch = case.batch();
    let mut updates = Updates::new(&case.settings, &case.problem, 1)?;
    updates.run(&batch)?;
    let (mut secs, mut peaks) = (Vec::new(), Vec::new());
    for _ in 0..effort.repeats.min(3) {
        secs.push(updates.run(&batch)?.whole.thread);
        peaks.push(peak(effort));
    }
    let flops = flops(&case.settings, &case.problem, case.rows());
    let (rate, peak) = (flops / median(secs) / 1e9, median(peaks));
    let figures =
        vec![("update, GFLOP/s", rate), ("peak, GFLOP/s", peak), ("share of peak", rate / peak)];
    Ok(CaseRow { case: case.name.clone(), figures })
}

/// Rate of a large square product, as this core's peak, GFLOP/s.
fn peak(effort: Effort) -> f64 {
    let (m, k, n) = (SIDE, SIDE, SIDE);
    let (left, right) = (vec![0.5_f32; m * k], vec![0.25_f32; k * n]);
    let mut product = vec![0.0_f32; m * n];
    let flops = 2.0 * (m * k * n) as f64;
    // Enough repetitions for about a tenth of a second.
    let times = (1e10 / flops).ceil() as usize;
    let took = typical(effort.repeats.max(3), || {
        for _ in 0..times {
            multiply((m, k, n), &left, &right, &mut product);
        }
    });
    flops * times as f64 / took.thread / 1e9
}

/// `product = left right`, all row-major.
#[expect(unsafe_code, reason = "gemm takes pointers")]
fn multiply((m, k, n): (usize, usize, usize), left: &[f32], right: &[f32], product: &mut [f32]) {
    assert_eq!((left.len(), right.len(), product.len()), (m * k, k * n, m * n));
    let (wide, deep) = (n as isize, k as isize);
    let (to, left, right) = (product.as_mut_ptr(), left.as_ptr(), right.as_ptr());
    let alone = gemm::Parallelism::None;
    // SAFETY: the assertion has compared all three lengths with the sides, and strides are whole rows.
    unsafe {
        gemm::gemm(
            m, n, k, to, 1, wide, false, left, 1, deep, right, 1, wide, 0.0, 1.0, false, false,
            false, alone,
        );
    }
}

/// Floating-point operations of the matrix products of one update: `2 rows weights` for a forward pass, twice
/// that for a backward pass, without the gradient of a network's inputs.
fn flops(settings: &CaseSettings, problem: &Problem, rows: usize) -> f64 {
    let (policy, training) = (&settings.policy, &settings.training);
    let (gru, influence) = (policy.hidden_size() > 0, &training.influence);
    let others: usize = problem.agents.iter().map(|agent| agent.action).sum();
    let mut total = network(&[problem.state], training.critic.width, training.critic.layers)
        .and(training.critic.width * problem.agents.len())
        .flops(rows, 1, training.critic.epochs);
    for agent in &problem.agents {
        let features = if gru { policy.hidden } else { policy.width };
        let trunk = if gru {
            network(&[agent.observation], policy.encoder, 1)
                .and(3 * policy.hidden * (policy.encoder + policy.hidden))
        } else {
            network(&[agent.observation], policy.width, policy.layers)
        };
        // Once before and once after the policy's update.
        total += trunk.and(features * agent.action).flops(rows, 2, training.update.epochs);
        if influence.lambda > 0.0 {
            let inputs = (others - agent.action) * influence.encoder + features * influence.hidden;
            let weights = inputs + influence.hidden * (influence.encoder + agent.action);
            let posterior = Products { weights, inputs };
            let trained = rows - rows / influence.holdout_every;
            total += posterior.flops(rows, 1, 0) + posterior.flops(trained, 0, influence.epochs);
        }
    }
    total
}

/// Number of weights of a network's matrices, and of those at its inputs.
#[derive(Clone, Copy)]
struct Products {
    weights: usize,
    inputs: usize,
}

/// A network of `layers` layers of `width` units after `inputs`.
fn network(inputs: &[usize], width: usize, layers: usize) -> Products {
    let first = inputs.iter().sum::<usize>() * width;
    Products { weights: first + (layers - 1) * width * width, inputs: first }
}

impl Products {
    fn and(self, weights: usize) -> Self {
        Self { weights: self.weights + weights, ..self }
    }

    /// Operations of `forwards` passes without gradient and `epochs` passes with gradient.
    fn flops(self, rows: usize, forwards: usize, epochs: usize) -> f64 {
        let weights = forwards * self.weights + epochs * (3 * self.weights - self.inputs);
        2.0 * (rows * weights) as f64
    }
}
