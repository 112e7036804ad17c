//! Which crate uses which, read from the `Cargo.toml` files, and which may, from the table of ARCHITECTURE.md.

use std::collections::{BTreeMap, BTreeSet};

use toml::Table;

use crate::assert_none;
use crate::markdown::table_rows;
use crate::repository::{LIBRARIES, read, rust_files};
use crate::rust_text::code_lines;

/// Workspace crates that each library may use, from the table of ARCHITECTURE.md.
fn arrows() -> BTreeMap<String, Vec<String>> {
    let code = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect();
    let rows = table_rows(&read("ARCHITECTURE.md")).into_iter().filter(|cells| cells.len() == 4);
    let rows = rows.map(|cells| [0, 2].map(|column| -> Vec<String> { code(&cells[column]) }));
    let of_crates = rows.filter_map(|[name, uses]| Some((name.into_iter().next()?, uses)));
    of_crates.filter(|(name, _)| name != ROOT).collect()
}

/// The learner's folders. Each may use only those after it.
const LEARNER_LAYERS: [&str; 5] = ["serve", "train", "lease", "observe", "store"];

const ROOT: &str = "s2mia";

/// Outside crates that shape whatever uses them, and the only crates that may.
const HEAVY: [(&str, &[&str]); 34] = [
    ("anyhow", &[ROOT]),
    ("clap", &[ROOT]),
    ("gif", &[ROOT]),
    ("indicatif", &[ROOT]),
    ("kuva", &[ROOT]),
    ("mimalloc", &[ROOT]),
    ("tiny-skia", &[ROOT]),
    ("strsim", &[ROOT, "sim"]),
    ("toml", &[ROOT, "sim"]),
    ("tracing-subscriber", &[ROOT]),
    ("candle-core", &["policy", "marl"]),
    ("candle-nn", &["policy"]),
    ("gemm", &[]),
    ("pulp", &[]),
    ("pyo3", &["clients/python"]),
    ("rand_chacha", &["policy", "sim"]),
    ("rayon", &["marl", "learner"]),
    ("roxmltree", &["sim"]),
    ("rapier3d", &["sim"]),
    ("foxglove", &["recording"]),
    ("mcap", &["recording"]),
    ("prost", &["proto", "recording", ROOT]),
    ("rcgen", &["security"]),
    ("rustls", &["security"]),
    ("rustls-webpki", &["security"]),
    ("axum", &["learner"]),
    ("base64", &["learner"]),
    ("hyper", &["learner"]),
    ("hyper-util", &["learner"]),
    ("tokio", &[ROOT, "actor", "learner"]),
    ("tokio-rustls", &["actor", "learner"]),
    ("tokio-stream", &[ROOT, "actor", "learner"]),
    ("tonic", &["proto", "actor", "learner"]),
    ("tonic-prost-build", &["proto"]),
];

fn manifest(name: &str) -> Table {
    let path = if name == ROOT { "Cargo.toml".into() } else { format!("{name}/Cargo.toml") };
    read(&path).parse().unwrap_or_else(|error| panic!("{path}: {error}"))
}

fn section(manifest: &Table, name: &str) -> Table {
    manifest.get(name).and_then(|value| value.as_table()).cloned().unwrap_or_default()
}

/// Names in the given sections of a crate's manifest.
fn dependencies(name: &str, sections: &[&str]) -> BTreeSet<String> {
    let manifest = manifest(name);
    sections.iter().flat_map(|part| section(&manifest, part)).map(|(key, _)| key).collect()
}

const SHIPPED: [&str; 2] = ["dependencies", "build-dependencies"];
const ALL: [&str; 3] = ["dependencies", "build-dependencies", "dev-dependencies"];

#[test]
fn a_crate_uses_only_the_crates_that_its_arrows_allow() {
    let mut offenders = Vec::new();
    for (name, allowed) in arrows() {
        let used = dependencies(&name, &ALL);
        let wrong = used.iter().filter(|other| LIBRARIES.contains(&other.as_str()));
        let wrong = wrong.filter(|other| !allowed.contains(other));
        offenders.extend(wrong.map(|other| format!("{name}/Cargo.toml: {name} -> {other}")));
    }
    assert_none("an arrow that ARCHITECTURE.md does not draw:", &offenders);
}

#[test]
fn a_layer_of_the_learner_uses_only_the_layers_after_it() {
    let mut offenders = Vec::new();
    for file in rust_files() {
        let Some(path) = file.path.strip_prefix("learner/src/") else { continue };
        let folder = path.split(['/', '.']).next();
        let Some(own) = LEARNER_LAYERS.iter().position(|layer| Some(*layer) == folder) else {
            continue;
        };
        for (number, line) in code_lines(&file.body) {
            let before = |layer: &&&str| line.contains(&format!("crate::{layer}::"));
            let found = LEARNER_LAYERS[..own].iter().find(before);
            offenders.extend(found.map(|layer| format!("{}:{number}: uses {layer}", file.path)));
        }
    }
    assert_none("an arrow between layers that ARCHITECTURE.md does not draw:", &offenders);
}

#[test]
fn a_heavy_dependency_stays_in_its_room() {
    let mut offenders = Vec::new();
    for name in LIBRARIES.into_iter().chain([ROOT]) {
        let used = dependencies(name, &SHIPPED);
        let wrong =
            HEAVY.iter().filter(|(heavy, rooms)| used.contains(*heavy) && !rooms.contains(&name));
        offenders
            .extend(wrong.map(|(heavy, rooms)| format!("{name}: {heavy} (only {rooms:?} may)")));
    }
    assert_none("a dependency outside the crates that may name it:", &offenders);
}

#[test]
fn every_workspace_crate_has_its_arrows_written_down() {
    let root = manifest(ROOT);
    let members = root["workspace"]["members"].as_array().cloned().unwrap_or_default();
    let members: BTreeSet<String> =
        members.iter().filter_map(|member| member.as_str()).map(str::to_owned).collect();
    let known: BTreeSet<String> = arrows().into_keys().collect();
    assert_eq!(members, known, "workspace members and the table of ARCHITECTURE.md differ");
}

#[test]
fn versions_and_lints_come_from_the_workspace() {
    let mut offenders = Vec::new();
    for name in LIBRARIES.into_iter().chain([ROOT]) {
        let manifest = manifest(name);
        for (key, value) in ALL.iter().flat_map(|part| section(&manifest, part)) {
            if !inherited(&value) {
                offenders.push(format!("{name}: {key} must be `{key}.workspace = true`"));
            }
        }
        if !manifest.get("lints").is_some_and(inherited) {
            offenders.push(format!("{name}: `[lints] workspace = true` is missing"));
        }
    }
    assert_none("a version or a lint level is written twice:", &offenders);
}

fn inherited(value: &toml::Value) -> bool {
    value.get("workspace").and_then(|flag| flag.as_bool()) == Some(true)
}

#[test]
fn every_version_in_the_workspace_table_has_a_user() {
    let table = manifest(ROOT)["workspace"]["dependencies"].as_table().cloned().unwrap_or_default();
    let mut used = BTreeSet::new();
    for name in LIBRARIES.into_iter().chain([ROOT]) {
        used.extend(dependencies(name, &ALL));
    }
    let idle = table.keys().filter(|key| !used.contains(*key)).cloned().collect::<Vec<_>>();
    assert_none("in [workspace.dependencies], but no crate uses it:", &idle);
}
