//! A task that is not part of the program: its files are checked and trained, and the run needs them no more.

use std::path::Path;

use crate::runs::{Runs, inspect, outcome, refused, s2mia, succeeded, text, train, weights};

/// Writes the example into a new folder and returns the path of its task file.
fn example(runs: &Runs) -> std::path::PathBuf {
    let folder = runs.folder("robot");
    succeeded(&["task", "new", text(&folder)]);
    folder.join("hopper.toml")
}

#[test]
fn a_copy_of_a_shipped_task_trains_as_the_task_itself_under_its_own_name() {
    let runs = Runs::new();
    let folder = runs.folder("robot");
    let next = succeeded(&["task", "new", "--from", "walker2d-3x2", text(&folder)]);
    assert!(next.contains("walker2d.toml:3x2`, then `s2mia train "), "{next}");
    assert_eq!(next.matches("walker2d.toml:3x2").count(), 2, "{next}");
    succeeded(&["task", "new", "--force", "--from", "walker2d-2x3", text(&folder)]);
    let copy = folder.join("walker2d.toml");
    let file = std::fs::read_to_string(&copy).unwrap();
    assert!(
        file.contains("robot = \"my-walker2d\"") && file.contains("[settings.update]"),
        "{file}"
    );
    let task = format!("{}:2x3", copy.display());
    let [shown, own] = [task.as_str(), "walker2d-2x3"].map(|task| {
        let lines = succeeded(&["config", task, "update.gae_lambda"]);
        lines.lines().next().unwrap().to_owned()
    });
    assert_eq!(shown, "update.gae_lambda = 0.95");
    assert_eq!(shown, own);
    let [copied, shipped] =
        [("copy", task.as_str()), ("shipped", "walker2d-2x3")].map(|(name, task)| {
            let run = runs.folder(name);
            train(&run, &[&format!("task={task}"), "run.iterations=1"]);
            weights(&run)
        });
    assert_eq!(copied, shipped);
    let unknown = refused(&["task", "new", "--from", "walker2", text(&runs.folder("other"))]);
    assert!(
        unknown.trim_end().ends_with(
            "--from: no robot of the program is called `walker2`; did you mean `walker2d`?"
        ),
        "{unknown}"
    );
}

#[test]
fn a_weight_of_a_reward_term_is_a_setting_that_changes_the_run_and_its_hash() {
    let hash = |settings: &[&str]| {
        let lines = succeeded(&[&["config"], settings].concat());
        lines.lines().last().unwrap().to_owned()
    };
    assert_ne!(hash(&["ant-4x2"]), hash(&["ant-4x2", "reward.control=0.1"]));
    let runs = Runs::new();
    let [plain, weighed] =
        [("plain", "reward.control=0.1"), ("weighed", "reward.control=5")].map(|(name, weight)| {
            let run = runs.folder(name);
            train(&run, &[weight, "run.iterations=2"]);
            run
        });
    assert_ne!(weights(&plain), weights(&weighed));
    let shipped = runs.folder("shipped");
    train(&shipped, &["run.iterations=2"]);
    assert_eq!(weights(&plain), weights(&shipped), "0.1 is the weight in the file of halfcheetah");
    let resumed = refused(&["train", "--resume", text(&weighed), "reward.control=0.2"]);
    assert!(resumed.contains("reward.control"), "{resumed}");
    let added = refused(&["train", "--resume", text(&shipped), "reward.control=0.2"]);
    assert!(added.contains("reward.control"), "{added}");
    for (settings, why) in [
        (
            &["ant-4x2", "reward.contrl=1"][..],
            "reward.contrl: the task has no such term; did you mean `control`?",
        ),
        (&["cue-2x1", "reward.control=1"], "it needs a robot of the simulator"),
        (&["ant-4x2", "reward.control=much"], "`reward.control` must be a finite number"),
        (&["ant-4x2", "reward.Control=1"], "unknown key `reward.Control`"),
    ] {
        let line = refused(&[&["train"], settings].concat());
        assert!(line.contains(why), "{line}");
    }
    let explained = succeeded(&["config", "halfcheetah-2x3", "reward.control"]);
    let words = "reward.control = 0.1\n  set by   the task's file\n  default  0.1\n  meaning  weight of this term";
    assert!(explained.starts_with(words), "{explained}");
    let game = refused(&["config", "cue-2x1", "reward.control"]);
    assert!(
        game.contains("reward.control; no effect: it needs a robot of the simulator"),
        "{game}"
    );
}

/// The line with which `s2mia` refuses the arguments while `to` stands for `from` in a file.
fn refused_with(file: &Path, from: &str, to: &str, arguments: &[&str]) -> String {
    let valid = std::fs::read_to_string(file).unwrap();
    assert!(valid.contains(from), "{from}");
    std::fs::write(file, valid.replacen(from, to, 1)).unwrap();
    let line = refused(arguments);
    std::fs::write(file, valid).unwrap();
    line
}

/// A binary STL file of an octahedron with these half sizes, m.
fn octahedron([x, y, z]: [f32; 3]) -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend(8_u32.to_le_bytes());
    for corner in 0..8 {
        let sign = |bit: u8| if corner & bit == 0 { 1.0 } else { -1.0 };
        let mut points =
            [[sign(1) * x, 0.0, 0.0], [0.0, sign(2) * y, 0.0], [0.0, 0.0, sign(4) * z]];
        if sign(1) * sign(2) * sign(4) < 0.0 {
            points.swap(0, 1);
        }
        bytes.extend([0; 12]);
        bytes.extend(points.as_flattened().iter().flat_map(|number| number.to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

/// The example, with its defaults in an included file and a mesh as its torso.
fn example_of_files(runs: &Runs) -> std::path::PathBuf {
    let task = example(runs);
    let folder = task.parent().unwrap();
    let model = std::fs::read_to_string(folder.join("hopper.xml")).unwrap();
    let (start, rest) = model.split_once("  <default>").unwrap();
    let (defaults, end) = rest.split_once("</default>").unwrap();
    let asset = "<asset><mesh name=\"trunk\" file=\"trunk.stl\"/></asset>";
    let mesh = "<geom name=\"torso\" type=\"mesh\" mesh=\"trunk\"/>";
    let end = end.replace("<geom name=\"torso\" size=\"0.06 0.2\"/>", mesh);
    assert!(end.contains(mesh));
    let parts = folder.join("parts");
    std::fs::create_dir(&parts).unwrap();
    let defaults = format!("<mujoco><default>{defaults}</default></mujoco>");
    std::fs::write(parts.join("defaults.xml"), defaults).unwrap();
    std::fs::write(parts.join("trunk.stl"), octahedron([0.1, 0.1, 0.25])).unwrap();
    let model = format!("{start}  <include file=\"parts/defaults.xml\"/>\n{asset}\n{end}");
    let model = model.replace("<compiler ", "<compiler meshdir=\"parts\" ");
    std::fs::write(folder.join("hopper.xml"), model).unwrap();
    task
}

#[test]
fn the_commands_of_the_document_check_and_train_the_example() {
    let runs = Runs::new();
    let document = include_str!("../../docs/ADDING_A_TASK.md");
    let commands = document.split("```").nth(1).unwrap();
    let mut count = 0;
    for command in commands.lines().filter_map(|line| line.strip_prefix("s2mia ")) {
        let folder = runs.folder("my-robot");
        let command = command.replace("my-robot", text(&folder));
        let mut arguments: Vec<&str> = command.split_whitespace().collect();
        let dir = format!("run.dir={}", runs.folder("run").display());
        if arguments[0] == "train" {
            arguments.extend(["run.iterations=2", "run.actors=1", &dir]);
        }
        succeeded(&arguments);
        count += 1;
    }
    assert_eq!(count, 3);
    assert!(runs.folder("my-robot").join("hopper.png").is_file());
    assert_eq!(inspect(&runs.folder("run"))["iteration"], 2);
}

#[test]
fn a_check_warns_of_a_motor_that_cannot_be_explored() {
    let runs = Runs::new();
    let task = example(&runs);
    let check = || succeeded(&["task", "check", text(&task), "--episodes", "1"]);
    assert!(!check().contains("warning"));
    let model = task.with_file_name("hopper.xml");
    let changed = std::fs::read_to_string(&model).unwrap().replacen("gear=\"80\"", "gear=\"0\"", 1);
    std::fs::write(&model, changed).unwrap();
    let printed = check();
    let warnings: Vec<&str> =
        printed.lines().filter(|line| line.starts_with("warning: ")).collect();
    let why = "the motor of `hip` has gear 0, so its control moves nothing: set `gear`";
    assert_eq!(warnings, [format!("warning: {why}")], "{printed}");
}

#[test]
fn a_check_refuses_rewards_that_no_learner_accepts_with_the_largest_term() {
    let runs = Runs::new();
    let task = example(&runs);
    let valid = std::fs::read_to_string(&task).unwrap();
    std::fs::write(&task, valid.replacen("weight = 1e-3", "weight = 1e9", 1)).unwrap();
    let (status, printed) = outcome(s2mia(&["task", "check", text(&task)]));
    let why = "of which `control` gives -1.017822e9; lower the term's weight";
    assert!(status == Some(1) && printed.contains(why), "{printed}");
}

#[test]
fn a_run_of_an_own_task_of_several_files_continues_and_is_read_without_them() {
    let runs = Runs::new();
    let task = example_of_files(&runs);
    let (whole, resumed) = (runs.folder("whole"), runs.folder("resumed"));
    // The description of the run for actors has the model twice, which is more than other messages may have.
    let model = task.with_file_name("hopper.xml");
    let long = format!("model=\"{}\"", "x".repeat(5 << 19));
    let large = std::fs::read_to_string(&model).unwrap().replace("model=\"hopper\"", &long);
    std::fs::write(&model, large).unwrap();
    let printed = succeeded(&["task", "check", text(&task), "--episodes", "1"]);
    // Eight tetrahedra of 0.1 x 0.1 x 0.25 / 6 m^3 and 1000 kg/m^3.
    let torso = printed.lines().find(|line| line.starts_with("link  torso")).unwrap();
    assert!(torso.contains(" 3.3333 kg"), "{torso}");
    let named = format!("task={}", text(&task));
    train(&whole, &[&named, "run.iterations=2", "run.actors=1"]);
    train(&resumed, &[&named, "run.iterations=1", "run.actors=2"]);
    std::fs::remove_dir_all(task.parent().unwrap()).unwrap();
    succeeded(&["train", "--resume", text(&resumed), "run.iterations=2"]);
    assert_eq!(inspect(&whole), inspect(&resumed));
    let run = text(&resumed);
    succeeded(&["eval", run, "--episodes", "1"]);
    assert!(refused(&["eval", run, "--disturbed"]).contains("the task has no [disturbance]"));
    succeeded(&["film", run, "--frames", "1"]);
    succeeded(&["record", run]);
    succeeded(&["export", run, "--onnx", text(&runs.folder("onnx"))]);
    let config = std::fs::read_to_string(resumed.join("config.toml")).unwrap();
    assert!(config.contains("0 0 0.25") && !config.contains("trunk.stl"), "{config}");
}

/// A command and most kinds of disturbances, for the end of the example's task file.
const DISTURBED: &str = r#"
[command]
forward = [0.5, 1.5]

[disturbance]
friction = [0.5, 1.5]
motor_strength = [0.8, 1.2]
action_delay = [0, 2]
observation_delay = [0, 2]
sensor_noise = { positions = { normal = 0.01 } }

[[disturbance.push]]
link = "torso"
force = [100.0, 200.0]
duration_secs = 0.1
period_secs = 0.2
"#;

#[test]
fn a_disturbed_task_has_the_same_weights_with_any_actors_and_its_logs_replay() {
    let runs = Runs::new();
    let task = example(&runs);
    let plain = std::fs::read_to_string(&task).unwrap();
    std::fs::write(&task, plain + DISTURBED).unwrap();
    let printed = succeeded(&["task", "check", text(&task), "--episodes", "1"]);
    for line in ["command forward: 0.5 to 1.5 m/s", "push of torso: 100 to 200 N for 0.1 s"] {
        assert!(printed.contains(&format!("drawn {line}")), "{printed}");
    }
    let (whole, resumed) = (runs.folder("whole"), runs.folder("resumed"));
    let named = format!("task={}", text(&task));
    train(&whole, &[&named, "run.iterations=2", "run.actors=1", "log.episodes=all"]);
    train(&resumed, &[&named, "run.iterations=1", "run.actors=2"]);
    succeeded(&["train", "--resume", text(&resumed), "run.iterations=2"]);
    assert_eq!(weights(&whole), weights(&resumed));
    succeeded(&["log", "--replay", text(&whole)]);
    let results = |more: &[&str]| -> serde_json::Value {
        let arguments = [&["eval", text(&whole), "--episodes", "2", "--json"], more].concat();
        serde_json::from_str(&succeeded(&arguments)).unwrap()
    };
    let both = results(&["--disturbed"]);
    assert_eq!(results(&[])["episodes"], both["episodes"]);
    assert_ne!(both["episodes"], both["disturbed"]["episodes"]);
}

#[test]
fn a_file_of_a_model_that_cannot_be_used_is_refused_before_anything_is_written() {
    let runs = Runs::new();
    let task = example_of_files(&runs);
    let folder = runs.folder("run");
    let dir = format!("run.dir={}", folder.display());
    let with = |path: &Path, from: &str, to: &str, part: &str| {
        let error = refused_with(path, from, to, &["train", text(&task), &dir]);
        assert!(error.contains(part) && error.contains(text(&task)), "{error}");
        assert!(!folder.exists());
    };
    let model = task.with_file_name("hopper.xml");
    let mesh = "line 6, <mesh name=\"trunk\">:";
    let absent = "No such file or directory";
    for (file, part) in [
        ("lost.stl", format!("{mesh} parts/lost.stl: {absent}")),
        ("/trunk.stl", format!("{mesh} `/trunk.stl` is an absolute path")),
        ("../../trunk.stl", "leaves the model's folder".to_owned()),
    ] {
        with(&model, "trunk.stl", file, &part);
    }
    with(&model, "parts/def", "../def", "line 5, <include file=\"../defaults.xml\">: ");
    with(&task, "\"hopper.xml\"", "\"../robot/hopper.xml\"", "leaves the model's folder");
    let absolute = format!("\"{}\"", model.display());
    with(&task, "\"hopper.xml\"", &absolute, "is an absolute path");
    let long = format!("model=\"{}\"", "x".repeat(4 << 20));
    with(&model, "model=\"hopper\"", &long, "at most 4194304");
    let stl = task.with_file_name("parts").join("trunk.stl");
    std::fs::write(&stl, &octahedron([1.0; 3])[1..]).unwrap();
    let broken = format!("{mesh} parts/trunk.stl: it is not a binary STL file");
    with(&model, "trunk", "trunk", &broken);
}

#[cfg(unix)]
#[test]
fn a_model_is_read_from_regular_files_inside_its_folder() {
    let runs = Runs::new();
    let task = example_of_files(&runs);
    let folder = task.parent().unwrap();
    let parts = folder.join("parts");
    let (mesh, outside) = (parts.join("trunk.stl"), runs.folder("trunk.stl"));
    std::fs::rename(&mesh, &outside).unwrap();
    std::os::unix::fs::symlink(&outside, &mesh).unwrap();
    assert!(refused(&["task", "check", text(&task)]).contains("parts/trunk.stl: it is a link"));

    std::fs::remove_file(&mesh).unwrap();
    let pipe = std::process::Command::new("mkfifo").arg(&mesh).status();
    assert!(pipe.unwrap().success());
    assert!(refused(&["task", "check", text(&task)]).contains("not a plain file"));
    let model = runs.folder("robot.xml");
    std::fs::write(&model, "<mujoco/>").unwrap();
    let line = refused(&["task", "check", text(&model)]);
    assert!(line.contains("robot.xml: is a model (XML), not a task file"), "{line}");
    let mut beside = std::process::Command::new(env!("CARGO_BIN_EXE_s2mia"));
    beside.current_dir(model.parent().unwrap()).args(["task", "check", "robot.xml"]);
    let line = String::from_utf8(beside.output().unwrap().stderr).unwrap();
    assert!(line.contains("robot.xml: is a model (XML), not a task file"), "{line}");

    std::fs::remove_file(&mesh).unwrap();
    std::fs::rename(&outside, parts.join("b.stl")).unwrap();
    std::os::unix::fs::symlink("b.stl", &mesh).unwrap();
    succeeded(&["task", "check", text(&task)]);
}

#[test]
fn a_name_in_a_model_that_cannot_be_shown_is_refused() {
    let runs = Runs::new();
    let task = example(&runs);
    let model = task.with_file_name("hopper.xml");
    for (name, why) in [("a\u{202e}b", "U+202E"), ("a\u{2028}b", "U+2028")] {
        let body = format!("<body name=\"{name}\"");
        let check = ["task", "check", text(&task)];
        let line = refused_with(&model, "<body name=\"shank\"", &body, &check);
        assert!(line.contains(why) && !line.contains("a\u{202e}"), "{line}");
    }
}

#[test]
fn a_resume_with_another_file_is_refused_in_one_line() {
    let runs = Runs::new();
    let task = example(&runs);
    let folder = runs.folder("run");
    train(&folder, &[&format!("task={}", text(&task)), "run.iterations=1", "run.actors=1"]);
    let changed = std::fs::read_to_string(&task).unwrap().replace("weight = 1e-3", "weight = 1e-2");
    std::fs::write(&task, changed).unwrap();
    let error = refused(&["train", "--resume", text(&folder), &format!("task={}", text(&task))]);
    assert!(error.contains("`task_file.text` cannot change on resume"), "{error}");
}

#[test]
fn an_invalid_file_is_refused_with_its_path_before_anything_is_written() {
    let runs = Runs::new();
    let task = example(&runs);
    let folder = runs.folder("run");
    let dir = format!("run.dir={}", folder.display());
    for (from, to, part) in [
        ("hopper.xml", "lost.xml", "lost.xml"),
        ("frame_skip", "fram_skip", "did you mean `frame_skip`?"),
        ("robot = \"hopper\"", "robot = \"cue\"", "the task `cue-2x1` is part of the program"),
        ("[start]", "[settings.update]\nlerning_rate = 1\n[start]", "`update.learning_rate`?"),
        ("[start]", "[settings]\nalgorithm = \"happo\"\n[start]", "settings.algorithm"),
        (
            "2x1 = [[\"hip\"], [\"knee\"]]",
            "a = [[\"hip\", \"knee\"]]\nb = [[\"hip\"], [\"knee\"]]",
            "hopper.toml:b",
        ),
    ] {
        let error = refused_with(&task, from, to, &["train", text(&task), &dir]);
        assert!(error.contains(part) && error.contains(text(&task)), "{error}");
        assert!(!folder.exists());
    }
}

#[test]
fn a_partition_is_named_exactly() {
    let runs = Runs::new();
    let task = example(&runs);
    let agents = "2x1 = [[\"hip\"], [\"knee\"]]";
    let one = "a-b = [[\"hip\", \"knee\"]]";
    let valid = std::fs::read_to_string(&task).unwrap();
    let with = |partitions: &str| std::fs::write(&task, valid.replacen(agents, partitions, 1));
    let b = format!("{}:b", text(&task));
    with(&format!("{one}\nb = [[\"hip\"], [\"knee\"]]")).unwrap();
    let printed = succeeded(&["task", "check", &b, "--episodes", "1"]);
    assert!(printed.starts_with("hopper-b: 2 agents"), "{printed}");
    with(one).unwrap();
    let error = refused(&["task", "check", &b, "--episodes", "1"]);
    assert!(error.contains("hopper.toml:a-b"), "{error}");
}
