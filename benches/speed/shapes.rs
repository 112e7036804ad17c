//! Checks that the shapes of the measured updates match docs/PERFORMANCE.md. `cargo test` runs this check too.

use anyhow::ensure;

use crate::Effort;
use crate::end_to_end;
use crate::off_policy;
use crate::settings::CaseSettings;
use crate::table::CaseRow;
use crate::update::{Case, TASKS, cases};

/// Shapes needed to time the update of another program.
pub(crate) fn rows(_effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    runs_are_as_their_tables_say()?;
    let row = |case: Case| {
        let (agent, training) = (&case.problem.agents[0], &case.settings.training);
        let (policy, update) = (&case.settings.policy, &training.update);
        let whole = |number: usize| number as f64;
        let hasac = training.hasac.as_ref();
        let figures = vec![
            ("agents", whole(case.problem.agents.len())),
            ("observation", whole(agent.observation)),
            ("action", whole(agent.action)),
            ("state", whole(case.problem.state)),
            ("hidden", whole(policy.hidden_size())),
            ("encoder", whole(policy.encoder)),
            ("width", whole(policy.width)),
            ("layers", whole(policy.layers)),
            ("chunk", whole(policy.backpropagation_steps)),
            ("epochs", whole(update.epochs)),
            ("minibatches", whole(update.minibatches)),
            ("critic epochs", whole(training.critic.epochs)),
            ("critic minibatches", whole(training.critic.minibatches)),
            ("posterior epochs", whole(training.influence.epochs)),
            ("replay batch", hasac.map_or(0.0, |own| whole(own.batch))),
            ("optimiser steps", hasac.map_or(0.0, |_| off_policy::optimiser_steps(&case))),
        ];
        CaseRow { case: case.name, figures }
    };
    Ok(cases()?.into_iter().chain(off_policy::cases()?).map(row).collect())
}

/// Fails with the case whose settings differ from its table's description.
fn runs_are_as_their_tables_say() -> anyhow::Result<()> {
    for Case { name, settings, .. } in cases()? {
        check(&name, &settings)?;
    }
    for task in TASKS {
        for (name, changes) in end_to_end::runs() {
            check(&format!("{task} {name}"), &CaseSettings::harl(task, &[&changes])?)?;
        }
    }
    Ok(())
}

fn check(case: &str, settings: &CaseSettings) -> anyhow::Result<()> {
    let (policy, update) = (&settings.policy, &settings.training.update);
    let epochs = if case.starts_with("halfcheetah") { 15 } else { 5 };
    let minibatches = if case.starts_with("walker2d") { 2 } else { 1 };
    let (found, expected) = if case.contains("gru") {
        let units = if case.ends_with("gru 128") { 128 } else { 64 };
        let chunk = if case.ends_with("sequences of 200") { 200 } else { 10 };
        (
            [policy.encoder, policy.hidden_size(), policy.backpropagation_steps],
            [units, units, chunk],
        )
    } else {
        ([policy.width, policy.layers, policy.backpropagation_steps], [128, 3, 1])
    };
    ensure!(
        found == expected && (update.epochs, update.minibatches) == (epochs, minibatches),
        "{case}: expected {expected:?}, {epochs} epochs, {minibatches} minibatches; found {found:?}, {} and {}",
        update.epochs,
        update.minibatches,
    );
    let environments = &settings.learner.environments;
    ensure!((environments.count, environments.steps) == (20, 200), "{case}: not 20 x 200 steps");
    Ok(())
}
