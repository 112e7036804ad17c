//! An experiment file is complete with few keys, and a wrong one is refused with the key.

use super::*;

/// A file with two variants, one with settings and tasks of its own.
pub(crate) const SAMPLE: &str = r#"
        folder = "runs/sample"
        env_steps = 8_000
        seeds = [0, 1]
        tasks = ["halfcheetah-2x3", "ant-4x2"]
        actors = 1
        threads = 2
        baseline = "happo"
        threshold = 0.8
        settings.evaluation.every_steps = 4_000

        [[variants]]
        name = "happo"
        algorithm = "happo"

        [[variants]]
        name = "near"
        algorithm = "happo-s2mia"
        tasks = ["halfcheetah-2x3"]
        seeds = [5]
        settings.observation.mode = "k_nearest"
    "#;

fn parse(text: &str) -> Result<ExperimentFile, String> {
    ExperimentFile::parse(Path::new("files/sample.toml"), text)
}

#[test]
fn tasks_variants_seeds_and_a_length_are_enough() {
    let file = |variants: &str| {
        let text = format!("env_steps = 1\nseeds = [0]\ntasks = [\"cue-2x1\"]\n{variants}");
        parse(&text).unwrap()
    };
    let (mappo, happo) =
        ("[[variants]]\nalgorithm = \"mappo\"\n", "[[variants]]\nalgorithm = \"happo\"\n");
    let least = file(&format!("{mappo}{happo}"));
    assert_eq!(least.folder, Path::new("files/runs/sample"));
    assert_eq!((least.actors, least.threads, least.threshold), (1, 1, 0.8));
    assert_eq!([&*least.variants[0].name, &*least.variants[1].name], ["mappo", "happo"]);
    assert_eq!(least.baseline, "happo");
    assert_eq!(file(mappo).baseline, "mappo");
    assert_eq!(file(&format!("{mappo}{happo}name = \"plain\"\n")).baseline, "plain");
    let none = "env_steps = 1\nseeds = [0]\ntasks = [\"cue-2x1\"]\nvariants = []\n";
    assert!(parse(none).unwrap_err().starts_with("variants must not be empty"));
}

#[test]
fn paths_are_relative_to_the_file_and_those_of_the_programs_own_files_to_its_root() {
    let text = SAMPLE.replacen("actors = 1", "record = \"r.csv\"", 1);
    let text = text.replacen("\"ant-4x2\"", "\"robots/a.toml:two\"", 1);
    let text = format!("{text}settings.policy.start = \"a:best\"\n");
    let lines = "settings.policy.start = \"ant-4x2\"\nenvironments.\"robots/a.toml:two\" = \"http://localhost:7\"\nthreshold";
    let text = text.replacen("threshold", lines, 1);
    let whole = |path: &str| std::path::absolute(path).unwrap().display().to_string();
    for (path, base) in [
        ("a.toml", ""),
        ("study/a.toml", "study/"),
        ("../a.toml", "../"),
        ("/study/a.toml", "/study/"),
        ("configs/experiments/a.toml", ""),
        (&whole("configs/experiments/a.toml"), ""),
        ("/other/configs/experiments/a.toml", "/other/"),
    ] {
        let file = ExperimentFile::parse(Path::new(path), &text).unwrap();
        assert_eq!(file.folder.display().to_string(), format!("{base}runs/sample"), "{path}");
        assert_eq!(file.record.display().to_string(), format!("{base}r.csv"), "{path}");
        assert_eq!(file.tasks, ["halfcheetah-2x3", &format!("{base}robots/a.toml:two")]);
        assert!(file.environments.contains_key(&file.tasks[1]), "{path}");
        let start = |settings: &Option<Table>| assignments(settings.as_ref().unwrap()).concat();
        assert!(start(&file.settings).contains("policy.start=ant-4x2"));
        let own = format!("policy.start={base}a:best");
        assert!(start(&file.variants[1].settings).contains(&own), "{path}");
    }
}

/// Fields that the table in `text` may have, from the parser's message about an unknown field.
fn fields(text: &str) -> Vec<String> {
    let message = parse(text).unwrap_err();
    let (_, expected) = message.split_once("expected one of ").unwrap();
    expected.split(", ").map(str::to_owned).collect()
}

#[test]
fn the_document_shows_a_whole_file_and_names_every_field() {
    let document = include_str!("../../../docs/USING.md");
    let (_, after) = document.split_once("\n## Experiments\n").unwrap();
    let (section, _) = after.split_once("\n## ").unwrap();
    let shown = section.split("```").nth(1).and_then(|block| block.strip_prefix("toml"));
    assert_eq!(parse(shown.unwrap()).unwrap().baseline, "happo");
    for field in [fields("x = 1"), fields("[[variants]]\nx = 1")].concat() {
        assert!(section.contains(&field), "{field}");
    }
    for key in DECIDED {
        assert!(section.contains(&format!("`{key}`")), "{key}");
    }
}

#[test]
fn settings_become_arguments_and_runs_share_the_cores_by_what_they_use_at_a_time() {
    let file = parse(SAMPLE).unwrap();
    assert_eq!(assignments(file.settings.as_ref().unwrap()), ["evaluation.every_steps=4000"]);
    let near = file.variants[1].settings.as_ref().unwrap();
    assert_eq!(assignments(near), ["observation.mode=k_nearest"]);
    assert_eq!([1, 2, 8].map(|cores| file.runs_at_once(cores)), [1, 1, 4]);
}

#[test]
fn a_wrong_file_is_refused_in_one_line_that_names_the_key() {
    for (from, to, words) in [
        ("threshold = 0.8", "threshold = 1.5", "threshold must be above 0 and at most 1, is 1.5"),
        ("baseline = \"happo\"", "baseline = \"mappo\"", "baseline = \"mappo\" must be the name"),
        ("seeds = [0, 1]", "seeds = []", "seeds must not be empty"),
        (
            "seeds = [0, 1]",
            "seeds = [-1]",
            "integer `-1`, expected a whole number that is not negative",
        ),
        ("seeds = [0, 1]", "seeds = [1, 1]", "seeds must differ"),
        ("name = \"near\"", "name = \"happo\"", "variants must differ"),
        ("name = \"near\"", "name = \"a/b\"", "name = \"a/b\" must be letters"),
        ("evaluation.every_steps", "run.seed", "`run.seed` is decided by the experiment"),
        ("actors = 1", "actors = 0", "actors and threads must lie in 1..=1024, are 0 and 2"),
        ("threads = 2", "treads = 2", "line 7: unknown field `treads`"),
        (
            "threshold",
            "environments.ant-8x1 = \"http://localhost:7\"\nthreshold",
            "environments: \"ant-8x1\" is not among the tasks",
        ),
    ] {
        let message = parse(&SAMPLE.replacen(from, to, 1)).unwrap_err();
        assert!(message.contains(words) && !message.contains('\n'), "{message}");
    }
}
