//! The configuration files that are compiled into the program, so that it runs from any folder.

/// A file of `configs/`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Preset {
    /// Name of the task, the algorithm or the preset.
    pub(crate) name: &'static str,
    /// Path in the repository, for messages.
    pub(crate) path: &'static str,
    /// The TOML.
    pub(crate) text: &'static str,
}

macro_rules! presets {
    ($folder:literal: $($name:literal),+ $(,)?) => {
        &[$(Preset {
            name: $name,
            path: concat!("configs/", $folder, "/", $name, ".toml"),
            text: include_str!(concat!("../../configs/", $folder, "/", $name, ".toml")),
        }),+]
    };
}

/// Every default.
pub(crate) const BASE: Preset = Preset {
    name: "base",
    path: "configs/base.toml",
    text: include_str!("../../configs/base.toml"),
};

/// Settings per task.
pub(crate) const TASKS: &[Preset] = presets!(
    "tasks":
    "cue-2x1", "signal-2x1", "jump-4x1",
    "halfcheetah-2x3", "halfcheetah-3x2", "halfcheetah-6x1",
    "walker2d-2x3", "walker2d-3x2", "walker2d-6x1",
    "ant-2x4", "ant-2x4d", "ant-4x2", "ant-8x1",
    "halfcheetah-pushed-2x3", "walker2d-pushed-2x3", "ant-pushed-4x2",
    "humanoid-9x8", "humanoid-limbs", "humanoid-17x1", "quadruped-4x3",
    "carry-light-2x2", "carry-heavy-2x2",
);

/// Settings per algorithm, in the order of their ranks: each algorithm has the same style in every picture.
pub(crate) const ALGORITHMS: &[Preset] = presets!(
    "algorithms":
    "happo-s2mia",
    "happo",
    "mappo",
    "maddpg",
    "happo-sm",
    "happo-smh",
    "happo-mi",
    "happo-0",
    "happo-sm-encoder",
    "hasac",
    "happo-s2mia-exact",
    "happo-shared",
    "hasac-sm",
    "hasac-s2mia-exact",
    "happo-shared-annealed",
);

/// Hyper-parameters of other work and for other observations, which override the settings of a task.
pub(crate) const PRESETS: &[Preset] = presets!("presets": "tuned", "local", "harl", "paper");

/// The file with that name.
pub(crate) fn find(presets: &[Preset], name: &str) -> Option<Preset> {
    presets.iter().copied().find(|preset| preset.name == name)
}

/// The files of an algorithm, each of which is laid over those before it: `NAME`, then `NAME-VARIANT`.
pub(crate) fn of_algorithm(name: &str) -> impl Iterator<Item = Preset> {
    let hyphens = name.match_indices('-').map(|(hyphen, _)| hyphen);
    hyphens.chain([name.len()]).filter_map(|end| find(ALGORITHMS, &name[..end]))
}

/// The settings that a run has only if they are given, as TOML: in `configs/base.toml` their lines are comments.
pub(crate) fn optional() -> String {
    let is_name =
        |word: &str| word.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    let is_setting = |line: &&str| line.split_once(" = ").is_some_and(|(name, _)| is_name(name));
    let lines = BASE.text.lines().filter_map(|line| match line.strip_prefix("# ") {
        Some(line) => Some(line).filter(is_setting),
        None => Some(line).filter(|line| line.starts_with('[')),
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// The path of the file with the default of a setting, and the description there:
/// `configs/base.toml`, or the file of the only algorithm that has the setting. `None` if no file has it.
pub(crate) fn description(key: &str) -> Option<(&'static str, &'static str)> {
    let files = [&BASE].into_iter().chain(ALGORITHMS);
    files.into_iter().find_map(|file| Some((file.path, described(file.text, key)?)))
}

/// The description of a setting in the text of a file that has it; one without a default is a comment there.
fn described(text: &'static str, key: &str) -> Option<&'static str> {
    let (section, name) = key.rsplit_once('.').unwrap_or(("", key));
    let mut current = "";
    text.lines().find_map(|line| {
        if let Some(header) = line.strip_prefix('[') {
            current = header.trim_end_matches(']');
        }
        let line = line.strip_prefix("# ").unwrap_or(line);
        let (left, value) = line.split_once('=')?;
        let is_it = left.trim() == name && current == section;
        is_it.then(|| value.split_once('#').map_or("", |(_, description)| description.trim()))
    })
}

/// Whether this is the text of a file of the program, which the user named by its path.
pub(crate) fn is_text_of_one(text: &str) -> bool {
    let named = [TASKS, ALGORITHMS, PRESETS].into_iter().flatten();
    named.chain([&BASE]).any(|preset| preset.text == text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::path::Path;

    fn names_in(folder: &str) -> BTreeSet<String> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs").join(folder);
        let entries = std::fs::read_dir(folder).unwrap();
        entries.map(|e| e.unwrap().path().file_stem().unwrap().to_str().unwrap().into()).collect()
    }

    #[test]
    fn every_file_in_configs_is_in_the_program() {
        for (folder, presets) in
            [("tasks", TASKS), ("algorithms", ALGORITHMS), ("presets", PRESETS)]
        {
            let inside: BTreeSet<String> = presets.iter().map(|p| p.name.to_owned()).collect();
            assert_eq!(names_in(folder), inside, "{folder}");
        }
    }

    #[test]
    fn a_description_is_that_of_the_key_in_its_own_section() {
        let (base, hasac) = (BASE.path, "configs/algorithms/hasac.toml");
        for (key, file, starts) in [
            ("surprise.alpha", base, "weight of log p_theta(o)"),
            ("policy.layers", base, "mlp: "),
            ("policy.noise_hold", base, "shared: "),
            ("policy.start", base, "trained policies"),
            ("run.iterations", base, "number of iterations, which overrides env_steps"),
            ("hasac.batch", hasac, "transitions per update"),
        ] {
            let (path, found) = description(key).unwrap();
            assert!(path == file && found.starts_with(starts), "{key}: {path}: {found}");
        }
        assert_eq!(description("reward.control"), None);
    }

    #[test]
    fn every_setting_has_a_description() {
        let base: toml::Table = BASE.text.parse().unwrap();
        let optional: toml::Table = optional().parse().unwrap();
        let hasac: toml::Table = find(ALGORITHMS, "hasac").unwrap().text.parse().unwrap();
        let mut count = 0;
        for (section, value) in base.into_iter().chain(optional).chain(hasac) {
            let keys: Vec<String> = match value {
                toml::Value::Table(keys) => {
                    keys.keys().map(|key| format!("{section}.{key}")).collect()
                }
                _ => vec![section],
            };
            for key in keys {
                assert_ne!(description(&key).unwrap().1, "", "{key}");
                count += 1;
            }
        }
        assert!(count > 100, "{count}");
    }

    #[test]
    fn the_file_of_a_variant_is_laid_over_those_of_the_algorithms_that_its_name_begins_with() {
        let names = |name| of_algorithm(name).map(|preset| preset.name).collect::<Vec<_>>();
        assert_eq!(names("hasac-sm"), ["hasac", "hasac-sm"]);
        assert_eq!(names("happo-sm-encoder"), ["happo", "happo-sm", "happo-sm-encoder"]);
        assert_eq!(names("mappo"), ["mappo"]);
    }

    #[test]
    fn every_task_of_the_simulator_has_a_file() {
        let files: BTreeSet<&str> = TASKS.iter().map(|preset| preset.name).collect();
        let tasks: BTreeSet<&str> = sim::task_names().iter().copied().collect();
        assert_eq!(files, tasks);
    }
}
