//! Random rollout data: an update takes as long with it as with real data.

use marl::{ActionKind, AgentBatch, AgentShape, Batch, Final, Problem};
use policy::PolicyConfig;
use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};

/// A synthetic task: `agents` agents with `features` features and `joints` joints each.
pub(crate) fn problem(agents: usize, features: usize, joints: usize) -> Problem {
    let shape = AgentShape {
        observation: features,
        action: joints,
        action_range: (-1.0, 1.0),
        kind: ActionKind::Continuous,
        surprise_features: (0..features).collect(),
    };
    Problem { agents: vec![shape; agents], state: features }
}

/// Rollout data of `environments` environments and `steps` steps, without an end of an episode.
pub(crate) fn batch(
    problem: &Problem,
    policy: &PolicyConfig,
    (steps, environments): (usize, usize),
) -> Batch {
    let mut rng = generator(RunSeed(0), Draw::of(Purpose::Probe));
    let mut normals =
        |count: usize| -> Vec<f32> { (0..count).map(|_| standard_normal(&mut rng)).collect() };
    let (rows, chunks) =
        (steps * environments, steps / policy.backpropagation_steps * environments);
    let mut agent = |shape: &AgentShape| AgentBatch {
        observation: normals(rows * shape.observation),
        // Close to a policy with small means, so that log-densities have usual values.
        action: normals(rows * shape.action).iter().map(|x| 0.3 * x).collect(),
        log_prob: vec![0.0; rows],
        hidden: normals(chunks * policy.hidden_size()),
    };
    let agents = problem.agents.iter().map(&mut agent).collect();
    let last = |environment: usize| Final {
        step: steps - 1,
        environment,
        state: normals(problem.state),
        observation: problem.agents.iter().map(|shape| normals(shape.observation)).collect(),
    };
    let finals = (0..environments).map(last).collect();
    Batch {
        steps,
        environments,
        agents,
        state: normals(rows * problem.state),
        reward: normals(rows),
        terminated: vec![false; rows],
        truncated: vec![false; rows],
        finals,
    }
}
