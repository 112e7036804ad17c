//! Layering, origins and refusals of `layers.rs`.

use sim::Robot;

use super::*;
use crate::config::known::OPTIONAL;
use crate::config::resolved::Entry;

fn request(settings: &[&str]) -> Request {
    Request { settings: settings.iter().map(|s| (*s).to_owned()).collect(), ..Request::default() }
}

fn refusal(settings: &[&str]) -> String {
    resolve(&request(settings)).unwrap_err().to_string()
}

fn file(folder: &tempfile::TempDir, text: &str) -> PathBuf {
    let path = folder.path().join("mine.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// Resolves one file of this text; an error has the file's name without its folder.
fn of_file(text: &str) -> Result<Resolved, String> {
    let folder = tempfile::tempdir().unwrap();
    let request = Request { files: vec![file(&folder, text)], ..Request::default() };
    let named = format!("{}/", folder.path().display());
    resolve(&request).map_err(|error| error.to_string().replace(&named, ""))
}

#[test]
fn every_layer_wins_over_the_one_before_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut request = request(&["walker2d-6x1", "algorithm=happo"]);
    let gamma = |request: &Request| resolve(request).unwrap().entries["update.gamma"].clone();
    assert_eq!(gamma(&request).origin, "configs/tasks/walker2d-6x1.toml");

    let path = file(&folder, "[update]\ngamma = 0.11\n");
    request.files = vec![path.clone()];
    assert_eq!(gamma(&request).origin, path.display().to_string());

    request.environment = vec![("S2MIA__UPDATE__GAMMA".into(), "0.12".into())];
    assert_eq!(gamma(&request).value, Value::Float(0.12));
    assert_eq!(gamma(&request).origin, "environment variable S2MIA__UPDATE__GAMMA");

    request.settings.push("update.gamma=0.13".into());
    let asked = Entry { value: Value::Float(0.13), origin: "command line".into() };
    assert_eq!(gamma(&request), asked);
}

#[test]
fn a_section_in_the_place_of_a_task_is_named_as_one() {
    let line = refusal(&["surprise"]);
    let expected =
        "command line: `surprise` is a section of settings, no task; name a key such as surprise.";
    assert!(line.starts_with(expected), "{line}");
}

#[test]
fn an_environment_from_outside_takes_the_settings_of_a_task_only_if_it_is_named() {
    let epochs = |settings: &[&str]| {
        let resolved = resolve(&request(settings)).unwrap();
        resolved.entries["update.epochs"].value.clone()
    };
    let (url, harl) = ("environment_service.url=http://localhost:7", "preset=harl");
    assert_eq!(epochs(&[harl]), Value::Integer(15));
    assert_eq!(epochs(&[url, harl]), Value::Integer(5));
    assert_eq!(epochs(&["halfcheetah-2x3", url, harl]), Value::Integer(15));
    let gamma = resolve(&request(&["walker2d-2x3", url])).unwrap();
    assert_eq!(gamma.origin("update.gamma"), "configs/tasks/walker2d-2x3.toml");
}

#[test]
fn a_device_without_an_end_is_refused_as_too_large() {
    let request = Request { files: vec!["/dev/zero".into()], ..Request::default() };
    let line = resolve(&request).unwrap_err().to_string();
    assert_eq!(line, "/dev/zero: it has more than 12582912 bytes");
}

#[test]
fn a_file_may_choose_the_task() {
    let resolved = of_file("task = \"walker2d-3x2\"\n").unwrap();
    assert_eq!(resolved.text("task"), "walker2d-3x2");
    assert_eq!(resolved.origin("update.gamma"), "configs/tasks/walker2d-3x2.toml");
}

#[test]
fn a_wrong_file_is_refused_in_one_line_with_its_place() {
    assert!(of_file("[update]\n").is_ok());
    for (text, place, words) in [
        ("[update]\nlerning_rate = 1e-3\n", "mine.toml: ", "did you mean `update.learning_rate`?"),
        ("[updates]\n", "mine.toml: ", "unknown key `updates`"),
        ("[update]\nclip = = 2\n", "mine.toml:2: ", ""),
        ("[run]\nseed = 1\nseed = 2\n", "mine.toml", "duplicate key"),
    ] {
        let error = of_file(text).unwrap_err();
        assert!(error.starts_with(place) && error.contains(words), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn a_wrong_argument_is_refused_with_what_is_expected() {
    for (settings, line) in [
        (&["zzzzzzzz=1"][..], "command line: unknown key `zzzzzzzz`"),
        (
            &["update.epochs=many"],
            "command line: `update.epochs` must be a whole number below 2^63, found `many`",
        ),
        (
            &["update=3"],
            "command line: `update` must be a table with keys such as `update.adam_epsilon`, found a value",
        ),
        (
            &["halfcheetah-6x2"],
            "command line: unknown task `halfcheetah-6x2`; did you mean `halfcheetah-3x2`?; \
             known: cue-2x1, signal-2x1, jump-4x1, halfcheetah-2x3, halfcheetah-3x2, halfcheetah-6x1, \
             walker2d-2x3, walker2d-3x2, walker2d-6x1, ant-2x4, ant-2x4d, ant-4x2, ant-8x1, \
             halfcheetah-pushed-2x3, walker2d-pushed-2x3, ant-pushed-4x2, humanoid-9x8, \
             humanoid-limbs, humanoid-17x1, quadruped-4x3, carry-light-2x2, carry-heavy-2x2",
        ),
        (&["docs"], "command line: `docs` is a folder; name a task file in it"),
        (
            &["preset=harrl"],
            "command line: unknown preset `harrl`; did you mean `harl`?; known: tuned, local, harl, paper",
        ),
        (
            &["halfcheetah-6x1", "verbose"],
            "`verbose` is no setting; write key.path=value, for example run.seed=7",
        ),
        (
            &["run.seed=7", "walker2d-2x3"],
            "`walker2d-2x3` is a task, and the task comes first, before all settings",
        ),
        (
            &["run.seed=7", "docs/gym-hopper.toml"],
            "`docs/gym-hopper.toml` is a task file, and the task comes first, before all settings; a resumed run keeps its task",
        ),
    ] {
        assert_eq!(refusal(settings), line);
    }
    assert!(refusal(&["algorithm=ppo"]).starts_with("command line: unknown algorithm `ppo`"));
    assert!(refusal(&["algorithm=happ"]).contains("did you mean `happo`?"));
}

#[test]
fn a_variable_that_is_not_text_is_refused_and_an_empty_section_changes_nothing() {
    use std::os::unix::ffi::OsStringExt as _;
    let value = std::ffi::OsString::from_vec(b"we\xffird".to_vec());
    let environment = vec![("S2MIA__RUN__DIR".to_owned(), value)];
    let refusal = resolve(&Request { environment, ..Request::default() }).unwrap_err().to_string();
    assert_eq!(refusal, "environment variable S2MIA__RUN__DIR: it is not UTF-8 text");
    for text in ["[reward]\n", "[run]\n"] {
        assert!(table_layer("file.toml", text).unwrap().values.is_empty(), "{text}");
    }
}

#[test]
fn a_variable_that_spells_a_setting_with_single_underscores_is_refused_and_another_programs_is_not()
{
    let read = |name: &str| {
        let environment = vec![(name.to_owned(), "3".into())];
        resolve(&Request { environment, ..Request::default() }).map_err(|error| error.to_string())
    };
    for (name, meant) in [
        ("S2MIA_RUN_SEED", "S2MIA__RUN__SEED"),
        ("S2MIA_RUN__SEED", "S2MIA__RUN__SEED"),
        ("S2MIA_TASK", "S2MIA__TASK"),
        ("S2MIA_ENV_STEPS", "S2MIA__RUN__ENV_STEPS"),
        ("S2MIA_REWARD_CONTROL", "S2MIA__REWARD__CONTROL"),
    ] {
        let line = format!("environment variable {name} is no setting; write {meant}");
        assert_eq!(read(name).unwrap_err(), line);
    }
    for name in ["S2MIA_IMAGE", "S2MIA_GIT_COMMIT", "S2MIA_RUSTC", "S2MIA_LEARNER_SERVICE_PORT"] {
        assert!(read(name).is_ok(), "{name}");
    }
}

#[test]
fn a_resolved_configuration_reads_back_as_itself() {
    let first = resolve(&request(&["halfcheetah-6x1", "run.seed=7", "update.clip=1"])).unwrap();
    for text in [first.to_toml(), first.to_toml_with_origins(|_| String::new())] {
        let again = of_file(&text).unwrap();
        let values = |r: &Resolved| r.entries.values().map(|e| e.value.clone()).collect::<Vec<_>>();
        assert_eq!(values(&again), values(&first));
        assert_eq!(again.sha256(), first.sha256());
    }
}

#[test]
fn a_resumed_run_keeps_its_own_values_where_the_presets_have_changed() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder, "algorithm = \"happo\"\n[update]\nclip = 0.33\n");
    let request = Request { resumed: Some(path), ..request(&["run.actors=3"]) };
    let resolved = resolve(&request).unwrap();
    assert_eq!(resolved.entries["update.clip"].value, Value::Float(0.33));
    assert_eq!(resolved.origin("update.epochs"), "configs/base.toml");
    assert_eq!(resolved.entries["run.actors"].value, Value::Integer(3));
}

#[test]
fn the_hash_of_given_settings_never_changes() {
    let entry = |value| Entry { value, origin: "test".into() };
    let entries = BTreeMap::from([
        ("task".to_owned(), entry(Value::String("a".into()))),
        ("update.clip".to_owned(), entry(Value::Float(0.5))),
        ("run.actors".to_owned(), entry(Value::Integer(3))),
    ]);
    // printf 'task = "a"\nupdate.clip = 0.5\n' | sha256sum
    assert_eq!(
        policy::arrays::hex(&Resolved { entries, given: BTreeMap::new() }.sha256()),
        "f12856c559702fd139a5677d0e48bc32781fd7b01c5b21bbf6a47f33d5594fc1"
    );
}

fn origin_of(settings: &[&str], key: &str) -> String {
    resolve(&request(settings)).unwrap().origin(key).to_owned()
}

fn shown(settings: &[&str], key: &str) -> String {
    resolve(&request(settings)).unwrap().shown(key)
}

#[test]
fn a_preset_stands_above_the_task_and_below_the_algorithm() {
    let harl = ["walker2d-2x3", "preset=harl"];
    assert_eq!(origin_of(&harl, "update.epochs"), "configs/presets/harl.toml");
    assert_eq!(shown(&harl, "update.epochs"), "5");
    assert_eq!(shown(&harl, "update.learning_rate"), "0.001");
    assert_eq!(shown(&["walker2d-6x1", "preset=harl"], "update.learning_rate"), "0.0005");
    assert_eq!(origin_of(&harl, "update.entropy"), "configs/algorithms/happo-s2mia.toml");
    let maddpg = ["walker2d-2x3", "preset=harl", "algorithm=maddpg"];
    assert_eq!(origin_of(&maddpg, "environments.count"), "configs/algorithms/maddpg.toml");
    let sizes = ["environments.count", "environments.per_slot", "environments.steps"];
    assert_eq!(sizes.map(|key| shown(&["algorithm=maddpg"], key)), ["10", "0", "50"]);
}

#[test]
fn what_a_preset_says_of_one_algorithm_on_one_task_stands_above_the_algorithm() {
    let happo = ["ant-4x2", "preset=harl", "algorithm=happo"];
    assert_eq!(shown(&happo, "update.entropy"), "0.0");
    assert_eq!(origin_of(&happo, "update.entropy"), "configs/presets/harl.toml");
    assert_eq!(shown(&["ant-2x4", "preset=harl", "algorithm=happo"], "update.entropy"), "0.01");
    assert_eq!(shown(&["ant-4x2", "preset=harl", "algorithm=happo-smh"], "update.entropy"), "0.01");
}

#[test]
fn the_default_preset_changes_nothing() {
    for task in presets::TASKS {
        let resolved = resolve(&request(&[task.name])).unwrap();
        let of_a_preset = |entry: &Entry| entry.origin.starts_with("configs/presets/");
        assert!(!resolved.entries.values().any(of_a_preset), "{}", task.name);
    }
}

#[test]
fn the_section_of_one_algorithm_is_in_the_settings_of_its_runs_only() {
    let own = |settings: &[&str]| {
        let keys = resolve(&request(settings)).unwrap().entries.into_keys();
        keys.filter(|key| !DEFAULTS.contains_key(key) && !OPTIONAL.contains_key(key))
            .collect::<Vec<_>>()
    };
    for algorithm in presets::ALGORITHMS {
        let rule = algorithm.name.split('-').next().unwrap();
        let section = format!("{rule}.");
        let keys = own(&[&format!("algorithm={}", algorithm.name)]);
        assert_eq!(keys.is_empty(), rule != "hasac", "{keys:?}");
        assert!(keys.iter().all(|key| key.starts_with(&section)), "{keys:?}");
    }
    assert_eq!(own(&["hasac.batch=100"]), own(&["algorithm=hasac"]));
    assert!(refusal(&["hasac.bach=100"]).ends_with("did you mean `hasac.batch`?"));
    assert!(
        refusal(&["hasac.batch=many"]).ends_with("must be a whole number below 2^63, found `many`")
    );
}

/// Whether base.toml's value of a setting was chosen here.
fn was_tuned(key: &str) -> bool {
    let chosen =
        ["environments.count", "environments.steps", "observation.norm", "policy.input_norm"];
    let of_the_algorithm = ["update.rule", "update.parameters"];
    let learning = key.starts_with("update.") || key.starts_with("critic.");
    chosen.contains(&key) || learning && !of_the_algorithm.contains(&key)
}

#[test]
fn a_published_preset_leaves_nothing_that_was_tuned_here() {
    for task in presets::TASKS.iter().filter(|task| Robot::of_task(task.name).is_ok()) {
        for preset in ["preset=harl", "preset=paper"] {
            let resolved = resolve(&request(&[task.name, preset])).unwrap();
            for (key, entry) in &resolved.entries {
                let of_base = entry.origin == "configs/base.toml" && was_tuned(key);
                let tuned = !key.starts_with("maddpg.");
                let of_task = entry.origin.starts_with("configs/tasks/") && tuned;
                assert!(!of_base && !of_task, "{} {preset}: {key}", task.name);
            }
        }
    }
}

#[test]
fn every_table_of_a_preset_is_for_a_known_task_and_algorithm() {
    let named = |known: &[Preset], name: &str| presets::find(known, name).is_some();
    for preset in presets::PRESETS {
        let table = parsed(preset.path, preset.text).unwrap();
        for (task, _) in table.get("task").and_then(|t| t.as_table()).into_iter().flatten() {
            assert!(named(presets::TASKS, task), "{task}");
        }
        let algorithms = table.get("algorithm").and_then(|t| t.as_table()).into_iter().flatten();
        for (algorithm, tasks) in algorithms {
            assert!(named(presets::ALGORITHMS, algorithm), "{algorithm}");
            for (task, _) in tasks.as_table().unwrap() {
                assert!(named(presets::TASKS, task), "{algorithm} {task}");
            }
        }
    }
}
