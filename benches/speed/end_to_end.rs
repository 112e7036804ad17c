//! `s2mia train` as a user starts it: environment steps per second and memory of all its processes.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::bail;

use crate::Effort;
use crate::clock::median;
use crate::processes::{children, peak_megabytes, processor_secs};
use crate::settings::{self, CaseSettings, program};
use crate::table::CaseRow;
use crate::update::TASKS;

/// Iterations that are not counted, because caches are cold.
pub(crate) const COLD: usize = 2;

const POLL_INTERVAL: Duration = Duration::from_millis(5);
const TIMEOUT: Duration = Duration::from_secs(120);

const WIDE: [&str; 2] = ["policy.encoder=128", "policy.hidden=128"];

/// Names of the runs of each task, and their changes to the preset.
pub(crate) fn runs() -> [(&'static str, Vec<&'static str>); 3] {
    let gru = settings::core("gru");
    [
        ("happo, mlp", [&["algorithm=happo"], settings::core("mlp")].concat()),
        ("happo-s2mia, gru 64", gru.to_vec()),
        ("happo, gru 128", [&["algorithm=happo"], gru, &WIDE].concat()),
    ]
}

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    let mut rows = Vec::new();
    for task in TASKS {
        for (name, more) in runs() {
            rows.push(row(task, name, &more, effort)?);
        }
    }
    Ok(rows)
}

fn row(task: &str, name: &str, more: &[&str], effort: Effort) -> anyhow::Result<CaseRow> {
    let settings = [&[task, "preset=harl"], more].concat();
    let environments = &CaseSettings::of(&settings)?.learner.environments;
    let steps = (environments.count * environments.steps) as f64;
    let folder = tempfile::tempdir()?;
    let dir = format!("run.dir={}", folder.path().join("run").display());
    let length = format!("run.iterations={}", COLD + effort.iterations);
    let own = ["run.actors=2", "evaluation.every_steps=0", dir.as_str(), length.as_str()];
    let train = program(&[&["train"], settings.as_slice(), &own].concat())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()?;
    let watched = watch(train, &folder.path().join("run/metrics.jsonl"))?;
    let figures = vec![
        ("env steps/s", steps / median(watched.lasted())),
        ("iteration, s", median(watched.lasted())),
        ("rollout, s", median(watched.values_of("rollout_secs"))),
        ("update, s", median(watched.values_of("update_secs"))),
        ("learner, MB", watched.learner),
        ("learner and actors, MB", watched.learner + watched.others),
    ];
    Ok(CaseRow { case: format!("{task} {name}"), figures })
}

/// An iteration's line of metrics, and processor times when it was read.
struct Line {
    when: Instant,
    /// Processor time so far of the watched process and of this one, seconds.
    used: (f64, f64),
    metrics: serde_json::Value,
}

/// The measurements of a finished run.
pub(crate) struct Watched {
    lines: Vec<Line>,
    /// Peak memory of the process itself, MB.
    pub(crate) learner: f64,
    /// Sum of the peak memory of its children, MB.
    others: f64,
}

impl Watched {
    /// Seconds between iterations, without the cold ones.
    pub(crate) fn lasted(&self) -> Vec<f64> {
        self.between(|line, before| (line.when - before.when).as_secs_f64())
    }

    /// Processor time of the watched process in each of them, seconds.
    pub(crate) fn used(&self) -> Vec<f64> {
        self.between(|line, before| line.used.0 - before.used.0)
    }

    /// Processor time of this process in each of them, seconds.
    pub(crate) fn used_here(&self) -> Vec<f64> {
        self.between(|line, before| line.used.1 - before.used.1)
    }

    /// One figure of the metrics in each of them.
    pub(crate) fn values_of(&self, name: &str) -> Vec<f64> {
        self.between(|line, _| line.metrics[name].as_f64().unwrap_or(f64::NAN))
    }

    fn between(&self, difference: impl Fn(&Line, &Line) -> f64) -> Vec<f64> {
        let warm = &self.lines[(COLD - 1).min(self.lines.len())..];
        warm.windows(2).map(|pair| difference(&pair[1], &pair[0])).collect()
    }
}

/// Follows a run until its process ends.
///
/// # Errors
/// The run makes no progress for too long.
pub(crate) fn watch(mut process: Child, metrics: &Path) -> anyhow::Result<Watched> {
    let (mut lines, mut learner, mut others) = (Vec::<Line>::new(), 0.0_f64, BTreeMap::new());
    let mut moved = Instant::now();
    while process.try_wait()?.is_none() {
        let text = std::fs::read_to_string(metrics).unwrap_or_default();
        let complete = text.lines().filter_map(|line| serde_json::from_str(line).ok());
        for metrics in complete.skip(lines.len()).collect::<Vec<_>>() {
            moved = Instant::now();
            let used = (processor_secs(process.id()), processor_secs(std::process::id()));
            lines.push(Line { when: moved, used, metrics });
            learner = learner.max(peak_megabytes(process.id()));
            let now = children(process.id()).into_iter();
            others.extend(now.map(|child| (child, peak_megabytes(child))));
        }
        if moved.elapsed() > TIMEOUT {
            process.kill()?;
            bail!("{} stands still", metrics.display());
        }
        sleep(POLL_INTERVAL);
    }
    Ok(Watched { lines, learner, others: others.values().sum() })
}
