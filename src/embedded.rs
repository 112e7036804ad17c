//! What the Python module uses of this program: environments by the names and settings that commands take.

mod environments;

pub use anyhow::{Error, Result};
pub use environments::{Environments, Picture};

/// An error and its causes in one line, as commands print them.
pub fn line(error: &Error) -> String {
    actor::causes(error.as_ref())
}
