//! Posteriors of actions with mutual information known in closed form.

use policy::randomness::standard_normal;

use super::*;
use crate::config::{Estimator, QTraining};
use crate::influence::mutual_information;

const ROWS: usize = 20_000;
const SIGMA: f64 = 0.3;

fn config() -> InfluenceConfig {
    InfluenceConfig {
        lambda: 0.01,
        estimator: Estimator::VariationalKl,
        q_training: QTraining::Mle,
        kappa: 1.0,
        encoder: 16,
        hidden: 16,
        epochs: 10,
        learning_rate: 2e-2,
        minibatches: 20,
        posterior_sigma_floor: 0.05,
        holdout_every: 5,
        lag: 0,
    }
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

/// Features without information, `[ROWS, 2]`.
fn features() -> Tensor {
    Tensor::ones((ROWS, 2), DType::F32, &Device::Cpu).unwrap()
}

/// The marginal policy of the agent's actions.
fn marginal() -> HeadRows {
    HeadRows::gaussian(vec![0.0; ROWS], vec![SIGMA])
}

/// Held-out rows (one of five) and the remaining ones.
fn parts() -> (Vec<usize>, Vec<usize>) {
    (0..ROWS).partition(|row| row % 5 == 4)
}

fn fitted(posterior: &mut Posterior, data: &Conditions<'_>) {
    let ((held_out, trained), draw) = (parts(), Draw::of(Purpose::PosteriorMinibatch));
    posterior.fit(data, &trained, &held_out, (RunSeed(3), draw)).unwrap();
}

/// Mean gain in log-probability over the policy on held-out rows.
fn information(posterior: &Posterior, data: &Conditions<'_>) -> f64 {
    let (held_out, all) = (parts().0, (0..ROWS).collect::<Vec<usize>>());
    let log_q = posterior.conditional(data, &all).unwrap().log_prob(data.action, &held_out);
    mutual_information(&log_q, &data.policy.log_prob(data.action, &held_out)).unwrap()
}

/// Trains on four of five rows. Returns the mean gain in log-probability over the marginal on the others.
fn estimate(rho: f64) -> f64 {
    let (action, others) = actions(rho);
    let features = features();
    let data =
        Conditions { features: &features, others: &others, action: &action, policy: &marginal() };
    let mut posterior = posterior();
    fitted(&mut posterior, &data);
    information(&posterior, &data)
}

#[test]
fn independent_actions_have_no_information_about_each_other() {
    assert!(estimate(0.0).abs() < 0.02, "{}", estimate(0.0));
}

#[test]
fn the_information_of_correlated_actions_is_estimated_to_a_twentieth_of_a_nat() {
    // I = -1/2 log(1 - rho^2).
    for (rho, truth) in [(0.5, 0.143_841), (0.8, 0.510_826)] {
        let found = estimate(rho);
        assert!((found - truth).abs() < 0.05, "rho {rho}: {found}, truth {truth}");
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
    let features = features();
    let even = HeadRows::categorical(vec![0.0; 3 * ROWS], 3);
    let data = Conditions { features: &features, others: &others, action: &action, policy: &even };
    let mut posterior = of_shape(PosteriorShape { others: 3, features: 2, action: 1, kind });
    fitted(&mut posterior, &data);
    let found = information(&posterior, &data);
    let truth = libm::log(3.0) + 0.8 * libm::log(0.8) + 0.2 * libm::log(0.1);
    assert!((found - truth).abs() < 0.02, "{found}, truth {truth}");
}

#[test]
fn an_untrained_posterior_is_the_policy_and_its_estimate_is_exactly_zero() {
    let (action, others) = actions(0.8);
    let features = features();
    let policy = marginal();
    let data =
        Conditions { features: &features, others: &others, action: &action, policy: &policy };
    let all: Vec<usize> = (0..ROWS).collect();
    assert_eq!(posterior().conditional(&data, &all).unwrap(), policy);
    assert_eq!(information(&posterior(), &data), 0.0);
}

#[test]
fn training_never_lowers_the_likelihood_of_held_out_rows() {
    let (action, others) = actions(0.0);
    let features = features();
    let policy = marginal();
    let data =
        Conditions { features: &features, others: &others, action: &action, policy: &policy };
    let mut posterior = posterior();
    let draw = Draw::of(Purpose::PosteriorMinibatch);
    // Forty rows contain nothing that generalises.
    let (trained, held_out): (Vec<usize>, Vec<usize>) = ((0..40).collect(), (40..2000).collect());
    posterior.fit(&data, &trained, &held_out, (RunSeed(3), draw)).unwrap();
    let log_q = posterior.log_likelihood(&data, &held_out).unwrap();
    let log_p = policy.log_prob(&action, &held_out).iter().sum::<f64>() / held_out.len() as f64;
    assert!(log_q >= log_p, "{log_q} {log_p}");
}

#[test]
#[should_panic(expected = "the others' actions has the shape 19999, expected 20000")]
fn other_actions_of_another_number_of_rows_are_refused_with_both_shapes() {
    let ((action, others), features, policy) = (actions(0.0), features(), marginal());
    let data =
        Conditions { features: &features, others: &others[1..], action: &action, policy: &policy };
    let _refused = posterior().conditional(&data, &[0]);
}
