//! Updates of the off-policy learning rules: for each optimiser step a batch from the replay, targets, critics and policies.

use crate::Effort;
use crate::clock::{Took, median};
use crate::settings::CaseSettings;
use crate::table::CaseRow;
use crate::update::{Case, Updates};

const TASK: &str = "halfcheetah-2x3";

/// The learning rules with their default settings; one iteration has 500 environment steps.
const RULES: [(&str, &[&str]); 2] = [
    ("hasac", &["algorithm=hasac", "hasac.warm_up=500"]),
    ("maddpg", &["algorithm=maddpg", "maddpg.warm_up=500"]),
];

pub(crate) fn cases() -> anyhow::Result<Vec<Case>> {
    let case = |(rule, changes): (&str, &[&str])| {
        let settings = CaseSettings::of(&[&[TASK], changes].concat())?;
        let problem = settings.problem()?;
        Ok(Case { name: format!("{TASK} {rule}"), settings, problem })
    };
    RULES.into_iter().map(case).collect()
}

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    cases()?.iter().map(|case| row(case, effort)).collect()
}

fn row(case: &Case, effort: Effort) -> anyhow::Result<CaseRow> {
    let batch = case.batch();
    let mut one = Updates::new(&case.settings, &case.problem, 1)?;
    let mut two = Updates::new(&case.settings, &case.problem, 2)?;
    let (mut single, mut double) = (Vec::new(), Vec::new());
    for _ in 0..=effort.repeats.min(3) {
        single.push(one.run(&batch)?.whole);
        double.push(two.run(&batch)?.whole);
    }
    // The first iteration allocates.
    let of = |clock: fn(&Took) -> f64, updates: &[Took]| median(updates[1..].iter().map(clock));
    let (secs, steps) = (of(|took| took.wall, &double), optimiser_steps(case));
    let figures = vec![
        ("1 thread, processor s", of(|took| took.thread, &single)),
        ("2 threads, s", secs),
        ("2 threads, processor s", of(|took| took.process, &double)),
        ("optimiser steps", steps),
        ("2 threads, ms per optimiser step", 1e3 * secs / steps),
    ];
    Ok(CaseRow { case: case.name.clone(), figures })
}

/// Optimiser steps of the critics in one iteration.
pub(crate) fn optimiser_steps(case: &Case) -> f64 {
    let training = &case.settings.training;
    let per_step = training.hasac.as_ref().map(|hasac| hasac.updates_per_step);
    case.rows() as f64 * per_step.unwrap_or(training.maddpg.updates_per_step)
}
