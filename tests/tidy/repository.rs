//! The repository as text: which files there are and what they contain.

use std::fs;
use std::path::Path;
use std::process::Command;

/// The workspace's crates below the root, each by its folder.
pub(crate) const LIBRARIES: [&str; 11] = [
    "actor",
    "clients/python",
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

/// Every text file of the project, by path: what git knows or does not ignore. Binary files are left out.
pub(crate) fn texts() -> Vec<Text> {
    // The clone may belong to another user than the one who tests it.
    let any_owner = ["-c", "safe.directory=*"];
    let listed = ["ls-files", "-z", "--cached", "--others", "--exclude-standard"];
    let output = Command::new("git").args(any_owner).args(listed).current_dir(root()).output();
    let output = output.expect("git lists the files of the project");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let paths = String::from_utf8(output.stdout).expect("all paths are text");
    let mut paths: Vec<&str> = paths.split_terminator('\0').collect();
    paths.sort_unstable();
    let text = |path: &str| {
        let body = fs::read_to_string(root().join(path)).ok()?;
        Some(Text { path: path.to_owned(), body })
    };
    paths.into_iter().filter_map(text).collect()
}

/// Every Rust file of the project, by path.
pub(crate) fn rust_files() -> Vec<Text> {
    texts().into_iter().filter(|text| text.path.ends_with(".rs")).collect()
}
