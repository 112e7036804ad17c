//! Posteriors of actions with mutual information known in closed form.

use policy::randomness::standard_normal;

use super::*;
use crate::influence::mutual_information;
use crate::sample;

const ROWS: usize = 20_000;
const SIGMA: f64 = 0.3;

fn config() -> InfluenceConfig {
    let usual = sample::config().influence;
    InfluenceConfig { encoder: 16, hidden: 16, epochs: 10, minibatches: 20, ..usual }
}

fn posterior() -> Posterior {
    let kind = ActionKind::Continuous;
    of_shape(PosteriorShape { others: 1, features: 2, action: 1, kind })
}

fn of_shape(shape: PosteriorShape) -> Posterior {
    let adam = AdamConfig { learning_rate: 2e-2, epsilon: 1e-5, max_gradient_norm: 10.0 };
    Posterior::new(&config(), adam, shape, (RunSeed(3), 0)).unwrap()
}

/// The agent's and the other's actions, both normal with standard deviation `SIGMA` and correlation `rho`.
fn actions(rho: f64) -> (Vec<f64>, Vec<f32>) {
    let mut rng = generator(RunSeed(5), Draw::of(Purpose::Probe));
    let mut normal = || f64::from(standard_normal(&mut rng));
    let pair = |_| {
        let (x, y) = (normal(), normal());
        (SIGMA * (rho * x + libm::sqrt(1.0 - rho * rho) * y), (SIGMA * x) as f32)
    };
    (0..ROWS).map(pair).unzip()
}

/// Rows of actions and what they are conditioned on. The features are without information.
struct Data {
    features: Tensor,
    others: Vec<f32>,
    action: Vec<f64>,
    policy: HeadRows,
}

impl Data {
    fn new((action, others): (Vec<f64>, Vec<f32>), policy: HeadRows) -> Self {
        let features = Tensor::ones((ROWS, 2), DType::F32, &Device::Cpu).unwrap();
        Self { features, others, action, policy }
    }

    /// Normal actions with the marginal policy of the agent's.
    fn normal(rho: f64) -> Self {
        Self::new(actions(rho), HeadRows::gaussian(vec![0.0; ROWS], vec![SIGMA]))
    }

    fn conditions(&self) -> Conditions<'_> {
        let Self { features, others, action, policy } = self;
        Conditions { features, others, action, policy }
    }
}

/// Held-out rows (one of five) and the remaining ones.
fn parts() -> (Vec<usize>, Vec<usize>) {
    (0..ROWS).partition(|row| row % 5 == 4)
}

/// Mean gain in log-probability over the policy on held-out rows.
fn information(posterior: &Posterior, data: &Data) -> f64 {
    let (held_out, all) = (parts().0, (0..ROWS).collect::<Vec<usize>>());
    let conditional = posterior.conditional(&data.conditions(), &all).unwrap();
    let log_q = conditional.log_prob(&data.action, &held_out);
    mutual_information(&log_q, &data.policy.log_prob(&data.action, &held_out)).unwrap()
}

/// The information after training on four of five rows.
fn estimate(mut posterior: Posterior, data: &Data) -> f64 {
    let (held_out, trained) = parts();
    let draw = Draw::of(Purpose::PosteriorMinibatch);
    posterior.fit(&data.conditions(), &trained, &held_out, (RunSeed(3), draw)).unwrap();
    information(&posterior, data)
}

#[test]
fn the_information_of_correlated_actions_is_estimated_to_a_twentieth_of_a_nat() {
    // I = -1/2 log(1 - rho^2).
    for (rho, truth, tolerance) in
        [(0.0, 0.0, 0.02), (0.5, 0.143_841, 0.05), (0.8, 0.510_826, 0.05)]
    {
        let found = estimate(posterior(), &Data::normal(rho));
        assert!((found - truth).abs() < tolerance, "rho {rho}: {found}, truth {truth}");
    }
}

#[test]
fn the_information_of_choices_that_mostly_agree_is_estimated_to_a_fiftieth_of_a_nat() {
    // The other's choice is uniform. The agent's choice is equal with probability 0.8, else one of the rest.
    let mut rng = generator(RunSeed(6), Draw::of(Purpose::Probe));
    let kind = ActionKind::Discrete { choices: 3 };
    let (mut action, mut others) = (Vec::new(), Vec::new());
    for row in 0..ROWS {
        let chance = policy::categorical::draw(
            &[libm::logf(0.8), libm::logf(0.1), libm::logf(0.1)],
            &mut rng,
        );
        action.push(((row + chance) % 3) as f64);
        kind.encode(&[(row % 3) as f32], &mut others);
    }
    let data = Data::new((action, others), HeadRows::categorical(vec![0.0; 3 * ROWS], 3));
    let posterior = of_shape(PosteriorShape { others: 3, features: 2, action: 1, kind });
    let found = estimate(posterior, &data);
    let truth = libm::log(3.0) + 0.8 * libm::log(0.8) + 0.2 * libm::log(0.1);
    assert!((found - truth).abs() < 0.02, "{found}, truth {truth}");
}

#[test]
fn an_untrained_posterior_is_the_policy_and_its_estimate_is_exactly_zero() {
    let data = Data::normal(0.8);
    let all: Vec<usize> = (0..ROWS).collect();
    assert_eq!(posterior().conditional(&data.conditions(), &all).unwrap(), data.policy);
    assert_eq!(information(&posterior(), &data), 0.0);
}

#[test]
fn training_never_lowers_the_likelihood_of_held_out_rows() {
    let data = Data::normal(0.0);
    let mut posterior = posterior();
    let draw = Draw::of(Purpose::PosteriorMinibatch);
    // Forty rows contain nothing that generalises.
    let (trained, held_out): (Vec<usize>, Vec<usize>) = ((0..40).collect(), (40..2000).collect());
    posterior.fit(&data.conditions(), &trained, &held_out, (RunSeed(3), draw)).unwrap();
    let log_q = posterior.log_likelihood(&data.conditions(), &held_out).unwrap();
    let log_p = data.policy.log_prob(&data.action, &held_out);
    let log_p = log_p.iter().sum::<f64>() / held_out.len() as f64;
    assert!(log_q >= log_p, "{log_q} {log_p}");
}

#[test]
#[should_panic(expected = "the others' actions has the shape 19999, expected 20000")]
fn other_actions_of_another_number_of_rows_are_refused_with_both_shapes() {
    let mut data = Data::normal(0.0);
    data.others.pop();
    let _refused = posterior().conditional(&data.conditions(), &[0]);
}
