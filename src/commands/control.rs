//! `s2mia stop`, and how commands find a running learner.

use std::path::Path;
use std::time::Duration;

use learner::run_folder::RunFolder;
use learner::service::Operator;
use security::addresses;

use crate::cli::{LearnerArgument, StopArguments, credentials, patience};
use crate::errors::Usage;
use crate::listening::token;
use crate::process::{output, runtime, shell};

/// Ends the learner.
pub(super) fn stop(arguments: &StopArguments) -> anyhow::Result<()> {
    let learner = &arguments.learner;
    let of = &learner.of;
    let patience = patience(arguments.timeout_secs)?;
    let Some(url) = url(learner)? else {
        let run = shell::path(Path::new(of));
        anyhow::bail!("no learner works on {of}; `s2mia status {run}` says how far it came");
    };
    runtime()?.block_on(async {
        operator(&url, learner, patience).await?.stop().await.map_err(anyhow::Error::from)
    })?;
    output::line(format!("{of} stops after a checkpoint"));
    Ok(())
}

/// Where the learner listens; `None` for the folder of a run on which none works.
pub(super) fn url(learner: &LearnerArgument) -> anyhow::Result<Option<String>> {
    let of = &learner.of;
    let scheme = if learner.tls.files().is_some() { "https" } else { "http" };
    let with_scheme = |address: &str| match address.contains("://") {
        true => address.to_owned(),
        false => format!("{scheme}://{address}"),
    };
    if let Some(address) = address(of) {
        return Ok(Some(with_scheme(address)));
    }
    if !Path::new(of).is_dir() {
        return Err(Usage::new(format!("{of} is no run folder, URL or HOST:PORT")).into());
    }
    Ok(RunFolder::listening(Path::new(of))?.as_deref().map(with_scheme))
}

/// The URL or `HOST:PORT` that the argument is; `None` for a folder.
pub(super) fn address(of: &str) -> Option<&str> {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let is_port = |(host, port): (&str, &str)| !host.is_empty() && is_number(port);
    let is_address = of.contains("://") || of.rsplit_once(':').is_some_and(is_port);
    (is_address && !Path::new(of).is_dir()).then_some(of)
}

/// A connection to the learner at `url`.
pub(super) async fn operator(
    url: &str,
    learner: &LearnerArgument,
    patience: Duration,
) -> anyhow::Result<Operator> {
    let tls = credentials(url, &learner.tls)?;
    // Plain text to another machine would show the token to the network.
    let authority = url.split_once("://").map_or(url, |(_, rest)| rest);
    let host = authority.rsplit_once(':').map_or(authority, |(host, _)| host);
    let is_private = tls.is_some() || addresses::is_loopback(host);
    let token = token::for_run(Path::new(&learner.of))?.filter(|_| is_private);
    Ok(Operator::connect(url, tls.as_ref(), token.as_ref(), patience).await?)
}
