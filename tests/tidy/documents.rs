//! The documents speak of files, commands and settings that exist.

use std::collections::BTreeSet;
use std::process::Command;

use crate::assert_none;
use crate::markdown::{fenced_lines, inline_code, local_links};
use crate::repository::{Text, read, root, rust_files, texts};

fn documents() -> Vec<Text> {
    texts().into_iter().filter(|file| file.path.ends_with(".md")).collect()
}

/// `a/{b,c}.rs` stands for two paths.
fn expand(path: &str) -> Vec<String> {
    let Some((head, rest)) = path.split_once('{') else { return vec![path.to_owned()] };
    let Some((names, tail)) = rest.split_once('}') else { return vec![path.to_owned()] };
    names.split(',').map(|name| format!("{head}{}{tail}", name.trim())).collect()
}

/// Whether it begins with one of the project's top-level `folders` or is a Rust file.
fn names_a_path(code: &str, folders: &BTreeSet<&str>) -> bool {
    let plain = |letter: char| letter.is_alphanumeric() || "._-/{},".contains(letter);
    let inside = code.split_once('/').is_some_and(|(first, _)| folders.contains(first));
    code.chars().all(plain) && (inside || code.ends_with(".rs"))
}

/// A path from the root, or the end of a Rust file's path.
fn exists(path: &str, rust: &[Text]) -> bool {
    let ending = format!("/{path}");
    root().join(path).exists() || rust.iter().any(|file| file.path.ends_with(&ending))
}

#[test]
fn paths_in_the_documents_exist() {
    let (all, rust) = (texts(), rust_files());
    let folders = all.iter().filter_map(|file| Some(file.path.split_once('/')?.0)).collect();
    let mut missing = Vec::new();
    for document in documents() {
        let code = inline_code(&document.body);
        for (number, path) in code.iter().filter(|(_, code)| names_a_path(code, &folders)) {
            let absent = expand(path).into_iter().filter(|path| !exists(path, &rust));
            missing.extend(absent.map(|path| format!("{}:{number}: {path}", document.path)));
        }
    }
    assert_none("a document names a path that does not exist:", &missing);
}

#[test]
fn links_in_the_documents_lead_somewhere() {
    let mut broken = Vec::new();
    for document in documents() {
        let folder = root().join(&document.path);
        let folder = folder.parent().unwrap_or(root());
        let dead = local_links(&document.body).into_iter();
        let dead = dead.filter(|(_, target)| !folder.join(target).exists());
        broken.extend(dead.map(|(number, target)| format!("{}:{number}: {target}", document.path)));
    }
    assert_none("a link leads nowhere:", &broken);
}

/// What the binary prints, and whether it ended well.
fn s2mia(arguments: &[&str]) -> (bool, String) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_s2mia")).args(arguments).current_dir(root()).output();
    let output = output.expect("cargo builds the binary before this test");
    let text = [output.stdout, output.stderr].concat();
    (output.status.success(), String::from_utf8_lossy(&text).into_owned())
}

/// The subcommands that `s2mia --help` lists.
fn subcommands() -> BTreeSet<String> {
    let (_, help) = s2mia(&["--help"]);
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let listed = listed.take_while(|line| line.starts_with("  "));
    let names = listed
        .filter(|line| !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

/// The arguments after `s2mia` or `cargo run --release --`, where a line is such a command.
fn command_line(line: &str) -> Option<Vec<String>> {
    let line = line.split(" #").next().unwrap_or(line).trim();
    let rest =
        line.strip_prefix("cargo run --release -- ").or_else(|| line.strip_prefix("s2mia "))?;
    Some(rest.split_whitespace().map(str::to_owned).collect())
}

fn commands_in(body: &str) -> Vec<Vec<String>> {
    let inline = inline_code(body).into_iter().map(|(_, code)| code);
    inline.chain(fenced_lines(body)).filter_map(|line| command_line(&line)).collect()
}

#[test]
fn commands_in_the_documents_are_commands_of_the_binary() {
    let known = subcommands();
    let mut unknown = Vec::new();
    for document in documents() {
        let first =
            commands_in(&document.body).into_iter().filter_map(|words| words.into_iter().next());
        let wrong =
            first.filter(|word| word.starts_with(char::is_lowercase) && !known.contains(word));
        unknown.extend(wrong.map(|word| format!("{}: s2mia {word}", document.path)));
    }
    assert_none(&format!("no such command; there are {known:?}:"), &unknown);
}

#[test]
fn the_readme_shows_every_command() {
    let shown = commands_in(&read("README.md"));
    let shown: BTreeSet<&str> =
        shown.iter().filter_map(|words| words.first()).map(String::as_str).collect();
    let known = subcommands();
    assert!(!known.is_empty(), "s2mia --help lists no commands");
    let hidden =
        known.into_iter().filter(|name| !shown.contains(name.as_str())).collect::<Vec<_>>();
    assert_none("`s2mia NAME ...` is missing from README.md:", &hidden);
}

/// `[KEY=VALUE ...]` stands for settings and is none.
fn is_setting(word: &str) -> bool {
    word.contains('=') && !word.starts_with('[')
}

#[test]
fn settings_in_the_readme_are_accepted() {
    let mut refused = Vec::new();
    for words in commands_in(&read("README.md")).iter().filter(|words| words[0] == "train") {
        let settings = words[1..].iter().map(String::as_str).filter(|word| is_setting(word));
        let arguments = ["config"].into_iter().chain(settings).collect::<Vec<_>>();
        let (accepted, text) = s2mia(&arguments);
        if !accepted {
            refused.push(format!("s2mia {}: {}", arguments.join(" "), text.trim()));
        }
    }
    assert_none("README.md shows a setting that is refused:", &refused);
}

#[test]
fn the_example_of_a_task_stands_word_for_word_in_the_simulator() {
    let files = [
        "sim/assets/hopper.xml",
        "sim/assets/hopper.toml",
        "sim/assets/walker2d-pushed.toml",
        "sim/assets/carry-light.toml",
        "docs/robots/b2-world.xml",
        "docs/robots/spot.toml",
    ];
    let files = files.map(read);
    let document = read("docs/ADDING_A_TASK.md");
    // The first block has the commands, which tests/system/own_task.rs runs.
    let blocks = document.split("```").skip(1).step_by(2).skip(1);
    let excerpts: Vec<&str> = blocks.filter_map(|block| Some(block.split_once('\n')?.1)).collect();
    assert!(excerpts.len() >= 2);
    let is_lost = |block: &&str| !files.iter().any(|file| file.contains(block));
    let lost: Vec<String> = excerpts.into_iter().filter(is_lost).map(str::to_owned).collect();
    assert_none("docs/ADDING_A_TASK.md shows text that is in none of its files:", &lost);
}
