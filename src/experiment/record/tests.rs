//! A record holds a run with its settings and length, keeps it against others of its name, and a wrong line is refused.

use super::*;
use crate::experiment::file::ExperimentFile;
use crate::experiment::file::tests::SAMPLE;
use crate::experiment::plan;

fn planned() -> Vec<PlannedRun> {
    plan(&toml::from_str::<ExperimentFile>(SAMPLE).unwrap()).unwrap()
}

/// The curve and the folder of a finished run.
fn finish(run: &mut PlannedRun, folder: &Path) -> Curve {
    run.folder = folder.to_path_buf();
    let run_folder = RunFolder::claim_new(folder).unwrap();
    run_folder.begin("", &serde_json::json!({"git_commit": "abc"})).unwrap();
    let last = run.config.iterations();
    let line = format!("{{\"iteration\": {last}, \"weights_sha256\": \"34\"}}\n");
    std::fs::write(folder.join(PROVENANCE), format!("{{\"weights_sha256\": \"12\"}}\n{line}"))
        .unwrap();
    let every = run.config.learner.evaluation.every_steps;
    let steps = run.config.learner.environments.steps_per_iteration();
    let ends = (0..=run.config.iterations()).map(|number| number * steps);
    let evaluated = ends.filter(|end| *end == 0 || end / every > (end - steps) / every);
    let evaluated = evaluated.map(|end| end as f64);
    let values = [-1.5, 2.0].into_iter().chain(std::iter::repeat(3.25));
    let returns = evaluated.zip(values).collect();
    let surprise = vec![(1000.0, 4.0), (3000.0, 6.0), (7000.0, 8.0)];
    let points = [(Quantity::Return, returns), (Quantity::Surprise, surprise)];
    let (task, algorithm) = (run.task.clone(), run.variant.clone());
    let (seed, settings) = (run.seed.to_string(), BTreeMap::new());
    Curve { task, algorithm, seed, settings, points: points.into() }
}

#[test]
fn a_finished_run_stands_in_the_record_with_its_hash_and_comes_back_as_a_curve() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut runs) = (folder.path().join("record.csv"), planned());
    let curve = finish(&mut runs[0], folder.path());
    let mut record = Record::read(&path).unwrap();
    assert!(!record.holds(&runs[0]));
    record.add(&runs[0], &curve).unwrap();
    record.clone().add_to(&path).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[2], "halfcheetah-2x3,happo,0,4000,2,5,,,,");
    let config = settings_sha256(&runs[0].config);
    assert_eq!(lines[3], format!("halfcheetah-2x3,happo,0,8000,3.25,8,,{config},34,abc"));
    let again = Record::read(&path).unwrap();
    assert_eq!(again, record);
    assert!(again.holds(&runs[0]) && !again.holds(&runs[1]));
    let found = again.curve(&runs[0]).unwrap();
    assert_eq!(found.of(Quantity::Return), curve.of(Quantity::Return));
    assert_eq!(found.of(Quantity::Surprise), [(4000.0, 5.0), (8000.0, 8.0)]);
}

#[test]
fn experiments_that_add_to_one_record_at_the_same_time_lose_no_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("record.csv");
    let run = |seed: u64| {
        let evaluation =
            Evaluation { env_steps: 0, mean_return: 1.0, surprise: None, information: None };
        let run = FinishedRun { evaluations: vec![evaluation], ..FinishedRun::default() };
        Record([(("ant-4x2".into(), "happo".into(), seed), run)].into())
    };
    std::thread::scope(|scope| {
        for seed in 0..16 {
            let path = &path;
            scope.spawn(move || run(seed).add_to(path).unwrap());
        }
    });
    assert_eq!(Record::read(&path).unwrap().0.len(), 16);
}

#[test]
fn a_run_with_another_length_settings_or_evaluations_is_not_the_recorded_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut runs = planned();
    let mut curve = finish(&mut runs[0], folder.path());
    let mut record = Record::default();
    record.add(&runs[0], &curve).unwrap();
    assert!(record.holds(&runs[0]));
    for other in [
        "settings.update.clip = 0.3",
        "settings.evaluation.episodes = 3",
        "settings.evaluation.sampled = true",
    ] {
        let text = SAMPLE.replace("settings.evaluation", &format!("{other}\nsettings.evaluation"));
        let file: ExperimentFile = toml::from_str(&text).unwrap();
        assert!(!record.holds(&plan(&file).unwrap()[0]), "{other}");
    }
    let plain = SAMPLE.replace("settings.observation.mode = \"k_nearest\"", "");
    let text = format!("{plain}\n[environments]\nhalfcheetah-2x3 = \"http://127.0.0.1:7\"");
    let outside = plan(&toml::from_str::<ExperimentFile>(&text).unwrap()).unwrap();
    let at = |run: &&PlannedRun| {
        (&run.task, &run.variant, run.seed) == (&runs[0].task, &runs[0].variant, runs[0].seed)
    };
    let outside = outside.iter().find(at).unwrap();
    let why = record.conflict(outside).unwrap();
    assert!(!record.holds(outside) && why.contains("with other settings"), "{why}");
    curve.points.get_mut(&Quantity::Return).unwrap().pop();
    let mut record = Record::default();
    record.add(&runs[0], &curve).unwrap();
    assert!(!record.holds(&runs[0]) && record.curve(&runs[0]).is_none(), "a shorter one");
}

#[test]
fn a_run_without_one_of_its_evaluations_or_its_hashes_is_not_recorded_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = planned().remove(0);
    let curve = finish(&mut run, folder.path());
    demand_whole(&run, &curve).unwrap();
    for (left_out, words) in [
        (0, "metrics.jsonl has no evaluation at 0 steps"),
        (1, "metrics.jsonl has no evaluation at 4,000 steps"),
        (2, "metrics.jsonl has no evaluation at 8,000 steps"),
    ] {
        let mut curve = curve.clone();
        curve.points.get_mut(&Quantity::Return).unwrap().remove(left_out);
        let line = demand_whole(&run, &curve).unwrap_err().to_string();
        assert!(line.ends_with(words), "{line}");
    }
    let mut record = Record::default();
    record.add(&run, &curve).unwrap();
    let (path, text) = (folder.path().join("record.csv"), record.text());
    for (left_out, words) in [
        (1, "has no evaluation at 0 steps; delete its lines"),
        (2, "has no evaluation at 4,000 steps; delete its lines"),
        (3, "has no last line, which has the hashes of a run; delete its lines"),
    ] {
        let lines = text.lines().zip(0..).filter(|(_, number)| *number != left_out);
        let lines: String = lines.map(|(line, _)| format!("{line}\r\n")).collect();
        std::fs::write(&path, format!("\u{feff}{lines}\r\n")).unwrap();
        let record = Record::read(&path).unwrap();
        assert!(!record.holds(&run));
        let line = record.conflict(&run).unwrap();
        assert!(line.contains(words), "{line}");
    }
    std::fs::write(folder.path().join(PROVENANCE), "{\"weights_sha256\": \"12\"}\n").unwrap();
    let line = record.add(&run, &curve).unwrap_err().to_string();
    assert!(line.ends_with("provenance.jsonl lacks its last line"), "{line}");
}

#[test]
fn only_a_longer_run_of_the_same_settings_may_replace_a_recorded_one() {
    let folder = tempfile::tempdir().unwrap();
    let default = SAMPLE.replacen("settings.evaluation.every_steps = 4_000", "", 1);
    for text in [SAMPLE, default.as_str()] {
        let with = |env_steps: &str| {
            let text = text.replacen("8_000", env_steps, 1);
            plan(&toml::from_str::<ExperimentFile>(&text).unwrap()).unwrap().remove(0)
        };
        let mut run = with("8_000");
        let curve = finish(&mut run, &folder.path().join(text.len().to_string()));
        let mut record = Record::default();
        record.add(&run, &curve).unwrap();
        assert_eq!(record.conflict(&run), None);
        assert_eq!(record.conflict(&with("16_000")), None);
        for every in ["500", "2_000"] {
            let key = "settings.evaluation.every_steps = ";
            let changed = text.replacen(&format!("{key}4_000"), "", 1);
            let changed = changed.replacen("threads", &format!("{key}{every}\nthreads"), 1);
            let changed = plan(&toml::from_str::<ExperimentFile>(&changed).unwrap()).unwrap();
            let why = record.conflict(&changed[0]).unwrap();
            assert!(why.contains(" with other settings; set another"), "{why}");
        }
        let shorter = record.conflict(&with("4_000")).unwrap();
        assert!(shorter.contains(" with 8,000 steps, more than are planned; set "), "{shorter}");
        let other = text.replacen("threads", "settings.update.clip = 0.3\nthreads", 1);
        let others = plan(&toml::from_str::<ExperimentFile>(&other).unwrap()).unwrap();
        let line = record.demand_new(Path::new("a.csv"), &others).unwrap_err().to_string();
        let words = "a.csv: the record has halfcheetah-2x3-happo-seed0 with other settings; set another `record` and `folder`";
        assert_eq!(line, words);
    }
}

#[test]
fn a_line_that_is_no_evaluation_is_refused_with_its_number() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("record.csv");
    let good = "ant-4x2,happo,0,4000,2,5,,,,";
    for (text, words) in [
        ("x\n".to_owned(), "must begin with the line task,variant"),
        (format!("{HEADER}\n{good}\nant-4x2,happo\n"), "line 3"),
        (format!("{HEADER}\n{good}\n{good}\n"), "env_steps must grow"),
        (format!("{HEADER}\nant-4x2,happo,0,4000,NaN,5,,,,\n"), "`NaN` is not finite"),
        (format!("{HEADER}\nant-4x2,happo,x,4000,2,5,,,,\n"), "`x` is no number"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = format!("{:#}", Record::read(&path).unwrap_err());
        assert!(error.contains(words) && error.contains("record.csv"), "{error}");
    }
}
