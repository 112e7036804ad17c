//! The parts of the learner's update, for the shapes of HARL's tuned settings.

use std::sync::{Mutex, Once};

use marl::{Algorithm, Batch, Problem, Surprise};
use policy::RunSeed;
use rayon::{ThreadPool, ThreadPoolBuilder};
use tracing::span::Id;
use tracing::{Metadata, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::FilterFn;
use tracing_subscriber::layer::{Context, SubscriberExt as _};
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::clock::{Took, median, once, thread_secs};
use crate::settings::{self, CaseSettings};
use crate::table::{CaseRow, Figures};
use crate::{Effort, synthetic};

/// Tasks whose updates differ most.
pub(crate) const TASKS: [&str; 3] = ["halfcheetah-6x1", "walker2d-2x3", "ant-4x2"];
pub(crate) const CORES: [&str; 2] = ["mlp", "gru"];

/// Names of the spans of an on-policy update, in the order in which they begin.
const PHASES: [&str; 6] = ["values", "advantages", "behaviour", "posteriors", "policies", "critic"];

/// One task with one core.
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) settings: CaseSettings,
    pub(crate) problem: Problem,
}

/// All tasks with all cores, and one recurrent core trained on whole slots instead of chunks of 10.
pub(crate) fn cases() -> anyhow::Result<Vec<Case>> {
    let mut cases = Vec::new();
    for task in TASKS {
        for core in CORES {
            cases.push(Case::of(task, core, core, &[])?);
        }
    }
    let whole = ["policy.backpropagation_steps=200", "environments.message_steps=200"];
    cases.push(Case::of(TASKS[0], "gru", "gru, sequences of 200", &whole)?);
    Ok(cases)
}

impl Case {
    pub(crate) fn of(task: &str, core: &str, name: &str, changes: &[&str]) -> anyhow::Result<Self> {
        let settings = CaseSettings::harl(task, &[settings::core(core), changes])?;
        let problem = settings.problem()?;
        Ok(Self { name: format!("{task} {name}"), settings, problem })
    }

    pub(crate) fn rows(&self) -> usize {
        let environments = &self.settings.learner.environments;
        environments.count * environments.steps
    }

    pub(crate) fn batch(&self) -> Batch {
        let environments = &self.settings.learner.environments;
        let sizes = (environments.steps, environments.count);
        synthetic::batch(&self.problem, &self.settings.policy, sizes)
    }
}

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    cases()?.iter().map(|case| row(case, effort)).collect()
}

/// Medians of whole updates on one thread and on two, in turns, and the updates on one thread. The first of each, which
/// allocates, is not counted.
pub(crate) fn whole(case: &Case, effort: Effort) -> anyhow::Result<(Figures, Vec<Parts>)> {
    let batch = case.batch();
    let mut one = Updates::new(&case.settings, &case.problem, 1)?;
    let mut two = Updates::new(&case.settings, &case.problem, 2)?;
    one.run(&batch)?;
    two.run(&batch)?;
    let (mut single, mut double) = (Vec::new(), Vec::new());
    for _ in 0..effort.repeats.min(3) {
        single.push(one.run(&batch)?);
        double.push(two.run(&batch)?);
    }
    let figures = vec![
        ("1 thread, processor s", median_of(|parts| parts.whole.thread, &single)),
        ("2 threads, s", median_of(|parts| parts.whole.wall, &double)),
        ("2 threads, processor s", median_of(|parts| parts.whole.process, &double)),
    ];
    Ok((figures, single))
}

fn median_of(part: fn(&Parts) -> f64, updates: &[Parts]) -> f64 {
    median(updates.iter().map(part))
}

fn row(case: &Case, effort: Effort) -> anyhow::Result<CaseRow> {
    let (mut figures, single) = whole(case, effort)?;
    figures.push(("density, s", median_of(|parts| parts.density, &single)));
    figures.push(("relabel, s", median_of(|parts| parts.relabel, &single)));
    let names =
        ["values, s", "advantages, s", "behaviour, s", "posteriors, s", "policies, s", "critic, s"];
    for (phase, name) in names.into_iter().enumerate() {
        figures.push((name, median(single.iter().map(|parts| parts.phases[phase]))));
    }
    Ok(CaseRow { case: case.name.clone(), figures })
}

/// A learning rule and its densities in a thread pool.
pub(crate) struct Updates {
    pub(crate) surprise: Surprise,
    pub(crate) algorithm: Box<dyn Algorithm>,
    pub(crate) pool: ThreadPool,
    iteration: u64,
}

/// Processor time of the parts of an update on the calling thread, seconds; complete only with one thread.
pub(crate) struct Parts {
    density: f64,
    relabel: f64,
    /// Parts in the order of [`PHASES`].
    phases: [f64; 6],
    /// The whole update.
    pub(crate) whole: Took,
}

impl Updates {
    pub(crate) fn new(
        settings: &CaseSettings,
        problem: &Problem,
        threads: usize,
    ) -> anyhow::Result<Self> {
        Stopwatch::start();
        let algorithm = marl::build(&settings.training, &settings.policy, problem, RunSeed(0))?;
        Ok(Self {
            surprise: Surprise::new(&settings.training.surprise, problem, RunSeed(0))?,
            algorithm,
            pool: ThreadPoolBuilder::new().num_threads(threads).build()?,
            iteration: 0,
        })
    }

    /// The current policies.
    pub(crate) fn snapshot(&self) -> anyhow::Result<policy::PolicySnapshot> {
        Ok(self.algorithm.snapshot()?)
    }

    /// Runs one update, as in the learner.
    pub(crate) fn run(&mut self, batch: &Batch) -> anyhow::Result<Parts> {
        let Self { surprise, algorithm, pool, iteration } = self;
        let (updated, wall) = once(|| {
            pool.install(|| {
                let (parts, whole) = once(|| {
                    let (refitted, density) = once(|| surprise.refit(batch, *iteration));
                    refitted?;
                    let (rewards, relabel) = once(|| surprise.relabel(batch));
                    algorithm.update(batch, &rewards, *iteration)?;
                    Ok::<_, marl::MarlError>((density.thread, relabel.thread))
                });
                parts.map(|parts| (parts, whole))
            })
        });
        *iteration += 1;
        let ((density, relabel), whole) = updated?;
        let whole = Took { wall: wall.wall, ..whole };
        Ok(Parts { density, relabel, phases: Stopwatch::read(), whole })
    }
}

/// For each part, processor time at the beginning of its span, and the duration of the last span.
static SPANS: Mutex<[(f64, f64); PHASES.len()]> = Mutex::new([(0.0, 0.0); PHASES.len()]);

/// Measures the spans of an update.
struct Stopwatch;

impl Stopwatch {
    /// Starts measuring; called once per process.
    fn start() {
        static STARTED: Once = Once::new();
        let of_updates =
            |metadata: &Metadata<'_>| metadata.is_span() && metadata.target().starts_with("marl");
        let layer = || Stopwatch.with_filter(FilterFn::new(of_updates));
        STARTED.call_once(|| tracing_subscriber::registry().with(layer()).init());
    }

    fn read() -> [f64; PHASES.len()] {
        SPANS.lock().expect("no reader panics").map(|(_, secs)| secs)
    }
}

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Stopwatch {
    fn on_enter(&self, id: &Id, context: Context<'_, S>) {
        change(id, &context, |(begun, _)| *begun = thread_secs());
    }

    fn on_exit(&self, id: &Id, context: Context<'_, S>) {
        change(id, &context, |(begun, secs)| *secs = thread_secs() - *begun);
    }
}

fn change<S: Subscriber + for<'a> LookupSpan<'a>>(
    id: &Id,
    context: &Context<'_, S>,
    change: impl FnOnce(&mut (f64, f64)),
) {
    let name = context.span(id).map_or("", |span| span.name());
    if let Some(place) = PHASES.iter().position(|known| *known == name) {
        change(&mut SPANS.lock().expect("no reader panics")[place]);
    }
}
