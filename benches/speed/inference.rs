//! Cost of an actor's step besides physics: the networks and random draws of all agents.

use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};
use policy::{PolicySnapshot, Scratch};

use crate::Effort;
use crate::clock::typical;
use crate::settings::{self, CaseSettings};
use crate::table::CaseRow;
use crate::update::{CORES, TASKS};

const STEPS: u32 = 2_000;

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    let mut rows = Vec::new();
    for task in TASKS {
        for core in CORES {
            rows.push(row(task, core, 2, effort)?);
        }
    }
    rows.push(row("halfcheetah-6x1", "gru", 16, effort)?);
    Ok(rows)
}

fn row(task: &str, core: &str, environments: usize, effort: Effort) -> anyhow::Result<CaseRow> {
    let settings = CaseSettings::harl(task, &[settings::core(core)])?;
    let problem = settings.problem()?;
    let algorithm = marl::build(&settings.training, &settings.policy, &problem, RunSeed(0))?;
    let mut slot = Slot::of(algorithm.snapshot()?, environments);
    let micros = |secs: f64| secs / f64::from(STEPS) * 1e6;
    let thought = typical(effort.repeats, || (0..STEPS).for_each(|_| slot.think()));
    let acted = typical(effort.repeats, || {
        for step in 0..STEPS {
            slot.think();
            slot.draw(step);
        }
    });
    let figures = vec![
        ("networks, µs", micros(thought.thread)),
        ("with draws, µs", micros(acted.thread)),
        ("per agent and environment, µs", micros(acted.thread) / slot.rows()),
    ];
    Ok(CaseRow { case: format!("{task} {core}, {environments} environments"), figures })
}

/// The agents of a few environments, as in `rollout`.
struct Slot {
    policy: PolicySnapshot,
    environments: usize,
    observation: Vec<Vec<f32>>,
    hidden: Vec<Vec<f32>>,
    output: Vec<Vec<f32>>,
    scratch: Scratch,
    action: Vec<f32>,
    /// Kept, so that the compiler does not remove the computation.
    log_prob: f32,
}

impl Slot {
    fn of(policy: PolicySnapshot, environments: usize) -> Self {
        let mut rng = generator(RunSeed(0), Draw::of(Purpose::Probe));
        let mut rows = |width: usize| -> Vec<f32> {
            (0..environments * width).map(|_| standard_normal(&mut rng)).collect()
        };
        Self {
            observation: policy.agents.iter().map(|a| rows(a.observation_size())).collect(),
            hidden: policy.agents.iter().map(|a| rows(a.hidden_size())).collect(),
            output: policy.agents.iter().map(|a| rows(a.output_size())).collect(),
            action: vec![0.0; policy.agents.iter().map(|a| a.action_size()).max().unwrap_or(0)],
            scratch: Scratch::default(),
            log_prob: 0.0,
            policy,
            environments,
        }
    }

    fn rows(&self) -> f64 {
        (self.environments * self.policy.agents.len()) as f64
    }

    fn think(&mut self) {
        let known = self.observation.iter().zip(&mut self.hidden).zip(&mut self.output);
        for (policy, ((observation, hidden), output)) in self.policy.agents.iter().zip(known) {
            policy.forward(self.environments, observation, hidden, output, &mut self.scratch);
        }
    }

    fn draw(&mut self, step: u32) {
        for (agent, (policy, output)) in self.policy.agents.iter().zip(&self.output).enumerate() {
            for (row, output) in output.chunks_exact(policy.output_size()).enumerate() {
                let key = Draw::of(Purpose::Action).step(step).agent(agent as u32);
                let mut rng = generator(RunSeed(0), key.environment(row as u32));
                let action = &mut self.action[..policy.action_size()];
                policy.draw(output, &mut rng, action);
                self.log_prob += policy.log_prob(output, action);
            }
        }
        assert!(!self.log_prob.is_nan(), "log-densities of drawn actions are numbers");
    }
}
