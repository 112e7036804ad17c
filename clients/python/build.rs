//! Leaves the symbols of Python in the module to the Python that loads it, as macOS must be told.

fn main() {
    pyo3_build_config::add_extension_module_link_args();
}
