//! The native module of the Python package: converts between arrays and the crates. The package above it, in Python, defines
//! what users see.

mod arrays;
mod environments;
mod team;

/// `s2mia._native`
#[pyo3::pymodule]
mod _native {
    use pyo3::exceptions::PyRuntimeError;
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::environments::{Environments, task_names};
    #[pymodule_export]
    use crate::team::Team;

    /// The package's version.
    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");

    /// Warnings of the crates go to stderr.
    #[pymodule_init]
    fn start(_module: &Bound<'_, PyModule>) -> PyResult<()> {
        let started = s2mia::embedded::log_warnings();
        started.map_err(|error| PyRuntimeError::new_err(format!("{error:#}")))
    }
}
