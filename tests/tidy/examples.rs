//! Code that a document shows is code that is compiled.

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
    let files = ["sim/assets/hopper.xml", "sim/src/task/hopper.rs", "sim/src/task.rs"].map(read);
    let shown = blocks(&read("docs/ADDING_A_TASK.md"));
    assert!(shown.len() >= 5);
    let lost: Vec<String> =
        shown.into_iter().filter(|block| !files.iter().any(|file| file.contains(block))).collect();
    assert_none("docs/ADDING_A_TASK.md shows code that is in none of its files:", &lost);
}
