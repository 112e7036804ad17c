//! `s2mia status`, `s2mia health` and `s2mia stop`, and how commands find a running learner.

use std::path::Path;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use learner::serve::client::{CallError, demand_serving};
use learner::serve::service::Operator;
use learner::store::run_folder::RunFolder;
use proto::{LeaseStatus, LeasedWork, RunEnd, RunLine, Status};
use security::{ClientTls, addresses};
use serde_json::json;

use crate::endpoints::{ClientTlsArguments, credentials, reachable, token_for_run};
use crate::errors::Usage;
use crate::figures::chart::{count_of, thousands};
use crate::process::{output, runtime, shell};
use crate::run::stored::config_of_run;
use crate::run::{run_path, stored};

/// Selects the learner.
#[derive(Args, Debug)]
pub(crate) struct LearnerArgument {
    /// Run folder, URL or HOST:PORT of the learner [default: the newest run in runs that has a learner, else the newest
    /// one, else http://127.0.0.1:50051].
    #[arg(value_name = "RUN | URL | HOST:PORT", default_value = "", hide_default_value = true, value_parser = run_path::or_newest)]
    pub(crate) of: String,
    /// Timeout for the learner's response.
    #[arg(long, value_name = "SECONDS", default_value = "3", value_parser = seconds)]
    pub(crate) timeout_secs: Duration,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ClientTlsArguments,
}

/// Longest time that an option accepts, seconds: 31 years. Deadlines of calls cannot be much longer.
const LONGEST_SECS: f64 = 1e9;

/// Parses the time that an option gives, for clap; refuses a negative, infinite or too long one.
pub(crate) fn seconds(text: &str) -> Result<Duration, String> {
    match text.parse::<f64>() {
        Ok(secs) if (0.0..=LONGEST_SECS).contains(&secs) => Ok(Duration::from_secs_f64(secs)),
        _ => Err(format!("must be 0 to {LONGEST_SECS} s")),
    }
}

/// Ends the learner.
pub(super) fn stop(learner: &LearnerArgument) -> anyhow::Result<()> {
    let of = &learner.of;
    let Some(url) = url(learner)? else {
        run_path::demand_run(Path::new(of))?;
        let run = shell::path(Path::new(of));
        anyhow::bail!("no learner works on {of}; `s2mia status {run}` says how far it came");
    };
    // A connection does without a token that cannot be read.
    token_for_run(Path::new(of))?;
    let stopped =
        async { operator(&url, learner).await?.stop().await.map_err(anyhow::Error::from) };
    let stopped = answered(stopped, &learner.tls, learner.timeout_secs);
    if stopped.is_err() && withholds_token(&url, learner)? {
        let why = "the token is not sent in plain text to another machine; use http://127.0.0.1:PORT on the learner's \
                   machine, SIGTERM, or certificates";
        return stopped.context(why);
    }
    stopped?;
    output::line(format!("{of} stops after a checkpoint"));
    Ok(())
}

/// Where the learner listens; `None` for the folder of a run on which none works.
pub(super) fn url(learner: &LearnerArgument) -> anyhow::Result<Option<String>> {
    let of = &learner.of;
    let scheme = if learner.tls.tls_ca.is_some() { "https" } else { "http" };
    let with_scheme = |address: &str| {
        if address.contains("://") { address.to_owned() } else { format!("{scheme}://{address}") }
    };
    if let Some(address) = address(of) {
        return Ok(Some(with_scheme(address)));
    }
    RunFolder::demand_readable(Path::new(of)).map_err(|why| Usage::new(why.to_string()))?;
    if !Path::new(of).is_dir() {
        return Err(Usage::new(format!("`{of}` is no run folder, URL or HOST:PORT")).into());
    }
    Ok(RunFolder::listening(Path::new(of))?
        .map(|address| with_scheme(&reachable(address).to_string())))
}

/// The URL or `HOST:PORT` that the argument is; `None` for a folder.
pub(super) fn address(of: &str) -> Option<&str> {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let is_port = |(host, port): (&str, &str)| !host.is_empty() && is_number(port);
    let is_address = of.contains("://") || of.rsplit_once(':').is_some_and(is_port);
    (is_address && !Path::new(of).is_dir()).then_some(of)
}

/// A connection to the learner at `url`. Only `stop` needs a token: one that cannot be read is not sent.
pub(super) async fn operator(url: &str, learner: &LearnerArgument) -> anyhow::Result<Operator> {
    let tls = credentials(url, &learner.tls)?;
    let token = token_for_run(Path::new(&learner.of)).ok().flatten();
    let token = token.filter(|_| is_private(url, tls.as_ref()));
    Ok(Operator::connect(url, tls.as_ref(), token.as_ref(), learner.timeout_secs).await?)
}

/// Whether the network cannot read a token that is sent to `url`.
fn is_private(url: &str, tls: Option<&ClientTls>) -> bool {
    tls.is_some() || addresses::is_loopback(addresses::host(url))
}

/// Whether there is a token that is not sent, because the network could read it.
fn withholds_token(url: &str, learner: &LearnerArgument) -> anyhow::Result<bool> {
    let tls = credentials(url, &learner.tls)?;
    Ok(!is_private(url, tls.as_ref()) && token_for_run(Path::new(&learner.of))?.is_some())
}

/// Waits for the answer to a call.
fn answered<T>(
    call: impl Future<Output = anyhow::Result<T>>,
    tls: &ClientTlsArguments,
    timeout: Duration,
) -> anyhow::Result<T> {
    runtime()?.block_on(async {
        match call.await {
            Err(error) => Err(explained(error, tls, timeout).await),
            answer => answer,
        }
    })
}

/// Replaces the error of a broken connection by its reason if the TLS settings of the two sides do not match. A second
/// connection finds it within `timeout`.
pub(super) async fn explained(
    error: anyhow::Error,
    tls: &ClientTlsArguments,
    timeout: Duration,
) -> anyhow::Error {
    let Some(CallError::Unreachable { url, .. }) = error.downcast_ref() else { return error };
    let Ok(tls) = credentials(url, tls) else { return error };
    match actor::diagnosis::reason(url, tls.as_ref(), timeout).await {
        Some(why) => CallError::no_session(url, &why).into(),
        None => error,
    }
}

/// `s2mia status`
#[derive(Args, Debug)]
pub(crate) struct StatusArguments {
    /// Learner.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Print one JSON object.
    #[arg(long)]
    pub(crate) json: bool,
}

/// Prints one line and a table of leases, or one JSON object.
pub(super) fn status(arguments: &StatusArguments) -> anyhow::Result<()> {
    let Some(url) = url(&arguments.learner)? else { return at_rest(arguments) };
    let learner = &arguments.learner;
    let status = async { anyhow::Ok(operator(&url, learner).await?.status().await?) };
    let status = answered(status, &learner.tls, learner.timeout_secs)?;
    if arguments.json {
        output::line(learner::lease::exchange::status_json(&status));
    } else {
        output::line(text(&status));
    }
    Ok(())
}

/// A run without a learner process: finished, stopped or crashed.
pub(super) struct AtRest {
    /// The last line of the run.
    pub(super) last_line: RunLine,
    /// Whether the run has a checkpoint.
    pub(super) has_checkpoint: bool,
    iterations: u64,
}

impl AtRest {
    /// Reads the newest checkpoint and the settings of the run in this folder.
    pub(super) fn of(run: &Path) -> anyhow::Result<Self> {
        let newest = stored::load_if_any(run)?.map(|loaded| loaded.checkpoint);
        let iterations = config_of_run(run)?.iterations();
        let has_checkpoint = newest.is_some();
        let (iteration, env_steps) =
            newest.map_or((0, 0), |newest| (newest.iteration, newest.env_steps));
        let is_finished = has_checkpoint && iteration >= iterations;
        let end = Some(if is_finished { RunEnd::Finished } else { RunEnd::Stopped });
        let run_id = run_path::name(run);
        let last_line = RunLine { run_id, iteration, env_steps, end, ..RunLine::default() };
        Ok(Self { last_line, has_checkpoint, iterations })
    }

    /// Whether the run has had its last iteration.
    pub(super) fn is_finished(&self) -> bool {
        self.last_line.end == Some(RunEnd::Finished)
    }
}

/// What to say of a run without a learner and without a checkpoint.
pub(super) fn unsaved(run: &Path) -> String {
    format!(
        "{} stopped before its first checkpoint; `s2mia train --resume {}` begins it again",
        run.display(),
        shell::path(run)
    )
}

fn at_rest(arguments: &StatusArguments) -> anyhow::Result<()> {
    let run = Path::new(&arguments.learner.of);
    let rest = AtRest::of(run)?;
    let iterations = rest.iterations;
    let RunLine { iteration, env_steps, end, .. } = rest.last_line;
    if arguments.json {
        let object = json!({
            "state": end,
            "iteration": iteration,
            "iterations": iterations,
            "env_steps": env_steps,
        });
        output::line(object);
        return Ok(());
    }
    let shown = run.display();
    let run = shell::path(run);
    let steps = thousands(env_steps);
    let at = format!("iteration {iteration} of {iterations}, {steps} env steps");
    output::line(match (rest.has_checkpoint, end) {
        (false, _) => unsaved(Path::new(&arguments.learner.of)),
        (true, Some(RunEnd::Finished)) => format!("{shown} is finished: {at}"),
        (true, _) => {
            format!("{shown} is stopped: {at}; `s2mia train --resume {run}` resumes it")
        }
    });
    Ok(())
}

fn text(status: &Status) -> String {
    let Status { run_id, iteration, slots, complete_slots, actors, leases, .. } = status;
    let pace = status.env_steps_per_sec.map_or_else(String::new, |pace| {
        format!(", {} env steps/s", thousands(pace.round() as u64))
    });
    let disk =
        if status.storage_degraded { "\nthe last checkpoint could not be written" } else { "" };
    let idle = match actors.saturating_sub(*slots) {
        0 => String::new(),
        idle => format!(" ({idle} more than slots in this iteration)"),
    };
    let mut text = format!(
        "{run_id}: iteration {iteration}, {} env steps{pace}\n\
         {complete_slots} of {} complete, {} on {}{idle}, \
         {} leased again, {} backed up, {} audited, {} messages refused{disk}",
        thousands(status.env_steps),
        count_of(*slots, "slot"),
        count_of(leases.len() as u64, "lease"),
        count_of(*actors, "actor"),
        status.leases_reissued,
        status.slots_backed_up,
        status.audits_agreed,
        status.messages_refused,
    );
    leases.iter().for_each(|lease| text += &format!("\n{}", line(lease)));
    text
}

fn line(lease: &LeaseStatus) -> String {
    let work = match lease.work {
        LeasedWork::Slot(slot) => format!("slot {slot}"),
        LeasedWork::Episode(episode) => format!("episode {episode}"),
    };
    let chunks = count_of(lease.chunks.into(), "chunk");
    format!("  {work}: actor {}, {chunks}, {:.1} s since the last", lease.actor, lease.still_secs)
}

/// `s2mia health`
#[derive(Args, Debug)]
pub(crate) struct HealthArguments {
    /// URL of the learner.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:50051")]
    pub(crate) learner: String,
    /// Timeout for the learner's response.
    #[arg(long, value_name = "SECONDS", default_value = "3", value_parser = seconds)]
    pub(crate) timeout_secs: Duration,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ClientTlsArguments,
}

/// Ends with status 0 if the learner serves, else with a one-line reason.
pub(super) fn health(arguments: &HealthArguments) -> anyhow::Result<()> {
    let tls = credentials(&arguments.learner, &arguments.tls)?;
    let (url, timeout) = (&arguments.learner, arguments.timeout_secs);
    let asked =
        async { demand_serving(url, tls.as_ref(), timeout).await.map_err(anyhow::Error::from) };
    answered(asked, &arguments.tls, timeout)?;
    output::line(format!("{} serves", arguments.learner));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_that_no_deadline_can_have_are_refused() {
        for text in ["-1", "-1e300", "NaN", "inf", "1e300", "1.1e9", "soon", ""] {
            assert_eq!(seconds(text).unwrap_err(), "must be 0 to 1000000000 s", "{text}");
        }
        assert_eq!(seconds("0"), Ok(Duration::ZERO));
        assert_eq!(seconds("1e9"), Ok(Duration::from_secs(1_000_000_000)));
    }
}
