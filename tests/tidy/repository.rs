//! The repository as text: which files there are and what stands in them. Folders that are not the
//! project's own (build output, runs) are never entered.

use std::fs;
use std::path::{Path, PathBuf};

/// The top-level folders that hold the project.
pub(crate) const ROOMS: [&str; 20] = [
    ".ci",
    ".github",
    "actor",
    "benches",
    "clients",
    "configs",
    "deploy",
    "docs",
    "fuzz",
    "kernels",
    "learner",
    "marl",
    "policy",
    "proto",
    "recording",
    "rollout",
    "security",
    "sim",
    "src",
    "tests",
];

/// The workspace's library crates, each a folder of the same name.
pub(crate) const LIBRARIES: [&str; 10] = [
    "actor",
    "kernels",
    "learner",
    "marl",
    "policy",
    "proto",
    "recording",
    "rollout",
    "security",
    "sim",
];

const NEVER_ENTERED: [&str; 6] =
    ["__pycache__", "artifacts", "corpus", "node_modules", "runs", "target"];

/// A file that can be read as text.
pub(crate) struct Text {
    /// Relative to the root, with `/`.
    pub(crate) path: String,
    /// Everything in it.
    pub(crate) body: String,
}

/// The folder of the root `Cargo.toml`.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// One file that must be there.
pub(crate) fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Every text file of the project, by path. Binary files are left out.
pub(crate) fn texts() -> Vec<Text> {
    let mut paths = files_in(root());
    for room in ROOMS {
        collect(&root().join(room), &mut paths);
    }
    paths.sort();
    paths.iter().filter_map(|path| text(path)).collect()
}

/// Every Rust file of the project, by path.
pub(crate) fn rust_files() -> Vec<Text> {
    texts().into_iter().filter(|text| text.path.ends_with(".rs")).collect()
}

fn text(path: &Path) -> Option<Text> {
    let relative = path.strip_prefix(root()).ok()?.to_str()?.replace('\\', "/");
    let body = fs::read_to_string(path).ok()?;
    Some(Text { path: relative, body })
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    entries(folder).into_iter().filter(|path| path.is_file()).collect()
}

fn collect(folder: &Path, paths: &mut Vec<PathBuf>) {
    paths.extend(files_in(folder));
    for inner in entries(folder).into_iter().filter(|path| path.is_dir()) {
        let name = inner.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if !NEVER_ENTERED.contains(&name) {
            collect(&inner, paths);
        }
    }
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let Ok(listing) = fs::read_dir(folder) else { return Vec::new() };
    listing.filter_map(Result::ok).map(|entry| entry.path()).collect()
}
