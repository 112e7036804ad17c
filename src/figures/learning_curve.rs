//! Learning curves of finished or unfinished runs, read from their folders and aggregated over seeds: one curve per
//! task and variant.

mod joining;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use kuva::render::layout::TickFormat;
use learner::observe::metrics;
use learner::store::run_folder::{METRICS, RunFolder};
use serde_json::Value;

use crate::config::keys::EVALUATED;
use crate::config::presets::ALGORITHMS;
use crate::errors::Usage;
use crate::figures::chart;
use crate::figures::statistics::Interval;
use crate::run::recorded::{all_lines, of_kind};
use crate::run::run_path::demand_run;
use crate::run::stored::config_of_run;

use joining::joined;
pub(crate) use joining::shortened;

/// Largest number of points of a curve; neighbouring iterations are averaged above it.
const MOST_POINTS: usize = 100;

/// Information that is smaller everywhere on an axis has exponents there.
const LEAST_FIXED: f64 = 0.002;

/// A quantity that changes during training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Quantity {
    /// Mean extrinsic return of an evaluation.
    Return,
    /// Bound of the entropy of observations (Eq. 2), mean over agents, nats.
    Surprise,
    /// Estimate of the information between an agent's action and the others' (Eq. 6 to 8), mean over agents, nats.
    Information,
}

impl Quantity {
    /// All quantities, in the order of their rows in a picture.
    pub(crate) const ALL: [Self; 3] = [Self::Return, Self::Surprise, Self::Information];

    /// Label of the y-axis.
    pub(crate) fn label(self) -> &'static str {
        match self {
            Self::Return => "evaluation return",
            Self::Surprise => "surprise, nats",
            Self::Information => "information, nats",
        }
    }

    /// Numbers on a y-axis whose values are at most `largest` from 0. Information is small: the axis has room for four decimals,
    /// and for exponents where these would be zeros.
    pub(crate) fn tick_format(self, largest: f64) -> TickFormat {
        match self {
            Self::Information if largest < LEAST_FIXED => {
                TickFormat::Custom(Arc::new(|value| format!("{value:.1e}")))
            }
            Self::Information => TickFormat::Fixed(4),
            Self::Return | Self::Surprise => TickFormat::Auto,
        }
    }

    /// Env steps and value of every line that has one, in order of env steps. Returns are those with actions of the same kind as
    /// in the last evaluation, mean or sampled.
    pub(crate) fn points(self, lines: &[Value]) -> Vec<(f64, f64)> {
        let of_figure = |name: &str| -> Vec<(f64, f64)> {
            let point =
                |line: &Value| Some((line["env_steps"].as_f64()?, mean_over_agents(line, name)?));
            lines.iter().filter_map(point).collect()
        };
        let mut points = match self {
            Self::Return => {
                let measured = metrics::measured(lines);
                let points = metrics::comparable(&measured);
                points.map(|one| (one.env_steps as f64, one.mean)).collect()
            }
            Self::Surprise => of_figure("surprise_entropy_bound"),
            Self::Information => of_figure("mi_estimate"),
        };
        points.sort_by(|left, right| left.0.total_cmp(&right.0));
        points
    }

    /// The number of neighbouring points of `count` that are averaged for a picture. Returns are few.
    fn averaged(self, count: usize) -> usize {
        match self {
            Self::Return => 1,
            Self::Surprise | Self::Information => count.div_ceil(MOST_POINTS).max(1),
        }
    }
}

/// Mean of `agent0/NAME`, `agent1/NAME` and so on; `None` if no agent has it, or if that of one is not finite (null).
fn mean_over_agents(line: &Value, name: &str) -> Option<f64> {
    let of = |agent: usize| line.get(format!("agent{agent}/{name}"));
    let values: Vec<f64> = (0..).map_while(of).map(Value::as_f64).collect::<Option<_>>()?;
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Settings that pictures show separately.
const SHOWN_ELSEWHERE: [&str; 3] = ["task", "algorithm", "run.seed"];

/// The curves of one run over environment steps.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Curve {
    /// Task.
    pub(crate) task: String,
    /// Algorithm, or the variant's name in pictures.
    pub(crate) algorithm: String,
    /// Seed.
    pub(crate) seed: String,
    /// Every other setting that affects the results and their evaluations; runs that differ in one are never aggregated.
    pub(crate) settings: BTreeMap<String, String>,
    /// Env steps and value, in order of env steps.
    pub(crate) points: BTreeMap<Quantity, Vec<(f64, f64)>>,
}

impl Curve {
    /// Env steps and values of a quantity; empty if the run has none.
    pub(crate) fn of(&self, quantity: Quantity) -> &[(f64, f64)] {
        self.points.get(&quantity).map_or(&[], Vec::as_slice)
    }

    /// Whether both are curves of one run, or of a run and its copy.
    pub(crate) fn is_of_the_run_of(&self, other: &Self) -> bool {
        (&self.task, &self.algorithm, &self.seed, &self.settings)
            == (&other.task, &other.algorithm, &other.seed, &other.settings)
    }
}

/// One line of a panel: the runs of one variant.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Series {
    /// Variant, for the legend; the same in every panel.
    pub(crate) label: String,
    /// Rank, which determines its colour and mark.
    pub(crate) rank: usize,
    /// Number of runs.
    pub(crate) runs: usize,
    /// In order of env steps.
    pub(crate) points: Vec<Point>,
}

/// The runs of a series after some env steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point {
    /// Environment steps.
    pub(crate) env_steps: f64,
    /// Interquartile mean over the runs.
    pub(crate) centre: f64,
    /// Its 95 % confidence interval by bootstrap.
    pub(crate) confidence: Interval,
    /// The runs' interquartile range.
    pub(crate) quartiles: Interval,
}

/// One pair of axes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Panel {
    /// Task.
    pub(crate) task: String,
    /// Quantity of the y-axis.
    pub(crate) quantity: Quantity,
    /// In order of rank.
    pub(crate) series: Vec<Series>,
}

/// Reads the curves of a run folder.
pub(crate) fn read(folder: &Path) -> anyhow::Result<Curve> {
    let folder = &RunFolder::of(folder);
    demand_run(folder)?;
    let metrics = folder.join(METRICS);
    let lines = all_lines(&metrics)?;
    let iterations = of_kind(&metrics, &lines, "iteration")?;
    let last = iterations.keys().last().copied().unwrap_or(0);
    if (iterations.len() as u64) < last {
        tracing::warn!(
            "{} has {} of {last} iterations: the curve has gaps",
            metrics.display(),
            iterations.len()
        );
    }
    let points = BTreeMap::from(Quantity::ALL.map(|quantity| (quantity, quantity.points(&lines))));
    let evaluations = of_kind(&metrics, &lines, "evaluation")?.len();
    let shown = points[&Quantity::Return].len();
    if shown < evaluations {
        tracing::warn!(
            "{} has {evaluations} evaluations, and the curve {shown}: the others have actions of another kind than the last one \
             (evaluation.sampled), or no finite return",
            metrics.display()
        );
    }
    Ok(Curve { points, ..without_points(folder)? })
}

/// Reads the settings of a run folder, without its curves.
pub(crate) fn without_points(folder: &Path) -> anyhow::Result<Curve> {
    let resolved = config_of_run(folder)?.resolved;
    let keys = resolved.semantic().map(|(key, _)| key).chain(EVALUATED);
    let keys = keys.filter(|key| !SHOWN_ELSEWHERE.contains(key));
    let settings = keys.map(|key| (key.to_owned(), resolved.shown(key))).collect();
    Ok(Curve {
        task: resolved.text("task").to_owned(),
        algorithm: resolved.text("algorithm").to_owned(),
        seed: resolved.shown("run.seed"),
        settings,
        points: BTreeMap::new(),
    })
}

/// Reads all runs; refuses folders without any evaluation, and runs that would count as several seeds although they are one.
pub(crate) fn read_all(folders: &[PathBuf]) -> anyhow::Result<Vec<Curve>> {
    let mut curves: Vec<Curve> = Vec::new();
    for folder in folders {
        let curve = read(folder)?;
        if curve.of(Quantity::Return).is_empty() {
            let metrics = RunFolder::of(folder).join(METRICS);
            let why = if !metrics.exists() {
                format!("{} is missing; restore it, or leave the run out", metrics.display())
            } else if all_lines(&metrics)?.is_empty() {
                let why = "has no line: the run has just begun, or the file was damaged";
                format!("{} {why}", metrics.display())
            } else {
                format!("{} has no evaluation yet; see evaluation.every_steps", folder.display())
            };
            return Err(Usage::new(why).into());
        }
        if let Some(other) = curves.iter().position(|other| other.is_of_the_run_of(&curve)) {
            let why = format!(
                "{} and {} have the same settings and seed, so they are not two runs; name one of them",
                folders[other].display(),
                folder.display()
            );
            return Err(Usage::new(why).into());
        }
        curves.push(curve);
    }
    Ok(curves)
}

/// Env steps and mean return of every evaluation in a `metrics.jsonl`; empty if there is none yet.
pub(crate) fn evaluations(metrics: &Path) -> anyhow::Result<Vec<(f64, f64)>> {
    Ok(Quantity::Return.points(&all_lines(metrics)?))
}

/// Runs that differ only in their seed, by task and by the name that distinguishes them from the task's other runs.
type Groups<'a> = BTreeMap<(&'a str, String), Vec<&'a Curve>>;

/// Rank of the variant `name` among those of a picture: shipped algorithms have fixed ranks, others those that are left.
fn rank(name: &str, names: &[&str]) -> usize {
    let shipped = |name: &str| ALGORITHMS.iter().position(|known| known.name == name);
    let is_free = |rank: &usize| !names.iter().any(|name| shipped(name) == Some(*rank));
    let others = names.iter().filter(|other| shipped(other).is_none());
    let index = others.take_while(|other| **other != name).count();
    let left = || (0..).filter(is_free).nth(index).expect("the ranks do not end");
    shipped(name).unwrap_or_else(left)
}

/// A panel for each quantity and task, quantity by quantity, tasks in the order of the curves; the same variant has the
/// same label in all.
pub(crate) fn panels(curves: &[Curve], quantities: &[Quantity]) -> Vec<Panel> {
    let groups = grouped(curves);
    let mut tasks: Vec<&str> = Vec::new();
    for curve in curves {
        if !tasks.contains(&curve.task.as_str()) {
            tasks.push(&curve.task);
        }
    }
    let labels = labels(&groups);
    let names: Vec<&str> = labels.keys().map(String::as_str).collect();
    let mut panels = Vec::new();
    for &quantity in quantities {
        for task in &tasks {
            let inside = groups.iter().filter(|((of, _), _)| of == task);
            let series = inside.filter_map(|((_, name), group)| {
                let rank = rank(name, &names);
                let points = joined(group, quantity);
                let label = labels[name].clone();
                (!points.is_empty()).then_some(Series { label, rank, runs: group.len(), points })
            });
            let mut series: Vec<Series> = series.collect();
            series.sort_by_key(|series| series.rank);
            panels.push(Panel { task: (*task).to_owned(), quantity, series });
        }
    }
    panels
}

fn grouped(curves: &[Curve]) -> Groups<'_> {
    let mut groups = Groups::new();
    for (curve, variant) in curves.iter().zip(variants(curves)) {
        groups.entry((&curve.task, variant)).or_default().push(curve);
    }
    groups
}

/// The variant of each run: runs of a task that differ only in their seed have the same one.
fn variants(curves: &[Curve]) -> Vec<String> {
    let mut rivals = BTreeMap::<_, Vec<&Curve>>::new();
    for curve in curves {
        rivals.entry((&curve.task, &curve.algorithm)).or_default().push(curve);
    }
    let different: BTreeMap<_, _> =
        rivals.into_iter().map(|(name, runs)| (name, different(&runs))).collect();
    curves
        .iter()
        .map(|curve| variant(curve, &different[&(&curve.task, &curve.algorithm)]))
        .collect()
}

/// As [`variants`], with the task before it if there are several.
pub(crate) fn tasks_and_variants(curves: &[Curve]) -> Vec<String> {
    let is_one = curves.iter().all(|curve| curve.task == curves[0].task);
    let names = curves.iter().zip(variants(curves));
    names
        .map(|(curve, name)| if is_one { name } else { format!("{} {name}", curve.task) })
        .collect()
}

/// The settings that differ between runs.
fn different<'a>(runs: &[&'a Curve]) -> BTreeSet<&'a String> {
    let keys: BTreeSet<&String> = runs.iter().flat_map(|run| run.settings.keys()).collect();
    let differs =
        |key: &&String| runs.iter().any(|run| run.settings.get(*key) != runs[0].settings.get(*key));
    keys.into_iter().filter(differs).collect()
}

/// The algorithm, then each setting in which some run of the same task and algorithm differs.
fn variant(curve: &Curve, different: &BTreeSet<&String>) -> String {
    let overrides = curve.settings.keys().filter(|key| different.contains(key));
    let shown = overrides.map(|key| format!(" {key}={}", brief(&curve.settings[key])));
    format!("{}{}", curve.algorithm, shown.collect::<String>())
}

/// A value as a name shows it: without quotes, eight digits of a SHA-256.
fn brief(value: &str) -> &str {
    let value = value.trim_matches('"');
    let is_digest = |digits: &str| digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    match value.len().checked_sub(64).and_then(|start| value.get(start..)) {
        Some(digits) if is_digest(digits) => &value[..value.len() - 56],
        _ if value.is_empty() => "none",
        _ => value,
    }
}

/// Text of each variant in the legend: its name, and its seed or the number of seeds.
fn labels(groups: &Groups<'_>) -> BTreeMap<String, String> {
    let names: BTreeSet<&String> = groups.keys().map(|(_, name)| name).collect();
    let label = |name: &String| {
        let of_name = groups.iter().filter(|((_, other), _)| other == name);
        let groups: Vec<&Vec<&Curve>> = of_name.map(|(_, group)| group).collect();
        let seeds: BTreeSet<&str> =
            groups.iter().flat_map(|g| g.iter().map(|c| c.seed.as_str())).collect();
        let (fewest, most) = groups.iter().fold((usize::MAX, 0), |(fewest, most), group| {
            (fewest.min(group.len()), most.max(group.len()))
        });
        match (fewest, most, seeds.first()) {
            (_, 1, Some(seed)) if seeds.len() == 1 => format!("{name} (seed {seed})"),
            (fewest, most, _) if fewest == most => {
                format!("{name} ({})", chart::count_of(most as u64, "seed"))
            }
            _ => format!("{name} ({fewest} to {most} seeds)"),
        }
    };
    names.into_iter().map(|name| (name.clone(), label(name))).collect()
}

#[cfg(test)]
mod tests;
