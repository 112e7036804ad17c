//! Trained teams for Python.

use std::path::PathBuf;

use policy::{PolicySnapshot, RunSeed};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyByteArray;

use crate::arrays::{bytes, numbers, refused};

/// A trained team in `E` environments that Python steps.
#[pyclass(module = "s2mia._native")]
pub(crate) struct Team {
    policy: PolicySnapshot,
    seed: Option<RunSeed>,
    team: policy::Team,
    /// The team and its agents as JSON.
    #[pyo3(get)]
    description: String,
}

#[pymethods]
impl Team {
    /// The policies of the run in a folder, or those of a checkpoint. With a seed, actions are sampled.
    #[new]
    fn new(run: PathBuf, seed: Option<u64>, checkpoint: Option<&str>) -> PyResult<Self> {
        let trained = s2mia::embedded::trained(run, checkpoint).map_err(refused)?;
        Ok(Self::sampling(trained, seed))
    }

    /// The policies that come with the program for a task.
    #[staticmethod]
    fn pretrained(task: &str, seed: Option<u64>) -> PyResult<Self> {
        let trained = s2mia::embedded::pretrained(task).map_err(refused)?;
        Ok(Self::sampling(trained, seed))
    }

    /// Starts an episode in each of `environments`. Another number of them than before starts anew.
    fn begin(&mut self, environments: usize) {
        if environments == self.team.environments() {
            (0..environments).for_each(|environment| self.team.reset(environment));
        } else {
            self.team = policy::Team::new(&self.policy, environments, self.seed);
        }
    }

    /// Starts an episode in one environment.
    fn reset(&mut self, environment: usize) -> PyResult<()> {
        let count = self.team.environments();
        if environment >= count {
            return Err(PyValueError::new_err(format!("environment {environment} of {count}")));
        }
        self.team.reset(environment);
        Ok(())
    }

    /// An agent's actions `[E, act]` for its observations `[E, obs]`, both as little-endian f32.
    fn act<'py>(
        &mut self,
        py: Python<'py>,
        agent: usize,
        observations: &[u8],
    ) -> PyResult<Bound<'py, PyByteArray>> {
        let size = self.policy.agents.get(agent).map(policy::ActorPolicy::observation_size);
        let observations = numbers(observations);
        if size.map(|size| size * self.team.environments()) != Some(observations.len()) {
            let found = observations.len();
            return Err(PyValueError::new_err(format!("{found} numbers for agent {agent}")));
        }
        let actions = self.team.act(&self.policy, agent, &observations);
        Ok(PyByteArray::new(py, &bytes(actions.into_iter())))
    }
}

impl Team {
    /// Policies and their description, in one environment; with a seed, actions are sampled.
    fn sampling((policy, description): (PolicySnapshot, String), seed: Option<u64>) -> Self {
        let seed = seed.map(RunSeed);
        let team = policy::Team::new(&policy, 1, seed);
        Self { policy, seed, team, description }
    }
}
