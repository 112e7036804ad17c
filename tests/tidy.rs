//! The house rules that neither the compiler nor clippy checks: arrows between crates, sizes and names of
//! files, forbidden calls, and whether the documents speak of things that exist. They read text only; what
//! the program does is tested elsewhere.

#[path = "tidy/arrows.rs"]
mod arrows;
#[path = "tidy/documents.rs"]
mod documents;
#[path = "tidy/equations.rs"]
mod equations;
#[path = "tidy/files.rs"]
mod files;
#[path = "tidy/forbidden.rs"]
mod forbidden;
#[path = "tidy/markdown.rs"]
mod markdown;
#[path = "tidy/repository.rs"]
mod repository;
#[path = "tidy/rust_text.rs"]
mod rust_text;

/// Fails with the rule and every place that breaks it.
#[track_caller]
fn assert_none(rule: &str, offenders: &[String]) {
    assert!(offenders.is_empty(), "{rule}\n  {}", offenders.join("\n  "));
}
