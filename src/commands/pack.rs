//! `s2mia pack`: a copy of a run for others, without what belongs to this machine.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use clap::Args;
use learner::store::plain_file;
use learner::store::run_folder::{CONFIG, MANIFEST, METRICS, PROVENANCE, START_POLICIES, STARTS};

use crate::config::keys::{START_SHA256, URL};
use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::figures::chart;
use crate::process::{output, shell, target};
use crate::run::recorded::Recorded;
use crate::run::{run_path, start};

/// `s2mia pack`
#[derive(Args, Debug)]
pub(crate) struct PackArguments {
    /// Run folder.
    pub(crate) run: PathBuf,
    /// Folder to make [default: NAME-pack in the current folder, for the run folder's NAME].
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

/// Checks the records of the run, then copies them. A failure leaves no folder.
pub(super) fn run(arguments: &PackArguments) -> anyhow::Result<()> {
    let run = &arguments.run;
    run_path::demand_records(run)?;
    let default = || PathBuf::from(format!("{}-pack", run_path::name(run)));
    let pack = arguments.out.clone().unwrap_or_else(default);
    target::check_parent("--out", &pack)?;
    run_path::demand_outside_runs(&pack)?;
    let recorded = Recorded::read(run)?;
    recorded.demand_starts()?;
    let shown = pack.display();
    if pack.symlink_metadata().is_ok() {
        let why = format!("--out {shown}: already exists; name another place");
        return Err(Usage::new(why).into());
    }
    std::fs::create_dir(&pack).with_context(|| format!("cannot make {shown}"))?;
    let written = recorded.undisturbed(|recorded| write(recorded, &pack));
    if written.is_err() {
        // What was written so far is no pack.
        let _removed = std::fs::remove_dir_all(&pack);
    }
    written.with_context(|| format!("{} cannot be packed", run.display()))?;
    let iterations = chart::count_of(recorded.last(), "iteration");
    let checkpoints = chart::count_of(recorded.checkpoints.len() as u64, "checkpoint");
    let end = recorded.unfinished();
    output::line(format!("{shown}: {iterations}, {checkpoints}{end}"));
    output::line(format!("next:\n  s2mia verify {}", shell::path(&pack)));
    Ok(())
}

/// Writes the manifest last, which makes the folder a run.
fn write(recorded: &Recorded, pack: &Path) -> anyhow::Result<()> {
    ensure!(!recorded.checkpoints.is_empty(), "it has no checkpoint");
    for iteration in &recorded.checkpoints {
        let loaded = recorded.checkpoint(*iteration)?;
        loaded.copy_to(pack, &packed(recorded.settings_after(*iteration)?))?;
    }
    let settings = recorded.settings_after(0)?;
    let has_start = !settings.resolved.text(START_SHA256).is_empty();
    target::file(&pack.join(CONFIG), packed(settings).as_bytes())?;
    let kept = has_start.then_some(START_POLICIES);
    for name in kept.into_iter().chain([STARTS, METRICS, PROVENANCE, MANIFEST]) {
        let file = recorded.folder.join(name);
        let bytes = plain_file::read(&file);
        let bytes = bytes.with_context(|| format!("cannot read {}", file.display()))?;
        target::file(&pack.join(name), &bytes)?;
    }
    Ok(())
}

/// The settings as TOML, without the run's folder and the machine of its environment.
fn packed(config: RunConfig) -> String {
    let mut resolved = config.resolved;
    resolved.set("run.dir", "", "pack");
    let url = on_this_machine(resolved.text(URL));
    resolved.set(URL, url, "pack");
    start::take_kept(&mut resolved, Path::new(""));
    resolved.to_toml()
}

/// The URL of an environment with the same port on the reader's machine; empty for the simulator's.
fn on_this_machine(url: &str) -> String {
    if url.is_empty() {
        return String::new();
    }
    let port = url.trim_end_matches('/').rsplit(':').next();
    let port = port.and_then(|port| port.parse::<u16>().ok()).unwrap_or(80);
    format!("http://127.0.0.1:{port}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pack_names_the_port_of_an_environment_and_no_machine() {
        for (url, packed) in [
            ("", ""),
            ("http://gpu7.example.org:50061", "http://127.0.0.1:50061"),
            ("http://[fe80::1]:7/", "http://127.0.0.1:7"),
            ("http://[::1]", "http://127.0.0.1:80"),
            ("http://gpu7", "http://127.0.0.1:80"),
        ] {
            assert_eq!(on_this_machine(url), packed, "{url}");
        }
    }
}
