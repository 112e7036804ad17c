//! `s2mia learner`: one run, served to actors that come from anywhere.

use std::net::SocketAddr;

use actor::Transport;
use anyhow::Context as _;
use learner::Door;
use security::ServerTls;
use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::cli::LearnerArguments;
use crate::commands::{Usage, runtime};
use crate::launch::{self, Prepared};
use crate::progress::Progress;
use crate::{output, page, signals};

/// Serves until the run is done, or it is told to stop; then the newest state is in a checkpoint.
pub(super) fn run(arguments: &LearnerArguments) -> anyhow::Result<()> {
    let files = arguments.tls.files();
    if files.is_none() && !arguments.insecure_allow_remote {
        demand_loopback(arguments.listen)?;
    }
    page::check(&arguments.page)?;
    let tls = files.map(ServerTls::open).transpose().map_err(|why| Usage::new(why.to_string()))?;
    let prepared =
        launch::prepare_or_resume(&arguments.settings, &arguments.resume, &plain_text(arguments))?;
    runtime()?.block_on(serve(prepared, arguments, tls))
}

/// How far away an environment from outside may be.
fn plain_text(arguments: &LearnerArguments) -> Transport {
    match arguments.insecure_allow_remote {
        true => Transport::PlainText,
        false => Transport::PlainTextOnLoopback,
    }
}

/// Nothing in plain text is encrypted, so other machines are let in only on request.
fn demand_loopback(address: SocketAddr) -> Result<(), Usage> {
    if address.ip().is_loopback() {
        return Ok(());
    }
    Err(Usage::new(format!(
        "--listen {address} would let other machines in without encryption or identity; \
         give --tls-certificate, --tls-key and --tls-client-ca (`s2mia certs DIR` makes them), or \
         pass --insecure-allow-remote to allow that"
    )))
}

async fn serve(
    prepared: Prepared,
    arguments: &LearnerArguments,
    tls: Option<ServerTls>,
) -> anyhow::Result<()> {
    let Prepared { config, folder, launch } = prepared;
    let address = arguments.listen;
    let listener =
        TcpListener::bind(address).await.with_context(|| format!("cannot listen on {address}"))?;
    let scheme = if tls.is_some() { "https" } else { "http" };
    output::line(format!(
        "{} waits for actors on {scheme}://{}",
        folder.display(),
        listener.local_addr()?
    ));
    let page = page::open(&arguments.page).await?;
    let door = match tls {
        Some(tls) => Door::guarded(listener, tls),
        None => Door::from(listener),
    };
    let (stop_sender, stop) = watch::channel(false);
    signals::stop_on_signal(stop_sender, || output::line("stopping after a checkpoint"))?;
    let mut progress = Progress::new(config.env_steps());
    let observer = Box::new(move |event: &learner::Event| progress.observe(event));
    let summary =
        learner::run(launch, door, page, observer, stop).await.context("the learner failed")?;
    let done = if summary.stopped_early { "stopped" } else { "finished" };
    output::line(format!(
        "{done} after iteration {}: {}",
        summary.iteration,
        summary.checkpoint.display()
    ));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_machine_is_let_in_without_being_told() {
        for address in ["127.0.0.1:50051", "[::1]:0"] {
            assert!(demand_loopback(address.parse().expect("an address")).is_ok());
        }
        for address in ["0.0.0.0:50051", "192.168.1.2:1", "[::]:0"] {
            assert!(demand_loopback(address.parse().expect("an address")).is_err());
        }
    }
}
