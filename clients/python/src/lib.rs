//! The native module of the Python package: converts between arrays and the crates. The package above it, in Python, defines
//! what users see.

mod environments;

/// `s2mia._native`
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::environments::{Environments, task_names};

    /// The package's version.
    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
}
