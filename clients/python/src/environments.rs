//! Environments of the simulator for Python.

use std::sync::{Mutex, PoisonError};

use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyByteArray;
use s2mia::embedded;
use sim::{Disturbances, Outcome};

use crate::arrays::{bytes, numbers, refused};

/// `E` environments of one task, stepped together. Arrays are bytes: little-endian f32, and truth values of one byte.
#[pyclass(module = "s2mia._native", frozen)]
pub(crate) struct Environments {
    inner: Mutex<embedded::Environments>,
}

#[pymethods]
impl Environments {
    /// Builds `count` environments, stepped by `threads` threads. `settings` are a task and pairs `key=value`.
    #[new]
    fn new(settings: Vec<String>, count: i64, threads: i64, disturbances: &str) -> PyResult<Self> {
        let disturbances = match disturbances {
            "training" => Disturbances::AsInTraining,
            "evaluation" => Disturbances::AsInEvaluations,
            "off" => Disturbances::Off,
            other => {
                let known = "training, evaluation or off";
                return Err(PyValueError::new_err(format!(
                    "disturbances is {other:?}; it is {known}"
                )));
            }
        };
        let inner = embedded::Environments::new(settings, [count, threads], disturbances);
        Ok(Self { inner: Mutex::new(inner.map_err(refused)?) })
    }

    /// The task and its agents as JSON.
    fn task(&self, py: Python<'_>) -> PyResult<String> {
        self.locked(py, |inner| Ok(inner.about()))
    }

    /// Starts the next episodes or, with a seed, episode 0. `limits` are the steps until truncation, `[E]`; empty: the task's.
    fn reset(&self, py: Python<'_>, seed: Option<u64>, limits: Vec<i64>) -> PyResult<()> {
        self.locked(py, |inner| inner.reset(seed, &limits))
    }

    /// Steps all environments with the actions `[E, A]`. Returns observations `[E, O]`, rewards `[E]`, their terms `[E, K]`,
    /// efforts `[E, J]`, terminations, truncations and faults, `[E]`.
    fn step<'py>(&self, py: Python<'py>, actions: &[u8]) -> PyResult<[Bound<'py, PyByteArray>; 7]> {
        let actions = numbers(actions);
        let columns = self.locked(py, |inner| {
            inner.step(&actions)?;
            let flags = |flag: fn(&Outcome) -> bool| -> Vec<u8> {
                inner.outcomes().map(|outcome| u8::from(flag(outcome))).collect()
            };
            Ok([
                bytes(inner.observations().copied()),
                bytes(inner.outcomes().map(|outcome| outcome.reward)),
                bytes(inner.reward_terms().copied()),
                bytes(inner.efforts().copied()),
                flags(|outcome| outcome.terminated),
                flags(|outcome| outcome.truncated),
                flags(|outcome| outcome.fault),
            ])
        })?;
        Ok(columns.map(|column| PyByteArray::new(py, &column)))
    }

    /// Observations of all agents in their order, `[E, O]`.
    fn observations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyByteArray>> {
        let bytes = self.locked(py, |inner| Ok(bytes(inner.observations().copied())))?;
        Ok(PyByteArray::new(py, &bytes))
    }

    /// The global states, `[E, S]`.
    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyByteArray>> {
        let bytes = self.locked(py, |inner| Ok(bytes(inner.states())))?;
        Ok(PyByteArray::new(py, &bytes))
    }

    /// The encoded state of an environment, as logs of a run have it.
    fn save(&self, py: Python<'_>, environment: usize) -> PyResult<Vec<u8>> {
        self.demand(py, environment)?;
        self.locked(py, |inner| inner.save(environment))
    }

    /// Continues an environment from an encoded state.
    fn restore(&self, py: Python<'_>, environment: usize, state: &[u8]) -> PyResult<()> {
        self.demand(py, environment)?;
        self.locked(py, |inner| inner.restore(environment, state))
    }

    /// Height, width and the pixels `[height, width, 3]` of a picture of the robot of an environment.
    fn picture<'py>(
        &self,
        py: Python<'py>,
        environment: usize,
    ) -> PyResult<(u32, u32, Bound<'py, PyByteArray>)> {
        self.demand(py, environment)?;
        let picture = self.locked(py, |inner| inner.picture(environment))?;
        Ok((picture.height, picture.width, PyByteArray::new(py, &picture.rgb)))
    }
}

impl Environments {
    /// Works with the environments while other threads of Python run.
    fn locked<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut embedded::Environments) -> embedded::Result<T> + Send,
    ) -> PyResult<T> {
        let locked = || work(&mut self.inner.lock().unwrap_or_else(PoisonError::into_inner));
        py.detach(locked).map_err(refused)
    }

    fn demand(&self, py: Python<'_>, environment: usize) -> PyResult<()> {
        let count = self.locked(py, |inner| Ok(inner.count()))?;
        if environment < count {
            return Ok(());
        }
        Err(PyIndexError::new_err(format!("environment {environment} of {count}")))
    }
}

/// Names of the tasks that are part of the program.
#[pyfunction]
pub(crate) fn task_names() -> Vec<&'static str> {
    sim::task_names().to_vec()
}
