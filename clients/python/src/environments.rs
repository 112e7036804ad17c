//! Environments of the simulator for Python.

use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyByteArray;
use sim::EnvironmentBatch;

/// `E` environments of one task, stepped together.
#[pyclass(module = "s2mia._native", unsendable)]
pub(crate) struct Environments {
    batch: Box<dyn EnvironmentBatch>,
}

#[pymethods]
impl Environments {
    /// Builds `count` environments. `settings` are a task and pairs `key=value`.
    #[new]
    fn new(settings: Vec<String>, count: usize) -> PyResult<Self> {
        let batch = s2mia::embedded::environments(settings, count);
        let batch = batch.map_err(|error| PyValueError::new_err(format!("{error:#}")))?;
        Ok(Self { batch })
    }

    /// The global state `[S]` of an environment, as little-endian f32.
    fn state<'py>(&self, py: Python<'py>, environment: usize) -> PyResult<Bound<'py, PyByteArray>> {
        if environment >= self.batch.count() {
            let count = self.batch.count();
            return Err(PyIndexError::new_err(format!("environment {environment} of {count}")));
        }
        Ok(array(py, &self.batch.state_of(environment)))
    }
}

/// Numbers as bytes that NumPy reads in place.
fn array<'py>(py: Python<'py>, numbers: &[f32]) -> Bound<'py, PyByteArray> {
    let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    PyByteArray::new(py, &bytes)
}
