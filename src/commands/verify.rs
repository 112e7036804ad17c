//! `s2mia verify`: parts of a run are computed again and compared with what the run recorded.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use proto::name::printable;

use crate::figures::chart;
use crate::process::output;
use crate::progress::WorkProgress;
use crate::run::chosen::ProgramArguments;
use crate::run::recorded::Recorded;
use crate::run::verification::{self, Part, Verifier};
use crate::run::{BUILD, resume, run_path};

/// `s2mia verify`
#[derive(Args, Debug)]
pub(crate) struct VerifyArguments {
    /// Run folder, or what `s2mia pack` made of one.
    pub(crate) run: PathBuf,
    /// How many iterations to compute again, at random places. As each place begins at the seed or a kept checkpoint, the run
    /// can be computed as a whole with its number of iterations.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) iterations: u64,
    /// Environment.
    #[command(flatten)]
    pub(crate) program: ProgramArguments,
}

/// Prints what is equal. The first difference, or what is missing or damaged, is an error.
pub(super) fn run(arguments: &VerifyArguments) -> anyhow::Result<()> {
    let run = &arguments.run;
    run_path::demand_records(run)?;
    // One status for every cause, also for settings and programs that are not those of the run.
    let verified = verify(arguments).map_err(|why| {
        anyhow::anyhow!("{} is not verified: {}", run.display(), actor::causes(why.as_ref()))
    });
    verified.map(output::line)
}

/// The last line.
fn verify(arguments: &VerifyArguments) -> anyhow::Result<String> {
    Recorded::read(&arguments.run)?.undisturbed(|recorded| recomputed(arguments, recorded))
}

/// Computes random parts of the run again, and says how much is equal.
fn recomputed(arguments: &VerifyArguments, recorded: &Recorded) -> anyhow::Result<String> {
    let VerifyArguments { run, iterations: count, program } = arguments;
    let fingerprint = rollout::rollout_fingerprint();
    resume::demand_same_program(run, fingerprint, recorded.config_sha256())?;
    recorded.demand_starts()?;
    recorded.demand_checkpoints()?;
    let parts = verification::parts(&recorded.checkpoints, recorded.last());
    output::line(opening(recorded, &parts)?);
    let chosen = verification::chosen(verification::shuffled(parts), *count);
    let total = chosen.iter().map(|part| part.length()).sum();
    let verifier = Verifier::of(recorded, program)?;
    let progress = Arc::new(WorkProgress::new());
    let (mut begun, mut iterations) = (0, 0);
    let mut evaluations = BTreeSet::new();
    for part in chosen {
        let bar = Arc::clone(&progress);
        let confirmed = verifier.verify(part, move |iteration| {
            let done = begun + iteration - part.start;
            bar.reach(done, total, || format!("iteration {iteration}, {}", part.origin()));
        })?;
        progress.print(equal(part, recorded.last(), &confirmed.weights_sha256));
        for (iteration, mean) in confirmed.evaluations {
            // A checkpoint's evaluation belongs to the parts before and after it.
            if evaluations.insert(iteration) {
                progress.print(format!(
                    "equal: evaluation after iteration {iteration}, return {mean:.1}"
                ));
            }
        }
        begun += part.length();
        iterations += recorded.last().min(part.end) - part.start;
    }
    let (iterations, all) = (chart::thousands(iterations), chart::thousands(recorded.last()));
    let (run, evaluations, made) = (run.display(), evaluations.len(), recorded.evaluations.len());
    let end = recorded.unfinished();
    Ok(format!(
        "{run} is verified: {iterations} of its {all} iterations and {evaluations} of its {made} evaluations have the recorded \
         results{end}"
    ))
}

/// What the run is, which programs computed it and compute it now, and what of it can be verified.
fn opening(recorded: &Recorded, parts: &[Part]) -> anyhow::Result<String> {
    let config = &recorded.config;
    let builds = recorded.builds()?.into_iter().collect::<Vec<_>>().join(", ");
    let parts = parts.iter().filter(|part| part.length() > 0);
    let parts: Vec<_> = parts.map(|part| shown(*part, part.end)).collect();
    Ok(format!(
        "{}: task {}, algorithm {}, seed {}\n\
         config_sha256 {}\n\
         computed by {builds}; this is {BUILD} with registers of the kind {}\n\
         recorded: {}",
        recorded.folder.display(),
        recorded.manifest["task"].as_str().map(printable).unwrap_or_default(),
        config.resolved.text("algorithm"),
        config.run.seed,
        recorded.config_sha256(),
        kernels::width().name(),
        parts.join(", "),
    ))
}

/// The iterations of a part up to `end`.
fn shown(part: Part, end: u64) -> String {
    let (first, last) = (part.start + 1, end);
    let iterations = if first == last {
        format!("iteration {last}")
    } else {
        format!("iterations {first} to {last}")
    };
    format!("{iterations} {}", part.origin())
}

/// What is equal in a part, which ends with these weights, of a run of `last` iterations.
fn equal(part: Part, last: u64, weights: &str) -> String {
    if part.start < last {
        format!("equal: {}, weights_sha256 {weights}", shown(part, part.end.min(last)))
    } else {
        format!("equal: policies of the checkpoint of iteration {}", part.start)
    }
}
