//! Reading and joining of learning curves.

use serde_json::json;

use super::*;
use crate::config::run_config::RunConfig;

fn curve(algorithm: &str, seed: u64, points: &[(f64, f64)]) -> Curve {
    Curve {
        task: "halfcheetah-2x3".into(),
        algorithm: algorithm.into(),
        seed: seed.to_string(),
        settings: BTreeMap::from([("update.clip".into(), "0.2".into())]),
        points: BTreeMap::from([(Quantity::Return, points.to_vec())]),
    }
}

fn returns(curves: &[Curve]) -> Vec<Panel> {
    panels(curves, &[Quantity::Return])
}

#[test]
fn evaluations_are_taken_from_the_lines_that_hold_one() {
    let folder = tempfile::tempdir().unwrap();
    let metrics = folder.path().join("metrics.jsonl");
    let lines = [
        r#"{"kind": "iteration", "env_steps": 4000, "losses/value": 1.5, "mean": 2.0}"#,
        r#"{"kind": "evaluation", "iteration": 1, "env_steps": 8000, "mean": 12.5, "episodes": 10}"#,
        r#"{"kind": "evaluation", "iteration": 1, "env_steps": 0, "mean": -3.0, "episodes": 10}"#,
        r#"{"kind": "evaluation", "iteration": 1, "env_steps": 12000, "me"#,
    ];
    std::fs::write(&metrics, lines.join("\n")).unwrap();
    assert_eq!(evaluations(&metrics).unwrap(), [(0.0, -3.0), (8000.0, 12.5)]);
    assert_eq!(evaluations(&folder.path().join("none.jsonl")).unwrap(), []);
    std::fs::write(&metrics, lines.map(|line| format!("{line}\n")).concat()).unwrap();
    let error = evaluations(&metrics).unwrap_err().to_string();
    assert!(error.ends_with("metrics.jsonl, line 4: is no JSON object"), "{error}");
}

#[test]
fn runs_that_differ_in_the_seed_alone_become_one_series_where_all_have_a_value() {
    let curves = [
        curve("happo", 1, &[(0.0, 1.0), (4000.0, 4.0)]),
        curve("happo", 2, &[(0.0, 3.0), (4000.0, 8.0), (8000.0, 9.0)]),
        curve("happo-s2mia", 1, &[(0.0, 5.0)]),
    ];
    let panels = returns(&curves);
    let [Panel { series, .. }] = panels.as_slice() else { panic!("{panels:?}") };
    let [other, series] = series.as_slice() else { panic!("{series:?}") };
    assert_eq!((series.label.as_str(), series.runs), ("happo (2 seeds)", 2));
    let centres: Vec<(f64, f64)> = series.points.iter().map(|p| (p.env_steps, p.centre)).collect();
    assert_eq!(centres, [(0.0, 2.0), (4000.0, 6.0)]);
    // Between 1 and 3; a resampling takes one of the two alone in half of the cases.
    assert_eq!(series.points[0].quartiles, Interval { low: 1.5, high: 2.5 });
    assert_eq!(series.points[0].confidence, Interval { low: 1.0, high: 3.0 });
    assert_eq!(other.label, "happo-s2mia (seed 1)");
}

#[test]
fn runs_with_other_settings_are_never_joined_and_are_told_apart_by_them() {
    let mut other = curve("happo", 1, &[(0.0, 3.0)]);
    other.settings.insert("update.clip".into(), "0.3".into());
    let panels = returns(&[curve("happo", 1, &[(0.0, 1.0)]), other]);
    let labels: Vec<&str> = panels[0].series.iter().map(|s| s.label.as_str()).collect();
    assert_eq!(labels, ["happo update.clip=0.2 (seed 1)", "happo update.clip=0.3 (seed 1)"]);
}

#[test]
fn names_have_eight_digits_of_a_digest_and_a_word_for_an_empty_value() {
    let digest = "0123456789abcdef".repeat(4);
    for (value, expected) in [
        (format!("\"{digest}\""), "01234567"),
        (format!("a text with the SHA-256 {digest}"), "a text with the SHA-256 01234567"),
        ("\"\"".to_owned(), "none"),
        (format!("{digest}g"), &format!("{digest}g")),
        ("0.25".to_owned(), "0.25"),
    ] {
        assert_eq!(brief(&value), expected);
    }
}

#[test]
fn returns_of_mean_actions_and_of_sampled_ones_are_not_joined() {
    let line = |env_steps: u64, mean: f64, sampled: bool| json!({"kind": "evaluation", "iteration": 0, "env_steps": env_steps, "mean": mean, "sampled": sampled});
    let lines = [line(0, 0.5, false), line(1000, 47.7, false), line(2000, 28.5, true)];
    assert_eq!(Quantity::Return.points(&lines), [(2000.0, 28.5)]);
    assert_eq!(Quantity::Return.points(&lines[..2]), [(0.0, 0.5), (1000.0, 47.7)]);
}

#[test]
fn a_mean_over_agents_with_a_figure_that_is_not_finite_is_left_out() {
    let line = |steps: u64, second: Option<f64>| {
        let (first, second) =
            ("agent0/surprise_entropy_bound", ("agent1/surprise_entropy_bound", second));
        json!({"env_steps": steps, first: 1.0, second.0: second.1})
    };
    let lines = [line(1000, Some(3.0)), line(2000, None)];
    assert_eq!(Quantity::Surprise.points(&lines), [(1000.0, 2.0)]);
}

#[test]
fn a_second_evaluation_of_one_iteration_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let config = RunConfig::with(&[]).unwrap().resolved.to_toml();
    let run = RunFolder::claim_new(&folder.path().join("run")).unwrap();
    run.begin(&config, &json!({})).unwrap();
    let line = r#"{"kind": "evaluation", "iteration": 0, "env_steps": 0, "mean": 1.0}"#;
    std::fs::write(run.file(METRICS), format!("{line}\n{line}\n")).unwrap();
    let error = read(run.path()).unwrap_err().to_string();
    assert!(error.ends_with("has a second evaluation line for iteration 0"), "{error}");
}

#[test]
fn runs_without_a_quantity_are_left_out_of_its_curve_and_named() {
    let with = |seed: u64, surprise: &[(f64, f64)]| {
        let mut curve = curve("happo", seed, &[(0.0, 1.0)]);
        curve.points.insert(Quantity::Surprise, surprise.to_vec());
        curve
    };
    let curves = [with(1, &[(1000.0, 4.0)]), with(2, &[(1000.0, 6.0)]), with(3, &[])];
    let panels = panels(&curves, &[Quantity::Surprise]);
    let centres: Vec<f64> = panels[0].series[0].points.iter().map(|p| p.centre).collect();
    assert_eq!(centres, [5.0]);
    assert_eq!(
        shortened(&curves),
        ["halfcheetah-2x3: the curve of happo is of 2 of its 3 runs for surprise, nats"]
    );
}

#[test]
fn a_curve_that_ends_with_the_shortest_of_its_runs_is_named() {
    let long = curve("happo", 1, &[(0.0, 1.0), (8000.0, 2.0)]);
    let short = curve("happo", 2, &[(0.0, 1.0), (4000.0, 2.0)]);
    let alone = curve("mappo", 1, &[(0.0, 1.0)]);
    let lines = shortened(&[long.clone(), short, alone.clone()]);
    let expected = "halfcheetah-2x3: the curve of happo ends at 4,000 env steps with the shortest of its 2 runs; the longest has \
                    8,000";
    assert_eq!(lines, [expected]);
    assert!(shortened(&[long, alone]).is_empty());
}

#[test]
fn runs_of_one_seed_are_refused_and_runs_that_are_evaluated_otherwise_are_not_joined() {
    let runs = tempfile::tempdir().unwrap();
    let run = |name: &str, settings: &[&str]| {
        let settings = [&["algorithm=happo"], settings].concat();
        let config = RunConfig::with(&settings).unwrap().resolved.to_toml();
        let run = RunFolder::claim_new(&runs.path().join(name)).unwrap();
        run.begin(&config, &json!({})).unwrap();
        let line = r#"{"kind": "evaluation", "iteration": 0, "env_steps": 0, "mean": 1.0}"#;
        std::fs::write(run.file(METRICS), format!("{line}\n")).unwrap();
        run.path().to_path_buf()
    };
    let (first, again) = (run("first", &["run.seed=1"]), run("again", &["run.seed=1"]));
    let other = run("other", &["run.seed=2"]);
    let sampled = run("sampled", &["run.seed=3", "evaluation.sampled=true"]);
    let refusal = read_all(&[first.clone(), other.clone(), again]).unwrap_err().to_string();
    assert!(refusal.contains("again have the same settings and seed"), "{refusal}");
    let panels = returns(&read_all(&[first, other, sampled]).unwrap());
    let labels: Vec<&str> = panels[0].series.iter().map(|s| s.label.as_str()).collect();
    let expected =
        ["happo evaluation.sampled=false (2 seeds)", "happo evaluation.sampled=true (seed 3)"];
    assert_eq!(labels, expected);
}

#[test]
fn a_variant_keeps_its_label_and_colour_in_every_panel() {
    let mut ant = curve("mappo", 1, &[(0.0, 1.0)]);
    ant.task = "ant-4x2".into();
    let curves = [
        curve("happo", 1, &[(0.0, 1.0)]),
        curve("mappo", 1, &[(0.0, 1.0)]),
        curve("mappo", 2, &[(0.0, 1.0)]),
        ant,
    ];
    let panels = returns(&curves);
    let tasks: Vec<&str> = panels.iter().map(|panel| panel.task.as_str()).collect();
    assert_eq!(tasks, ["halfcheetah-2x3", "ant-4x2"]);
    let (beside, alone) = (&panels[0].series[1], &panels[1].series[0]);
    assert_eq!((alone.label.as_str(), alone.rank), ("mappo (1 to 2 seeds)", 2));
    assert_eq!((beside.label.as_str(), beside.rank), ("mappo (1 to 2 seeds)", 2));
}

#[test]
fn a_shipped_algorithm_is_drawn_alike_in_every_picture_and_no_two_variants_of_one_are() {
    let ranks = |names: &[&str]| {
        let curves: Vec<Curve> = names.iter().map(|name| curve(name, 1, &[(0.0, 1.0)])).collect();
        let panels = returns(&curves);
        panels[0].series.iter().map(|series| series.rank).collect::<Vec<_>>()
    };
    assert_eq!(ranks(&["happo", "mappo"]), [1, 2]);
    assert_eq!(ranks(&["mappo"]), [2]);
    assert_eq!(ranks(&["happo", "mine", "yours"]), [0, 1, 2]);
    assert_eq!(ranks(&["mine", "yours"]), [0, 1]);
}

#[test]
fn a_folder_that_is_no_run_is_a_wrong_argument() {
    let folder = tempfile::tempdir().unwrap();
    assert!(read(folder.path()).unwrap_err().is::<Usage>());
}

#[test]
fn each_quantity_is_taken_from_the_lines_that_hold_it() {
    let lines = [
        json!({"kind": "iteration", "env_steps": 40, "mean": 9.0,
               "agent0/mi_estimate": 1.0, "agent1/mi_estimate": 2.0}),
        json!({"kind": "iteration", "env_steps": 80, "agent0/surprise_entropy_bound": 3.0}),
        json!({"kind": "evaluation", "iteration": 2, "env_steps": 80, "mean": 5.0}),
        json!({"kind": "evaluation", "iteration": 0, "env_steps": 0, "mean": -1.0}),
    ];
    assert_eq!(Quantity::Return.points(&lines), [(0.0, -1.0), (80.0, 5.0)]);
    assert_eq!(Quantity::Surprise.points(&lines), [(80.0, 3.0)]);
    assert_eq!(Quantity::Information.points(&lines), [(40.0, 1.5)]);
}

#[test]
fn many_points_become_means_of_neighbours() {
    let run = |seed: u64, length: u32| {
        let points = (0..length).map(|i| (f64::from(i), f64::from(2 * i))).collect();
        Curve { points: [(Quantity::Surprise, points)].into(), ..curve("happo", seed, &[]) }
    };
    // Runs of other lengths have the same points in common.
    let panels = panels(&[run(1, 200), run(2, 1000)], &[Quantity::Surprise]);
    let found: Vec<_> =
        panels[0].series[0].points.iter().map(|point| (point.env_steps, point.centre)).collect();
    assert_eq!((found.len(), found[0], found[99]), (100, (0.5, 1.0), (198.5, 397.0)));
}

#[test]
fn runs_with_other_intervals_between_evaluations_are_joined_by_straight_lines() {
    let often: Vec<_> = (0..=6).map(|i| (f64::from(i), f64::from(i * i))).collect();
    let curves =
        [curve("happo", 1, &often), curve("happo", 2, &[(0.0, 0.0), (4.0, 8.0), (8.0, 9.0)])];
    let found = returns(&curves)[0].series[0].points.clone();
    let found: Vec<_> = found.iter().map(|point| (point.env_steps, point.centre)).collect();
    let expected =
        [(0.0, 0.0), (1.0, 1.5), (2.0, 4.0), (3.0, 7.5), (4.0, 12.0), (5.0, 16.625), (6.0, 22.25)];
    assert_eq!(found, expected);
}
