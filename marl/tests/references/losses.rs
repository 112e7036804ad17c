//! Each loss separately: its value and its gradient.

use marl::critic::value_loss;
use marl::critic::value_normalizer::ValueNormalizer;
use marl::distribution::HeadRows;
use marl::objective::actor_loss::{Coefficients, Rows, actor_loss};
use marl::objective::advantage::{Horizon, advantage, next_values};
use marl::objective::surrogate::normalized_advantage;
use marl::{Batch, Final};

use crate::file::ReferenceValues;

fn gaussian() -> ReferenceValues {
    ReferenceValues::of(include_bytes!("gaussian_loss.safetensors"))
}

/// Compares the actor's loss of the policy `p` and the posterior `q`; returns its gradient.
fn agreeing_loss(reference: &ReferenceValues, p: &HeadRows, q: HeadRows) -> HeadRows {
    let rows = Rows {
        action: reference.numbers("input/action"),
        log_prob_old: reference.numbers("input/log_prob_old"),
        advantage: reference.numbers("input/advantage"),
        factor: reference.numbers("input/factor"),
        posterior: Some(q),
        ..Rows::default()
    };
    let coefficients = Coefficients {
        clip: reference.setting("update.clip"),
        entropy: reference.setting("update.entropy"),
        lambda: reference.setting("influence.lambda"),
        kappa: reference.setting("influence.kappa"),
    };
    let (figures, gradient) = actor_loss(p, &rows, p.count(), &coefficients);
    for (name, found) in [
        ("loss", figures.loss),
        ("policy_loss", figures.policy_loss),
        ("approx_kl", figures.approx_kl),
        ("clip_fraction", figures.clip_fraction),
        ("influence_kl", figures.influence),
        ("influence_capped", figures.capped_fraction),
    ] {
        reference.expects(name, &[found]);
    }
    gradient
}

#[test]
fn the_actors_loss_and_its_gradient_agree_with_pytorch() {
    let reference = gaussian();
    let of = |name: &str| reference.numbers(&format!("input/{name}"));
    let p = HeadRows::gaussian(of("mean"), of("sigma"));
    let q = HeadRows::gaussian(of("q_mean"), of("q_sigma"));
    let gradient = agreeing_loss(&reference, &p, q);
    reference.expects("d_mean", &gradient.outputs);
    reference.expects("d_sigma", &gradient.sigma);
}

#[test]
fn the_actors_loss_for_choices_and_its_gradient_agree_with_pytorch() {
    let reference = ReferenceValues::of(include_bytes!("categorical_loss.safetensors"));
    let of = |name: &str| HeadRows::categorical(reference.numbers(name), 4);
    let gradient = agreeing_loss(&reference, &of("input/logits"), of("input/q_logits"));
    reference.expects("d_logits", &gradient.outputs);
}

#[test]
fn the_posteriors_loss_and_its_gradient_agree_with_pytorch() {
    let reference = gaussian();
    let (mean, sigma) = (reference.numbers("input/q_mean"), reference.numbers("input/q_sigma"));
    let (action, q) = (reference.numbers("input/action"), HeadRows::gaussian(mean, sigma));
    let (mut gradient, count) = (q.zeros(), action.len() / 2);
    let mut loss = 0.0;
    for (row, action) in action.chunks_exact(2).enumerate() {
        loss -= q.log_prob_of(row, action) / count as f64;
        gradient.add_log_prob_gradient(-1.0 / count as f64, row, action, &q);
    }
    reference.expects("posterior_loss", &[loss]);
    reference.expects("d_q_mean", &gradient.outputs);
    reference.expects("d_q_sigma", &gradient.sigma);
}

#[test]
fn the_clipped_huber_loss_of_values_agrees_with_pytorch() {
    let reference = ReferenceValues::of(include_bytes!("values.safetensors"));
    let (clip, delta) = (reference.setting("critic.clip"), reference.setting("critic.huber_delta"));
    let (old, target) = (reference.numbers("input/old"), reference.numbers("input/target"));
    let value = reference.numbers("input/value");
    let each = value.iter().zip(old).zip(target);
    let (loss, slope): (Vec<f64>, Vec<f64>) =
        each.map(|((&value, old), target)| value_loss(value, old, target, clip, delta)).unzip();
    reference.expects("value_loss", &loss);
    reference.expects("d_value", &slope);
}

#[test]
fn advantages_with_every_kind_of_end_and_the_normaliser_agree_with_pytorch() {
    let reference = ReferenceValues::of(include_bytes!("values.safetensors"));
    let shape = reference.array("input/values").shape();
    let mut batch = Batch { steps: shape[0], environments: shape[1], ..Batch::default() };
    batch.terminated = reference.flags("input/terminated");
    batch.truncated = reference.flags("input/truncated");
    let ended = |&row: &usize| batch.done(row) || row / batch.environments + 1 == batch.steps;
    let ends: Vec<usize> = (0..batch.rows()).filter(ended).collect();
    let last = |&row: &usize| Final {
        step: row / shape[1],
        environment: row % shape[1],
        ..Final::default()
    };
    batch.finals = ends.iter().map(last).collect();
    let final_values = reference.numbers("input/final_values");
    let final_values: Vec<f64> = ends.iter().map(|&row| final_values[row]).collect();

    let (gamma, lambda) =
        (reference.setting("update.gamma"), reference.setting("update.gae_lambda"));
    let (reward, values) = (reference.single("input/reward"), reference.numbers("input/values"));
    let next = next_values(&batch, &values, &final_values);
    let found = advantage(&batch, &reward, &values, &next, Horizon { gamma, lambda });
    reference.expects("next", &next);
    reference.expects("advantage", &found);
    reference.expects("normalised", &normalized_advantage(&found));

    let returns: Vec<f64> = found.iter().zip(&values).map(|(a, v)| a + v).collect();
    let mut normalizer = ValueNormalizer::new(0.9);
    normalizer.restore([0.3, 1.7, 0.8]);
    normalizer.update(&returns);
    let target: Vec<f64> = returns.iter().map(|&x| normalizer.normalize(x)).collect();
    reference.expects("normaliser", &normalizer.state());
    reference.expects("target", &target);
}
