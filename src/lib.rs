//! The s2mia program as a library: its command line ([`program`]), and what its Python module uses ([`embedded`]).

mod commands;
mod config;
pub mod embedded;
mod endpoints;
mod errors;
mod experiment;
mod figures;
mod film;
mod process;
mod progress;
mod run;

use std::process::ExitCode;

use actor::ActorError;
use learner::serve::client::CallError;

use crate::config::ConfigError;
use crate::errors::{ENVIRONMENT_OUTAGE, Incomplete, Usage};

/// Parses the process's arguments, runs one command and reports an error as one line and an exit status.
pub fn program() -> ExitCode {
    let arguments = match commands::Arguments::of(std::env::args_os()) {
        Ok(arguments) => arguments,
        Err(error) => return commands::report(&error),
    };
    run(arguments).map_or_else(|error| failure(&error), |()| ExitCode::SUCCESS)
}

/// Runs the command, whose output must have been written when it ends.
fn run(arguments: commands::Arguments) -> anyhow::Result<()> {
    process::prepare()?;
    let commands::Arguments { log_format, log, command } = arguments;
    process::output::start_log(log_format, log.as_deref(), command.log_filter())?;
    process::output::start(command.kind());
    choose_registers()?;
    commands::run(command)?;
    process::output::finish()
}

/// Selects the register width that `S2MIA_SIMD` names; the default is the processor's widest.
fn choose_registers() -> anyhow::Result<()> {
    let Some(name) = std::env::var_os("S2MIA_SIMD") else { return Ok(()) };
    let chosen = name.to_str().and_then(kernels::Width::named);
    if chosen.is_some_and(kernels::select) {
        return Ok(());
    }
    let available = kernels::Width::ALL.into_iter().filter(|width| width.is_available());
    let names: Vec<&str> = available.map(kernels::Width::name).collect();
    let name = name.to_string_lossy();
    let names = names.join(", ");
    Err(Usage::new(format!("S2MIA_SIMD is {name}; this processor has {names}")).into())
}

/// Prints one line on stderr. The status is 2 for invalid arguments or settings, 3 for incomplete logs, 4 for an
/// environment that is unreachable for too long, else 1.
fn failure(error: &anyhow::Error) -> ExitCode {
    let wrong_url = matches!(error.downcast_ref(), Some(CallError::InvalidUrl { .. }));
    let wrong_usage = wrong_url || error.is::<ConfigError>() || error.is::<Usage>();
    process::output::error(format!("error: {}", actor::causes(error.as_ref())));
    let incomplete = error.is::<Incomplete>();
    let outage = matches!(error.downcast_ref(), Some(ActorError::EnvironmentOutage { .. }));
    ExitCode::from(if wrong_usage {
        2
    } else if incomplete {
        3
    } else if outage {
        ENVIRONMENT_OUTAGE
    } else {
        1
    })
}
