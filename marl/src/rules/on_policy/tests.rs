//! Before a policy changes, every ratio and the factor `M` are 1, and its outputs do not depend on the shards.

mod shared_noise;

use policy::randomness::{Draw, Purpose};
use policy::{CoreKind, PolicyConfig, RunSeed};

use super::agent::{Agent, gather};
use super::ascent::{AgentInputs, gradient, policy_change};
use super::experience::{Experience, Influence};
use crate::data::batch::Batch;
use crate::data::sequence::{ChunkLayout, Sequences};
use crate::distribution::HeadRows;
use crate::objective::surrogate::sequential_factor;
use crate::optimisation::minibatch::minibatches;
use crate::sample;

const CORES: [CoreKind; 2] = [CoreKind::Gru, CoreKind::Mlp];
/// Rows that end an episode: inside chunks, at a chunk's last step, in consecutive steps.
const TERMINATED: [usize; 4] = [20, 91, 113, 123];
const TRUNCATED: [usize; 3] = [72, 95, 161];

/// Two agents, and rollout data with ends of episodes.
fn agents(core: CoreKind) -> (Vec<Agent>, Batch) {
    let policy = PolicyConfig { core, layers: 2, head_gain: 1.0, ..sample::policy() };
    let agent =
        |index| Agent::new(&sample::config(), &policy, &sample::problem(), RunSeed(3), index);
    let mut batch = sample::batch();
    TERMINATED.into_iter().for_each(|row| batch.terminated[row] = true);
    TRUNCATED.into_iter().for_each(|row| batch.truncated[row] = true);
    if core == CoreKind::Mlp {
        batch.agents.iter_mut().for_each(|agent| agent.hidden.clear());
    }
    ((0..2).map(|index| agent(index).unwrap()).collect(), batch)
}

fn layout(batch: &Batch) -> ChunkLayout {
    ChunkLayout::of(batch, sample::policy().backpropagation_steps)
}

#[test]
fn outputs_by_shards_equal_those_of_one_pass() {
    for core in CORES {
        let (agents, batch) = agents(core);
        let layout = layout(&batch);
        assert!(layout.rows() >= 128, "{} rows are one shard", layout.rows());
        let agent = &agents[0];
        let sequences = Sequences::of(&batch, 0, layout, agent.hidden_size());
        let (rows, _, features) = agent.evaluate(&sequences).unwrap();
        let columns: Vec<usize> = (0..layout.chunks).collect();
        let input = sequences.input(&columns).unwrap();
        let weights = agent.network.weights().unwrap();
        let (head, whole) = agent.network.distribution_and_features(&weights, &input).unwrap();
        assert_eq!(rows, HeadRows::of(&head).unwrap());
        assert_eq!(features.to_vec2::<f32>().unwrap(), whole.to_vec2::<f32>().unwrap());
    }
}

/// A row's ratio in an optimiser step over `columns`: the loss with weight 0 for all other rows.
fn ratio_of(row: usize, agent: &Agent, experience: &Experience, columns: &[usize]) -> f64 {
    let layout = experience.sequences.layout;
    let mut factor = vec![0.0; layout.rows()];
    factor[row] = 1.0;
    let inputs = AgentInputs { experience, influence: &Influence::default() };
    let (figures, _) = gradient(agent, inputs, &factor, columns).unwrap();
    -figures.policy_loss * (columns.len() * layout.steps) as f64
}

#[test]
fn the_first_ratio_of_every_row_and_the_factor_of_an_unchanged_policy_are_one() {
    for core in CORES {
        let (agents, batch) = agents(core);
        let layout = layout(&batch);
        let advantages = vec![vec![1.0; batch.rows()]; 2];
        let experience = gather(&agents, &batch, layout, &advantages, (RunSeed(3), 0)).unwrap();
        for columns in minibatches(layout.chunks, 3, RunSeed(7), Draw::of(Purpose::Minibatch)) {
            let row = |step: usize| columns.iter().map(move |column| step * layout.chunks + column);
            for row in (0..layout.steps).flat_map(row) {
                let ratio = ratio_of(row, &agents[0], &experience[0], &columns);
                assert!((ratio - 1.0).abs() <= 1e-5, "{core:?} row {row}: {ratio}");
            }
        }
        let mut factor = vec![1.0; layout.rows()];
        for (agent, experience) in agents.iter().zip(&experience) {
            let now = policy_change(agent, experience).unwrap();
            factor = sequential_factor(&factor, &now.log_prob, &experience.log_prob);
        }
        assert!(factor.iter().all(|m| (m - 1.0).abs() <= 1e-5), "{core:?}: {factor:?}");
    }
}
