//! Updates of the off-policy learning rules: for each optimiser step a batch from the replay, targets, critics and policies.

use crate::Effort;
use crate::settings::CaseSettings;
use crate::table::CaseRow;
use crate::update::{self, Case};

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
    let (mut figures, _) = update::whole(case, effort)?;
    let ((_, secs), steps) = (figures[1], optimiser_steps(case));
    figures.push(("optimiser steps", steps));
    figures.push(("2 threads, ms per optimiser step", 1e3 * secs / steps));
    Ok(CaseRow { case: case.name.clone(), figures })
}

/// Optimiser steps of the critics in one iteration.
pub(crate) fn optimiser_steps(case: &Case) -> f64 {
    let training = &case.settings.training;
    let per_step = training.hasac.as_ref().map(|hasac| hasac.updates_per_step);
    case.rows() as f64 * per_step.unwrap_or(training.maddpg.updates_per_step)
}
