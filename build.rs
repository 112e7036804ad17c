//! Passes the commit and the compiler's version to the program.

use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    // Commits, checkouts and resets all append to this file.
    let log = Command::new("git").args(["rev-parse", "--git-path", "logs/HEAD"]).output();
    if let Some(log) = log.ok().filter(|output| output.status.success()) {
        println!("cargo:rerun-if-changed={}", String::from_utf8_lossy(&log.stdout).trim());
    }
    println!("cargo:rerun-if-env-changed=GIT_COMMIT");
    // Names the commit where there is no repository, as in the build of an image.
    let given = || std::env::var("GIT_COMMIT").ok().filter(|commit| !commit.is_empty());
    let commit = printed(Command::new("git").args(["rev-parse", "HEAD"])).or_else(given);
    let rustc = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".to_owned());
    pass("S2MIA_GIT_COMMIT", commit);
    pass("S2MIA_RUSTC", printed(Command::new(rustc).arg("--version")));
}

/// Passes the first line of a text to the program; "unknown" without one.
fn pass(variable: &str, text: Option<String>) {
    let text = text.unwrap_or_default();
    let line = text.lines().next().unwrap_or("unknown");
    println!("cargo:rustc-env={variable}={line}");
}

/// What a command prints; `None` where it cannot run or fails.
fn printed(command: &mut Command) -> Option<String> {
    let output = command.output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}
