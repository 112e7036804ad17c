//! Passes the linker option with which macOS resolves Python's symbols when Python loads the module.

fn main() {
    pyo3_build_config::add_extension_module_link_args();
}
