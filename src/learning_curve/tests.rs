//! Reading and joining of learning curves.

use super::*;

fn curve(algorithm: &str, seed: u64, points: &[(f64, f64)]) -> Curve {
    Curve {
        name: format!("run{seed}"),
        task: "halfcheetah-2x3".into(),
        algorithm: algorithm.into(),
        seed: seed.to_string(),
        settings: format!("algorithm = {algorithm}"),
        points: points.to_vec(),
    }
}

#[test]
fn evaluations_are_taken_from_the_lines_that_hold_one() {
    let folder = tempfile::tempdir().unwrap();
    let metrics = folder.path().join("metrics.jsonl");
    let lines = [
        r#"{"kind": "iteration", "env_steps": 4000, "losses/value": 1.5, "mean": 2.0}"#,
        r#"{"kind": "evaluation", "env_steps": 8000, "mean": 12.5, "episodes": 10}"#,
        r#"{"kind": "evaluation", "env_steps": 0, "mean": -3.0, "episodes": 10}"#,
        r#"{"kind": "evaluation", "env_steps": 12000, "me"#,
    ];
    std::fs::write(&metrics, lines.join("\n")).unwrap();
    assert_eq!(evaluations(&metrics).unwrap(), [(0.0, -3.0), (8000.0, 12.5)]);
}

#[test]
fn a_run_without_metrics_has_no_points() {
    assert_eq!(evaluations(Path::new("/no/such/metrics.jsonl")).unwrap(), []);
}

#[test]
fn runs_that_differ_in_the_seed_alone_become_a_mean_with_its_range() {
    let curves = [
        curve("happo", 1, &[(0.0, 1.0), (4000.0, 4.0)]),
        curve("happo", 2, &[(0.0, 3.0), (4000.0, 8.0), (8000.0, 9.0)]),
        curve("happo-s2mia", 1, &[(0.0, 5.0)]),
    ];
    let all = series(&curves);
    assert_eq!(all.len(), 2);
    assert_eq!((all[0].label.as_str(), all[0].runs), ("happo (2 seeds)", 2));
    let expected = [
        Point { env_steps: 0.0, mean: 2.0, low: 1.0, high: 3.0 },
        Point { env_steps: 4000.0, mean: 6.0, low: 4.0, high: 8.0 },
    ];
    assert_eq!(all[0].points, expected);
    assert_eq!(all[1].label, "happo-s2mia (seed 1)");
}

#[test]
fn runs_with_other_settings_are_never_averaged_and_are_told_apart_by_name() {
    let mut other = curve("happo", 2, &[(0.0, 3.0)]);
    other.settings = "update.clip = 0.3".into();
    other.seed = "1".into();
    let labels: Vec<String> =
        series(&[curve("happo", 1, &[(0.0, 1.0)]), other]).into_iter().map(|s| s.label).collect();
    assert_eq!(labels, ["happo (seed 1) run1", "happo (seed 1) run2"]);
}

#[test]
fn a_folder_that_is_no_run_is_a_wrong_argument() {
    let folder = tempfile::tempdir().unwrap();
    assert!(read(folder.path()).unwrap_err().is::<Usage>());
}
