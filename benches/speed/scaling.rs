//! Cost of an update by number of agents, environments and units. The task is synthetic, with 24 features and 2 joints
//! per agent; all other settings are defaults of `s2mia train`.

use marl::{Batch, Problem};

use crate::Effort;
use crate::clock::{Took, median};
use crate::settings::CaseSettings;
use crate::synthetic;
use crate::table::CaseRow;
use crate::update::Updates;

const FEATURES: usize = 24;
const JOINTS: usize = 2;
const STEPS: usize = 200;

/// The varied sizes.
#[derive(Clone, Copy)]
struct Size {
    agents: usize,
    environments: usize,
    hidden: usize,
}

const USUAL: Size = Size { agents: 4, environments: 20, hidden: 64 };

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    let agents = [2, 4, 8, 16].map(|agents| Size { agents, ..USUAL });
    let environments = [10, 40, 80].map(|environments| Size { environments, ..USUAL });
    let hidden = [32, 128, 256].map(|hidden| Size { hidden, ..USUAL });
    agents.into_iter().chain(environments).chain(hidden).map(|size| row(size, effort)).collect()
}

fn row(size: Size, effort: Effort) -> anyhow::Result<CaseRow> {
    let Size { agents, environments, hidden } = size;
    let mut settings = CaseSettings::of(&["halfcheetah-2x3"])?;
    (settings.policy.encoder, settings.policy.hidden) = (hidden, hidden);
    let problem = synthetic::problem(agents, FEATURES, JOINTS);
    let batch = synthetic::batch(&problem, &settings.policy, (STEPS, environments));
    let (wall, processor) = update_secs(&settings, &problem, &batch, effort)?;
    let rows = (STEPS * environments * agents) as f64;
    let figures = vec![
        ("2 threads, processor s", processor),
        ("2 threads, s", wall),
        ("per agent and env step, processor µs", processor / rows * 1e6),
    ];
    let case = format!("{agents} agents, {environments} environments, GRU of {hidden}");
    Ok(CaseRow { case, figures })
}

/// Medians of wall and processor time of an update on two threads.
pub(crate) fn update_secs(
    settings: &CaseSettings,
    problem: &Problem,
    batch: &Batch,
    effort: Effort,
) -> anyhow::Result<(f64, f64)> {
    let mut updates = Updates::new(settings, problem, 2)?;
    updates.run(batch)?;
    let times = (0..effort.repeats.min(3)).map(|_| Ok(updates.run(batch)?.whole));
    let times = times.collect::<anyhow::Result<Vec<Took>>>()?;
    let wall = median(times.iter().map(|took| took.wall));
    Ok((wall, median(times.iter().map(|took| took.process))))
}
