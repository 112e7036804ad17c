//! The evaluation returns of finished or running runs, read from their folders, and what is drawn of them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;

use crate::commands::Usage;
use crate::config::{Request, Resolved, layers};
use crate::run_path;

/// Evaluations of one run, in order of env steps.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Curve {
    /// Name of the run folder.
    pub(crate) name: String,
    /// Task.
    pub(crate) task: String,
    /// Algorithm.
    pub(crate) algorithm: String,
    /// Seed.
    pub(crate) seed: String,
    /// Every other semantic setting; runs that differ in one are never averaged.
    pub(crate) settings: String,
    /// Env steps and mean extrinsic return.
    pub(crate) points: Vec<(f64, f64)>,
}

/// One line of a picture: a run, or the mean over the seeds of several runs with its range.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Series {
    /// For the legend.
    pub(crate) label: String,
    /// Runs in it.
    pub(crate) runs: usize,
    /// In order of env steps.
    pub(crate) points: Vec<Point>,
}

/// Returns of a series after some env steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point {
    /// Environment steps.
    pub(crate) env_steps: f64,
    /// Mean over the runs.
    pub(crate) mean: f64,
    /// Smallest of the runs.
    pub(crate) low: f64,
    /// Largest of the runs.
    pub(crate) high: f64,
}

/// Reads the curve of a run folder.
pub(crate) fn read(folder: &Path) -> anyhow::Result<Curve> {
    let file = run_path::config_file(folder);
    if !file.is_file() {
        return Err(Usage::new(format!(
            "{} is no run folder: it has no config.toml",
            folder.display()
        ))
        .into());
    }
    let resolved = layers::resolve(&Request { resumed: Some(file), ..Request::default() })?;
    Ok(Curve {
        name: run_path::name(folder),
        task: resolved.text("task").to_owned(),
        algorithm: resolved.text("algorithm").to_owned(),
        seed: resolved.shown("run.seed"),
        settings: settings_but_seed(&resolved),
        points: evaluations(&run_path::metrics_file(folder))?,
    })
}

fn settings_but_seed(resolved: &Resolved) -> String {
    let semantic = resolved.semantic().filter(|(key, _)| *key != "run.seed");
    semantic.map(|(key, value)| format!("{key} = {value}\n")).collect()
}

/// Env steps and mean return of every evaluation in a `metrics.jsonl`; empty if there is none yet.
pub(crate) fn evaluations(metrics: &Path) -> anyhow::Result<Vec<(f64, f64)>> {
    if !metrics.exists() {
        return Ok(Vec::new());
    }
    let text = std::fs::read_to_string(metrics)
        .with_context(|| format!("cannot read {}", metrics.display()))?;
    let mut points: Vec<(f64, f64)> = text.lines().filter_map(evaluation).collect();
    points.sort_by(|left, right| left.0.total_cmp(&right.0));
    Ok(points)
}

/// The evaluation in one line. A run that still writes may end in half a line, which is no evaluation.
fn evaluation(line: &str) -> Option<(f64, f64)> {
    let values: serde_json::Value = serde_json::from_str(line).ok()?;
    let of_evaluation = values["kind"] == "evaluation";
    of_evaluation.then_some((values["env_steps"].as_f64()?, values["mean"].as_f64()?))
}

/// Joins runs that differ in nothing but their seed.
pub(crate) fn series(curves: &[Curve]) -> Vec<Series> {
    let mut groups: BTreeMap<(&str, &str, &str), Vec<&Curve>> = BTreeMap::new();
    for curve in curves {
        groups.entry((&curve.task, &curve.algorithm, &curve.settings)).or_default().push(curve);
    }
    let tasks: std::collections::BTreeSet<&str> = curves.iter().map(|c| c.task.as_str()).collect();
    let mut all: Vec<Series> = groups.values().map(|group| joined(group, tasks.len())).collect();
    tell_apart(
        &mut all,
        &groups.into_values().map(|group| group[0].name.clone()).collect::<Vec<_>>(),
    );
    all
}

/// Mean and range where every run of the group was evaluated.
fn joined(group: &[&Curve], tasks: usize) -> Series {
    let task = if tasks > 1 { format!("{} ", group[0].task) } else { String::new() };
    let members = match group {
        [single] => format!("seed {}", single.seed),
        _ => format!("{} seeds", group.len()),
    };
    let label = format!("{task}{} ({members})", group[0].algorithm);
    let at = |curve: &Curve, env_steps: f64| {
        curve.points.iter().find(|point| point.0 == env_steps).map(|point| point.1)
    };
    let mut points = Vec::new();
    for &(env_steps, _) in &group[0].points {
        let returns: Option<Vec<f64>> = group.iter().map(|curve| at(curve, env_steps)).collect();
        points.extend(returns.map(|returns| point(env_steps, &returns)));
    }
    Series { label, runs: group.len(), points }
}

fn point(env_steps: f64, returns: &[f64]) -> Point {
    Point {
        env_steps,
        mean: returns.iter().sum::<f64>() / returns.len() as f64,
        low: returns.iter().copied().fold(f64::INFINITY, f64::min),
        high: returns.iter().copied().fold(f64::NEG_INFINITY, f64::max),
    }
}

/// Adds the run's name where two series would have the same label.
fn tell_apart(series: &mut [Series], names: &[String]) {
    let labels: Vec<String> = series.iter().map(|series| series.label.clone()).collect();
    for (index, series) in series.iter_mut().enumerate() {
        if labels.iter().filter(|label| **label == labels[index]).count() > 1 {
            series.label = format!("{} {}", labels[index], names[index]);
        }
    }
}

/// Reads all runs; refuses folders without any evaluation, since there is nothing to draw.
pub(crate) fn read_all(folders: &[PathBuf]) -> anyhow::Result<Vec<Curve>> {
    let mut curves = Vec::new();
    for folder in folders {
        let curve = read(folder)?;
        if curve.points.is_empty() {
            let why =
                format!("{} has no evaluation yet; see evaluation.every_steps", folder.display());
            return Err(Usage::new(why).into());
        }
        curves.push(curve);
    }
    Ok(curves)
}

#[cfg(test)]
mod tests;
