//! An excerpt that a document shows is part of a file that is tested.

use crate::assert_none;
use crate::repository::read;

/// The code blocks of a document, without their fences.
fn blocks(document: &str) -> Vec<String> {
    let parts = document.split("```");
    let inside = parts.skip(1).step_by(2);
    inside.filter_map(|block| block.split_once('\n')).map(|(_, code)| code.to_owned()).collect()
}

#[test]
fn the_example_of_a_task_stands_word_for_word_in_the_simulator() {
    let files = ["sim/assets/hopper.xml", "sim/assets/hopper.toml"].map(read);
    let shown = blocks(&read("docs/ADDING_A_TASK.md"));
    // The first block has the commands, which tests/system/own_task.rs runs.
    let excerpts = shown.into_iter().skip(1).collect::<Vec<_>>();
    assert!(excerpts.len() >= 2);
    let lost: Vec<String> = excerpts
        .into_iter()
        .filter(|block| !files.iter().any(|file| file.contains(block)))
        .collect();
    assert_none("docs/ADDING_A_TASK.md shows text that is in none of its files:", &lost);
}
