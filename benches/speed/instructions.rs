//! Instructions of one short update, counted by valgrind's callgrind, so that other work on the machine does not affect
//! the figure. valgrind does not support AVX-512, so the updates run with AVX2, on one thread.

use std::process::Command;

use anyhow::{Context as _, bail, ensure};
use marl::{Algorithm, Batch, MarlError, Surprise};

use crate::Effort;
use crate::table::CaseRow;
use crate::update::{CORES, Case, TASKS, Updates};

/// The option with which this program starts itself under valgrind; the case follows.
pub(crate) const ONE_UPDATE: &str = "--one-update=";

/// Shortens the update, which would take half an hour: valgrind emulates each fused multiply-add in software.
const SHORT: [&str; 5] = [
    "environments.count=5",
    "environments.per_slot=1",
    "update.epochs=1",
    "critic.epochs=1",
    "influence.epochs=1",
];

/// The line of callgrind's output with the count.
const COUNT: &str = "Collected :";

pub(crate) fn rows(_effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    let mut rows = Vec::new();
    for task in TASKS {
        for core in CORES {
            let case = format!("{task} {core}");
            let figures = vec![("instructions, millions", counted(&case)? / 1e6)];
            rows.push(CaseRow { case, figures });
        }
    }
    Ok(rows)
}

/// Instructions of one update of a case.
fn counted(case: &str) -> anyhow::Result<f64> {
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg("--toggle-collect=*counted_update*")
        .arg(std::env::current_exe()?)
        .arg(format!("{ONE_UPDATE}{case}"))
        .output()
        .context("`instructions` needs valgrind, which cannot be started")?;
    let told = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{case} under valgrind: {told}");
    let count = told.lines().find_map(|line| line.split_once(COUNT));
    let (_, count) = count.with_context(|| format!("no `{COUNT}` in: {told}"))?;
    Ok(count.trim().parse()?)
}

/// One update on one thread, run under callgrind.
pub(crate) fn one_update(case: &str) -> anyhow::Result<()> {
    let Some((task, core)) = case.split_once(' ') else {
        bail!("{case} does not name a task and a core")
    };
    let case = Case::of(task, core, core, &SHORT)?;
    let batch = case.batch();
    let mut updates = Updates::new(&case.settings, &case.problem, 1)?;
    let Updates { surprise, algorithm, pool, .. } = &mut updates;
    Ok(pool.install(|| counted_update(surprise, algorithm.as_mut(), &batch))?)
}

/// Callgrind counts while a function of this name runs, so it has no closures and is never inlined.
#[inline(never)]
fn counted_update(
    surprise: &mut Surprise,
    algorithm: &mut dyn Algorithm,
    batch: &Batch,
) -> Result<(), MarlError> {
    surprise.refit(batch, 0)?;
    let rewards = surprise.relabel(batch);
    algorithm.update(batch, &rewards, 0)?;
    Ok(())
}
