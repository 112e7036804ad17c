//! Tells the program which commit and compiler it was built from.

use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    // Commits, checkouts and resets all append to this file.
    let log = Command::new("git").args(["rev-parse", "--git-path", "logs/HEAD"]).output();
    if let Some(log) = log.ok().filter(|output| output.status.success()) {
        println!("cargo:rerun-if-changed={}", String::from_utf8_lossy(&log.stdout).trim());
    }
    let rustc = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".to_owned());
    tell("S2MIA_GIT_COMMIT", Command::new("git").args(["rev-parse", "HEAD"]));
    tell("S2MIA_RUSTC", Command::new(rustc).arg("--version"));
}

/// Passes the first line a command prints to the program; "unknown" where it cannot run or fails.
fn tell(variable: &str, command: &mut Command) {
    let output = command.output().ok().filter(|output| output.status.success());
    let text = output.map_or_else(String::new, |o| String::from_utf8_lossy(&o.stdout).into_owned());
    let line = text.lines().next().unwrap_or("unknown");
    println!("cargo:rustc-env={variable}={line}");
}
