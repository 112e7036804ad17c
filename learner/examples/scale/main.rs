//! How far one learner reaches: a simulation of a learner with 10 to 10,000 actors, from measured costs and with the
//! learner's own slot table. docs/SCALE.md explains model and results.
//!
//! `cargo run --release -p learner --example scale` prints the tables as Markdown. With a path as argument it also writes
//! them there as CSV, which `benches/python/scale_picture.py` draws.

mod cluster;
mod costs;
mod figures;
mod scenario;
mod servers;
#[cfg(test)]
mod tests;

use std::fmt::Write as _;

use crate::cluster::Cluster;
use crate::costs::{
    DAILY_FAILURES, PREEMPTIBLE, SLOT_STEPS, SLOW_MACHINES, TASKS, Task, load, scenario,
};
use crate::figures::Totals;
use crate::scenario::{Duplicates, Scenario};

/// Numbers of actors.
const ACTORS: [usize; 7] = [10, 30, 100, 300, 1_000, 3_000, 10_000];
/// Threads of the learner.
const THREADS: usize = 16;
/// Iterations before the counted ones: the table does not know yet how long a slot takes.
const WARM_UP: u64 = 2;
/// Counted slots, in whole iterations, of which there are at least and at most so many.
const SLOTS: u64 = 200_000;
const ITERATIONS: (u64, u64) = (10, 5_000);

/// Name of a variant, and what it changes.
type Variant = (&'static str, fn(&mut Scenario));

/// The variants of a scenario, by column.
const VARIANTS: [Variant; 6] = [
    ("all well", |_| {}),
    ("slow machines, no duplicates", |it| {
        (it.slow, it.duplicates) = (SLOW_MACHINES, Duplicates::No);
    }),
    ("slow machines", |it| it.slow = SLOW_MACHINES),
    ("a failure a day", |it| it.failures = DAILY_FAILURES),
    ("preemptible, no duplicates", |it| {
        (it.failures, it.duplicates) = (PREEMPTIBLE, Duplicates::No);
    }),
    ("preemptible", |it| it.failures = PREEMPTIBLE),
];

fn main() -> std::io::Result<()> {
    let mut csv = "task,actors,variant,steps_per_sec,iteration_secs,idle,rollouts,locked,failures,reissued,backups\n"
        .to_owned();
    for task in &TASKS {
        println!("{}", header(task));
        for actors in ACTORS {
            let totals = VARIANTS.map(|(name, change)| {
                let totals = simulate(task, actors, change);
                let _ = writeln!(
                    csv,
                    "\"{}\",{actors},\"{name}\",{}",
                    task.name,
                    line(&totals, actors)
                );
                totals
            });
            println!("{}", row(&totals, actors));
        }
        println!();
    }
    println!("{}", load_table());
    match std::env::args().nth(1) {
        Some(path) => std::fs::write(path, csv),
        None => Ok(()),
    }
}

fn simulate(task: &Task, actors: usize, change: fn(&mut Scenario)) -> Totals {
    let mut scenario = scenario(task, THREADS, actors);
    change(&mut scenario);
    let iterations = (SLOTS / u64::from(scenario.slots)).clamp(ITERATIONS.0, ITERATIONS.1);
    let mut cluster = Cluster::new(scenario);
    cluster.run(WARM_UP);
    cluster.run(iterations)
}

/// Environment steps per second.
fn rate(totals: &Totals) -> f64 {
    totals.slots as f64 * SLOT_STEPS / totals.elapsed.as_secs_f64()
}

fn header(task: &Task) -> String {
    let names = VARIANTS.map(|(name, _)| name).join(" | ");
    let columns = "| actors | iteration, s | actors idle | learner waits | table locked |";
    format!(
        "### {}: env steps/s\n\n{columns} {names} |\n|{}",
        task.name,
        " --- |".repeat(5 + VARIANTS.len())
    )
}

fn row(totals: &[Totals; 6], actors: usize) -> String {
    let well = &totals[0];
    let share = |share: f64| format!("{:.0} %", 100.0 * share);
    let rates = totals.map(|totals| format!("{:.0}", rate(&totals))).join(" | ");
    format!(
        "| {actors} | {:.1} | {} | {} | {} | {rates} |",
        well.iteration_secs(),
        share(well.idle_share(actors)),
        share(well.rollout_share()),
        share(well.locked_share()),
    )
}

fn line(totals: &Totals, actors: usize) -> String {
    let Totals { failures, reissued, backups, .. } = totals;
    format!(
        "{:.1},{:.4},{:.4},{:.4},{:.4},{failures},{reissued},{backups}",
        rate(totals),
        totals.iteration_secs(),
        totals.idle_share(actors),
        totals.rollout_share(),
        totals.locked_share(),
    )
}

/// Predictions for the load test.
fn load_table() -> String {
    let mut table =
        "### load\n\n| actors | collected, s | env steps/s |\n| --- | --- | --- |\n".to_owned();
    for actors in load::ACTORS {
        let mut cluster = Cluster::new(load::scenario(actors));
        cluster.run(1);
        let totals = cluster.run(3);
        let collected = totals.rollouts.as_secs_f64() / totals.iterations as f64;
        let rate = f64::from(load::SLOTS) * load::STEPS / collected;
        let _ = writeln!(table, "| {actors} | {collected:.2} | {rate:.0} |");
    }
    table
}
