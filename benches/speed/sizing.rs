//! The number of actor cores that suits a learner, from the costs of rollouts and update on one core. Rollouts end
//! before the update begins, so with as many actor cores as the ratio of the costs, each side works half of the time.

use crate::Effort;
use crate::clock::typical;
use crate::run_in_process::FirstSlot;
use crate::scaling::update_secs;
use crate::settings::CaseSettings;
use crate::synthetic;
use crate::table::CaseRow;
use crate::update::TASKS;

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    let mut rows = Vec::new();
    for task in TASKS {
        for preset in ["tuned", "harl"] {
            rows.push(row(task, preset, effort)?);
        }
    }
    Ok(rows)
}

fn row(task: &str, preset: &str, effort: Effort) -> anyhow::Result<CaseRow> {
    let settings = CaseSettings::of(&[task, &format!("preset={preset}")])?;
    let environments = &settings.learner.environments;
    let (steps, per_slot) = (environments.steps, environments.per_slot);
    let problem = settings.problem()?;
    let batch = synthetic::batch(&problem, &settings.policy, (steps, environments.count));
    let (wall, learner) = update_secs(&settings, &problem, &batch, effort)?;
    let mut slot = FirstSlot::of(&settings)?;
    let took = typical(effort.repeats, || drop(slot.roll_out()));
    let rate = (steps * per_slot) as f64 / took.thread;
    let total = (steps * environments.count) as f64;
    let figures = vec![
        ("env steps/s of an actor core", rate),
        ("rollouts, processor s", total / rate),
        ("update, processor s", learner),
        ("update on 2 threads, s", wall),
        ("actor cores for one learner core", total / rate / learner),
    ];
    Ok(CaseRow { case: format!("{task} {preset}"), figures })
}
