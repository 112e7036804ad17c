//! Before a policy changes, its log-probabilities agree in the rollout, over whole trajectories and in chunks, so every
//! ratio and the factor `M` are 1.

use policy::randomness::{Draw, Purpose, generator, standard_normal};
use policy::{CoreKind, PolicyConfig, RunSeed, Scratch};

use super::agent::{Agent, gather};
use super::ascent::{AgentInputs, gradient, policy_change};
use super::experience::{Experience, Influence};
use crate::data::batch::{AgentBatch, Batch, Problem};
use crate::data::sequence::{ChunkLayout, Sequences};
use crate::distribution::HeadRows;
use crate::objective::surrogate::sequential_factor;
use crate::optimisation::minibatch::minibatches;
use crate::sample;

const STEPS: usize = 20;
const ENVIRONMENTS: usize = 7;
const CHUNK: usize = 5;
/// Ends of episodes, (step, environment): inside chunks, at a chunk's last step, in consecutive steps.
const TERMINATED: [(usize, usize); 4] = [(2, 0), (4, 1), (11, 3), (12, 3)];
const TRUNCATED: [(usize, usize); 3] = [(7, 2), (9, 5), (16, 1)];
const CORES: [CoreKind; 2] = [CoreKind::Gru, CoreKind::Mlp];

fn policy(core: CoreKind) -> PolicyConfig {
    PolicyConfig {
        core,
        backpropagation_steps: CHUNK,
        layers: 2,
        head_gain: 1.0,
        ..sample::policy()
    }
}

fn agents(policy: &PolicyConfig) -> Vec<Agent> {
    let agent =
        |index| Agent::new(&sample::config(), policy, &sample::problem(), RunSeed(3), index);
    (0..2).map(|index| agent(index).unwrap()).collect()
}

fn ended(at: &[(usize, usize)]) -> Vec<bool> {
    let row = |row: usize| at.contains(&(row / ENVIRONMENTS, row % ENVIRONMENTS));
    (0..STEPS * ENVIRONMENTS).map(row).collect()
}

/// Rollout data of random observations; every step is computed as in an actor.
fn played(agents: &[Agent], problem: &Problem) -> Batch {
    let (terminated, truncated) = (ended(&TERMINATED), ended(&TRUNCATED));
    let mut batch = Batch { steps: STEPS, environments: ENVIRONMENTS, ..Batch::default() };
    (batch.terminated, batch.truncated) = (terminated, truncated);
    for (index, agent) in agents.iter().enumerate() {
        let shape = &problem.agents[index];
        let data = acted(agent, &batch, (shape.observation, shape.action), index as u32);
        batch.agents.push(data);
    }
    batch
}

fn acted(
    agent: &Agent,
    batch: &Batch,
    (observation, action): (usize, usize),
    index: u32,
) -> AgentBatch {
    let mut rng = generator(RunSeed(5), Draw::of(Purpose::Action).agent(index));
    let (policy, mut scratch) = (agent.policy().unwrap(), Scratch::default());
    let (width, mut data) = (policy.hidden_size(), AgentBatch::default());
    let mut hidden = vec![0.0; ENVIRONMENTS * width];
    for step in 0..STEPS {
        if step % CHUNK == 0 {
            data.hidden.extend(&hidden);
        }
        let seen: Vec<f32> =
            (0..ENVIRONMENTS * observation).map(|_| standard_normal(&mut rng)).collect();
        let mut means = vec![0.0; ENVIRONMENTS * action];
        policy.forward(ENVIRONMENTS, &seen, &mut hidden, &mut means, &mut scratch);
        for (environment, mean) in means.chunks_exact(action).enumerate() {
            let mut taken = vec![0.0; action];
            policy.draw(mean, &mut rng, &mut taken);
            data.log_prob.push(policy.log_prob(mean, &taken));
            data.action.extend(taken);
            if batch.done(step * ENVIRONMENTS + environment) {
                hidden[environment * width..(environment + 1) * width].fill(0.0);
            }
        }
        data.observation.extend(seen);
    }
    data
}

fn experience(agents: &[Agent], batch: &Batch) -> Vec<Experience> {
    let advantages = vec![vec![1.0; batch.rows()]; agents.len()];
    gather(agents, batch, ChunkLayout::of(batch, CHUNK), &advantages).unwrap()
}

/// Log-probabilities of one agent's actions over sequences of `steps` steps, `[T, B]`.
fn unrolled(agent: &Agent, batch: &Batch, index: usize, steps: usize) -> Vec<f64> {
    let layout = ChunkLayout::of(batch, steps);
    let sequences = Sequences::of(batch, index, layout, agent.hidden_size());
    let (_, found, _) = agent.evaluate(&sequences).unwrap();
    let mut in_time = vec![0.0; batch.rows()];
    for step in 0..layout.steps {
        for chunk in 0..layout.chunks {
            in_time[layout.source(step, chunk)] = found[step * layout.chunks + chunk];
        }
    }
    in_time
}

#[test]
fn rollout_whole_trajectories_and_chunks_give_the_same_log_probs() {
    for core in CORES {
        let agents = agents(&policy(core));
        let batch = played(&agents, &sample::problem());
        for (index, agent) in agents.iter().enumerate() {
            let (whole, chunks) =
                (unrolled(agent, &batch, index, STEPS), unrolled(agent, &batch, index, CHUNK));
            let acted = batch.agents[index].log_prob.iter().map(|&x| f64::from(x));
            for (row, acted) in acted.enumerate() {
                let (whole, chunks) = (whole[row], chunks[row]);
                let apart = (acted - whole).abs().max((acted - chunks).abs());
                assert!(apart < 1e-4, "{core:?} row {row}: {acted} {whole} {chunks}");
            }
        }
    }
}

#[test]
fn outputs_by_shards_equal_those_of_one_pass() {
    for core in CORES {
        let agents = agents(&policy(core));
        let batch = played(&agents, &sample::problem());
        let (agent, layout) = (&agents[0], ChunkLayout::of(&batch, CHUNK));
        assert!(layout.rows() >= 128, "{} rows are one shard", layout.rows());
        let sequences = Sequences::of(&batch, 0, layout, agent.hidden_size());
        let (rows, _, features) = agent.evaluate(&sequences).unwrap();
        let columns: Vec<usize> = (0..layout.chunks).collect();
        let (input, weights) =
            (sequences.input(&columns).unwrap(), agent.network.weights().unwrap());
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
        let agents = agents(&policy(core));
        let experience = experience(&agents, &played(&agents, &sample::problem()));
        let layout = experience[0].sequences.layout;
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
