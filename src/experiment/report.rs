//! An experiment's table, as Markdown, and its figures.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use learner::store::durable;

use super::PlannedRun;
use super::comparison::{Comparison, Measure, comparisons};
use super::file::ExperimentFile;
use super::record::{Record, at_evaluations, demand_whole};
use super::results::{Estimate, Measured, ResultRow, rows};
use super::run_state::{RunFolderState, mismatch, run_state};
use crate::figures::learning_curve::{self, Curve, Quantity};
use crate::figures::{self, chart};
use crate::process::target;

/// The table, as Markdown.
const TABLE: &str = "results.md";

/// Whether a table or a figure has this name.
pub(crate) fn is_part(name: &str) -> bool {
    let mut figures = [figures::LEARNING_CURVE, figures::ABLATION].into_iter();
    let is_figure = |figure| figures::paths(Path::new(""), figure).contains(&PathBuf::from(name));
    name == TABLE || figures.any(is_figure)
}

/// What a report has written, and what it leaves out.
pub(crate) struct WrittenReport {
    /// The table, as Markdown.
    pub(crate) table: String,
    /// The files.
    pub(crate) written: Vec<PathBuf>,
    /// Why a run is left out, for each run whose folder is damaged.
    pub(crate) damaged: Vec<String>,
}

/// The curves of started runs.
#[derive(Default)]
struct Started {
    /// Labelled with their variants.
    curves: Vec<Curve>,
    /// Indices of the finished ones.
    finished: Vec<usize>,
    /// The finished ones that the record does not hold yet.
    new: Record,
    damaged: Vec<String>,
}

/// Writes `results.md` if a run is finished, and the figures of the runs that exist.
pub(crate) fn write(file: &ExperimentFile, runs: &[PlannedRun]) -> anyhow::Result<WrittenReport> {
    durable::make_folder(&file.folder)?;
    let Started { curves, finished, new, damaged } = started(file, runs)?;
    let measured: Vec<Measured> = finished.iter().map(|&index| measured(&curves[index])).collect();
    let variants: Vec<String> = file.variants.iter().map(|v| v.name.clone()).collect();
    let rows = rows(&measured, &variants, &file.baseline, file.threshold);
    let mut table = markdown(&rows, file, (measured.len(), runs.len()));
    for measure in [Measure::FinalReturn, Measure::MeanReturn] {
        let compared = comparisons(&measured, &variants, &file.baseline, measure);
        table += &over_all_tasks(&compared, &file.baseline, measure.name());
    }
    let mut written = Vec::new();
    let path = file.folder.join(TABLE);
    if !measured.is_empty() {
        target::file(&path, table.as_bytes())?;
        written.push(path);
    } else if path.exists() {
        tracing::warn!("{} is of an earlier report: now no run is finished", path.display());
    }
    new.add_to(&file.record)?;
    let shown = shown_curves(curves, &finished);
    learning_curve::shortened(&shown).iter().for_each(|line| tracing::warn!("{line}"));
    if !shown.is_empty() {
        written.extend(figures::write_learning_curve(&file.folder, &shown)?);
        written.extend(figures::write_ablation(&file.folder, &shown)?);
    }
    Ok(WrittenReport { table, written, damaged })
}

/// The curves for the figures: of each variant on each task its finished runs, or the others if none is finished. An
/// unfinished run would end the curve of all at its last evaluation.
fn shown_curves(curves: Vec<Curve>, finished: &[usize]) -> Vec<Curve> {
    let name = |curve: &Curve| (curve.task.clone(), curve.algorithm.clone());
    let whole: BTreeSet<_> = finished.iter().map(|&index| name(&curves[index])).collect();
    let all = curves.into_iter().enumerate();
    let shown =
        all.filter(|(index, curve)| finished.contains(index) || !whole.contains(&name(curve)));
    let shown = shown.map(|(_, curve)| curve);
    shown.filter(|curve| !curve.of(Quantity::Return).is_empty()).collect()
}

/// The curves of all started runs. Only finished runs are compared and added to the experiment's record.
fn started(file: &ExperimentFile, runs: &[PlannedRun]) -> anyhow::Result<Started> {
    let recorded = Record::read(&file.record)?;
    let kept = !file.record.as_os_str().is_empty();
    let mut started = Started::default();
    for run in runs {
        let conflict = recorded.conflict(run);
        if let Some(why) = &conflict {
            tracing::warn!("{}: {why}", file.record.display());
        }
        let may_add = kept && conflict.is_none();
        if contradicts(&recorded, run) {
            let (record, folder) = (file.record.display(), run.folder.display());
            started.damaged.push(format!(
                "{record}: it has other results of {} than {folder}: the report leaves this run out; restore the record, or delete \
                 the run's lines, which are then written again, or the folder",
                run.name()
            ));
            continue;
        }
        let (curve, done) = match recorded.curve(run) {
            Some(curve) => (curve, true),
            None if !is_there(run) => continue,
            None => match of_folder(run, may_add.then_some(&mut started.new)) {
                Ok((curve, done)) if kept => (at_evaluations(curve), done),
                Ok(own) => own,
                Err(why) => {
                    let advice = match run_state(run) {
                        RunFolderState::Finished => {
                            "restore the file, or delete the run's folder to repeat it"
                        }
                        _ => "`s2mia experiment` without --report continues it",
                    };
                    let why = actor::causes(why.as_ref());
                    started
                        .damaged
                        .push(format!("{why}: the report leaves this run out; {advice}"));
                    continue;
                }
            },
        };
        started.finished.extend(done.then_some(started.curves.len()));
        started.curves.push(curve);
    }
    Ok(started)
}

/// Whether the record has other results of a run than its folder, which has all of them.
fn contradicts(recorded: &Record, run: &PlannedRun) -> bool {
    let mut own = Record::default();
    let mut is_whole = || matches!(of_folder(run, Some(&mut own)), Ok((_, true)));
    recorded.holds(run) && is_there(run) && is_whole() && !own.agrees(recorded, run)
}

/// The curve of a run from its folder, and whether the run is finished, in which case it is added to `record`.
fn of_folder(run: &PlannedRun, record: Option<&mut Record>) -> anyhow::Result<(Curve, bool)> {
    let (task, algorithm) = (run.task.clone(), run.variant.clone());
    let settings = BTreeMap::new();
    let curve = Curve { task, algorithm, settings, ..learning_curve::read(&run.folder)? };
    let done = run_state(run) == RunFolderState::Finished;
    if done {
        demand_whole(run, &curve)?;
        record.map_or(Ok(()), |record| record.add(run, &curve))?;
    }
    Ok((curve, done))
}

fn is_there(run: &PlannedRun) -> bool {
    run_state(run) != RunFolderState::New && mismatch(run).is_none()
}

fn measured(curve: &Curve) -> Measured {
    let returns = curve.of(Quantity::Return).to_vec();
    Measured { task: curve.task.clone(), variant: curve.algorithm.clone(), returns }
}

fn markdown(
    rows: &[ResultRow],
    file: &ExperimentFile,
    (finished, planned): (usize, usize),
) -> String {
    let share = percent(file.threshold);
    let mut text = format!(
        "{finished} of {planned} runs are finished. Interquartile means over seeds with 95 % bootstrap \
         intervals; final is the mean over the last tenth of the run; learnt is {share} % of the way from the return at the \
         start to the task's best final return.\n\n\
         | task | variant | runs | final return | mean return over training | steps until learnt (median) \
         | P(better than {}) | p |\n| --- | --- | --- | --- | --- | --- | --- | --- |\n",
        file.baseline
    );
    for row in rows {
        let decimals = decimals_on(&row.task, rows);
        let improvement = row.improvement.map_or_else(
            || "- | -".to_owned(),
            |found| format!("{} | {}", shown(found.probability, 2), shown_p(found.p_value)),
        );
        text += &format!(
            "| {} | {} | {} | {} | {} | {} ({}/{}) | {improvement} |\n",
            row.task,
            row.variant,
            row.runs,
            shown(row.final_return, decimals),
            shown(row.area, decimals),
            row.steps_to_threshold.map_or_else(|| "-".to_owned(), |s| chart::thousands(s as u64)),
            row.runs_at_threshold,
            row.runs,
        );
    }
    text + &lengths(rows)
}

/// Per cent, with as many decimals as it has, at most six.
fn percent(share: f64) -> f64 {
    (100.0 * share * 1e6).round() / 1e6
}

/// Decimals with which the largest return of a task has three digits; none for returns from 100 up.
fn decimals_on(task: &str, rows: &[ResultRow]) -> usize {
    let of_task = rows.iter().filter(|row| row.task == task);
    let values = of_task.flat_map(|row| [row.final_return, row.area]);
    let ends = values.flat_map(|found| [found.value, found.interval.low, found.interval.high]);
    let largest = ends.map(f64::abs).filter(|end| end.is_finite()).fold(0.0, f64::max);
    let scaled = std::iter::successors(Some(largest), |size| Some(10.0 * size));
    if largest == 0.0 { 0 } else { scaled.take(9).take_while(|size| *size < 100.0).count() }
}

/// A line for each task whose variants have runs of different lengths; empty if there is none.
fn lengths(rows: &[ResultRow]) -> String {
    let mut tasks = BTreeMap::<&str, Vec<&ResultRow>>::new();
    for row in rows {
        tasks.entry(&row.task).or_default().push(row);
    }
    let differ = |rows: &[&ResultRow]| rows.iter().any(|row| row.env_steps != rows[0].env_steps);
    let different = tasks.into_iter().filter(|(_, rows)| differ(rows));
    let line = |(task, rows): (&str, Vec<&ResultRow>)| {
        let length = |row: &&ResultRow| {
            format!("{} {} steps", row.variant, chart::thousands(row.env_steps as u64))
        };
        let all = rows.iter().map(length).collect::<Vec<_>>().join(", ");
        format!("\nRuns of different lengths are compared on {task}: {all}.\n")
    };
    different.map(line).collect()
}

/// Every variant against the baseline by one measure, over all tasks that both have; empty if there is none.
fn over_all_tasks(comparisons: &[Comparison], baseline: &str, measure: &str) -> String {
    if comparisons.is_empty() {
        return String::new();
    }
    let line = |comparison: &Comparison| {
        format!(
            "| {} | {} | {} | {} | {} | {} | {} |\n",
            comparison.variant,
            comparison.tasks,
            comparison.runs,
            shown(comparison.score, 3),
            shown(comparison.improvement.probability, 2),
            shown_p(comparison.improvement.p_value),
            shown_p(comparison.adjusted_p_value),
        )
    };
    let missing = comparisons.iter().any(|comparison| shown(comparison.score, 3) == "-");
    let why = if missing {
        format!(
            "\nNo score (-): on some task {baseline}'s {measure} is not above 0, in the runs or in some resamples.\n"
        )
    } else {
        String::new()
    };
    format!(
        "\nOver all tasks, by {measure}: scores are in units of {baseline}'s {measure} on the task; \
         intervals by bootstrap within each task; p by permutation within each task, adjusted by Holm.\n\n\
         | variant | tasks | runs | score | P(better than {baseline}) | p | p, adjusted |\n\
         | --- | --- | --- | --- | --- | --- | --- |\n{}{why}",
        comparisons.iter().map(line).collect::<String>()
    )
}

/// `86 (20 to 100)`, without an interval if that is the value itself, as of a single run; `-` for a missing value and for one
/// that some resamples lack: a score whose unit may be 0.
fn shown(estimate: Estimate, decimals: usize) -> String {
    let Estimate { value, interval } = estimate;
    if value.is_nan() || interval.high.is_nan() {
        return "-".to_owned();
    }
    let [value, low, high] =
        [value, interval.low, interval.high].map(|number| rounded(number, decimals));
    if interval.low == interval.high { value } else { format!("{value} ({low} to {high})") }
}

/// A number with decimals; one that is rounded to 0 has no sign.
fn rounded(number: f64, decimals: usize) -> String {
    let text = format!("{number:.decimals$}");
    let is_zero = text.bytes().all(|byte| b"-0.".contains(&byte));
    if is_zero { text.trim_start_matches('-').to_owned() } else { text }
}

/// With three decimals. The least p-value of a permutation test is not 0.
fn shown_p(p_value: f64) -> String {
    if p_value < 0.0005 { "<0.001".to_owned() } else { format!("{p_value:.3}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::file::tests::SAMPLE;
    use crate::experiment::results::Improvement;
    use crate::figures::statistics::Interval;

    fn sample() -> ResultRow {
        let estimate = |value: f64| Estimate {
            value,
            interval: Interval { low: value - 1.0, high: value + 1.0 },
        };
        ResultRow {
            task: "ant-4x2".into(),
            variant: "near".into(),
            runs: 3,
            env_steps: 500_000.0,
            final_return: estimate(860.0),
            area: estimate(51.0),
            steps_to_threshold: Some(150_000.0),
            runs_at_threshold: 2,
            improvement: None,
        }
    }

    #[test]
    fn a_figure_that_some_resamples_lack_is_not_shown() {
        let interval = Interval { low: 2.0, high: f64::NAN };
        assert_eq!(shown(Estimate { value: 3.0, interval }, 2), "-");
    }

    #[test]
    fn a_single_run_has_no_interval_and_no_p_value_is_0() {
        let interval = Interval { low: 3.0, high: 3.0 };
        assert_eq!(shown(Estimate { value: 3.0, interval }, 1), "3.0");
        assert_eq!([0.0001, 0.0005, 0.25].map(shown_p), ["<0.001", "0.001", "0.250"]);
    }

    #[test]
    fn figures_show_unfinished_runs_only_of_variants_without_a_finished_one() {
        let curve = |algorithm: &str, seed: &str| Curve {
            task: "ant-4x2".into(),
            algorithm: algorithm.into(),
            seed: seed.into(),
            settings: BTreeMap::new(),
            points: BTreeMap::from([(Quantity::Return, vec![(0.0, 1.0)])]),
        };
        let all = vec![curve("near", "0"), curve("near", "1"), curve("far", "0")];
        let shown = shown_curves(all, &[0]);
        let shown: Vec<_> = shown.iter().map(|c| (c.algorithm.as_str(), c.seed.as_str())).collect();
        assert_eq!(shown, [("near", "0"), ("far", "0")]);
    }

    #[test]
    fn a_table_without_a_score_says_why() {
        let text = |score: f64| {
            let estimate =
                |value| Estimate { value, interval: Interval { low: value, high: value } };
            let comparison = Comparison {
                variant: "near".into(),
                tasks: 1,
                runs: 3,
                score: estimate(score),
                improvement: Improvement { probability: estimate(0.5), p_value: 1.0 },
                adjusted_p_value: 1.0,
            };
            over_all_tasks(&[comparison], "far", "final return")
        };
        let why = "No score (-): on some task far's final return is not above 0";
        assert!(text(f64::NAN).contains(why) && !text(1.0).contains(why));
    }

    #[test]
    fn the_table_has_each_figure_in_its_column() {
        let file: ExperimentFile = toml::from_str(SAMPLE).unwrap();
        let text = markdown(&[sample()], &file, (3, 5));
        assert!(text.starts_with("3 of 5 runs are finished."), "{text}");
        let row =
            "| ant-4x2 | near | 3 | 860 (859 to 861) | 51 (50 to 52) | 150,000 (2/3) | - | - |\n";
        assert!(text.ends_with(row), "{text}");
    }

    #[test]
    fn runs_of_different_lengths_are_named_below_the_table() {
        let longer = ResultRow { variant: "far".into(), env_steps: 1e6, ..sample() };
        assert_eq!(lengths(&[sample(), sample()]), "");
        let line = "\nRuns of different lengths are compared on ant-4x2: near 500,000 steps, far 1,000,000 steps.\n";
        assert_eq!(lengths(&[sample(), longer]), line);
    }

    #[test]
    fn small_returns_have_three_digits_and_no_sign_of_zero() {
        let of = |value: f64| Estimate { value, interval: Interval { low: -value, high: value } };
        let row = |value| ResultRow { final_return: of(value), area: of(0.0), ..sample() };
        for (largest, decimals) in [(8617.0, 0), (38.0, 1), (1.5, 2), (0.0012, 5), (0.0, 0)] {
            assert_eq!(decimals_on("ant-4x2", &[row(largest), row(0.0)]), decimals, "{largest}");
        }
        assert_eq!(shown(of(0.0034), 5), "0.00340 (-0.00340 to 0.00340)");
        assert_eq!(shown(of(-0.004), 2), "0.00 (0.00 to 0.00)");
        assert_eq!([0.8, 0.999, 0.004, 0.55].map(percent), [80.0, 99.9, 0.4, 55.0]);
    }
}
