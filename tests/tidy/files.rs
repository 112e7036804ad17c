//! Names, sizes and first lines of files.

use crate::assert_none;
use crate::repository::{read, rust_files, texts};

const MOST_LINES: usize = 400;
const EMPTY_NAMES: [&str; 7] = ["common", "helper", "helpers", "manager", "misc", "types", "utils"];

fn stem(path: &str) -> &str {
    let name = path.rsplit('/').next().unwrap_or(path);
    name.split('.').next().unwrap_or(name)
}

#[test]
fn every_rust_file_begins_by_saying_what_is_in_it() {
    let silent = rust_files().into_iter().filter(|file| !file.body.starts_with("//! "));
    let silent = silent.map(|file| file.path).collect::<Vec<_>>();
    assert_none("the first line must be a `//!` sentence:", &silent);
}

#[test]
fn every_python_file_begins_by_saying_what_is_in_it() {
    let python = texts().into_iter().filter(|file| file.path.ends_with(".py"));
    let silent = python.filter(|file| !file.body.starts_with("\"\"\""));
    let silent = silent.map(|file| file.path).collect::<Vec<_>>();
    assert_none("the first line must be a docstring:", &silent);
}

#[test]
fn no_source_file_is_longer_than_the_cap() {
    let sources =
        texts().into_iter().filter(|file| file.path.ends_with(".rs") || file.path.ends_with(".py"));
    let lengths = sources.map(|file| (file.body.lines().count(), file.path));
    let long = lengths.filter(|(lines, _)| *lines > MOST_LINES);
    let long = long.map(|(lines, path)| format!("{path}: {lines} lines")).collect::<Vec<_>>();
    assert_none(&format!("more than {MOST_LINES} lines; split by idea, not by length:"), &long);
}

#[test]
fn a_module_is_a_file_beside_its_folder() {
    let old = rust_files().into_iter().map(|file| file.path).filter(|path| stem(path) == "mod");
    assert_none("use name.rs beside name/ instead of mod.rs:", &old.collect::<Vec<_>>());
}

#[test]
fn no_file_has_a_name_that_says_nothing() {
    let paths = texts().into_iter().map(|file| file.path);
    let empty = paths.filter(|path| EMPTY_NAMES.contains(&stem(path))).collect::<Vec<_>>();
    assert_none("name the file for what is in it:", &empty);
}

#[test]
fn the_architecture_fits_on_two_hundred_lines() {
    let lines = read("ARCHITECTURE.md").lines().count();
    assert!(lines <= 200, "ARCHITECTURE.md has {lines} lines; 200 is what a newcomer reads");
}

#[test]
fn text_files_end_with_one_newline_and_carry_no_tabs() {
    let mut offenders = Vec::new();
    for file in texts().into_iter().filter(|file| file.path != "LICENSE" && !file.body.is_empty()) {
        if !file.body.ends_with('\n') || file.body.ends_with("\n\n") {
            offenders.push(format!("{}: end it with exactly one newline", file.path));
        }
        if file.body.contains(['\t', '\r']) {
            offenders.push(format!("{}: a tab or a carriage return", file.path));
        }
    }
    assert_none("untidy text:", &offenders);
}
