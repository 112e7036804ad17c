//! An Indexed Job of Kubernetes with its volume and the experiment's file.

use std::path::{Component, Path};

use anyhow::Context as _;

use super::{Jobs, MEMORY_GIB, cores, filled, name, word};
use crate::errors::Usage;
use crate::experiment::file::ExperimentFile;

/// All documents.
const MANIFEST: &str = include_str!("k8s.yaml");

/// The manifest for `kubectl apply`.
///
/// # Errors
/// Names an option, a folder or a task that does not exist in a pod, or the file if it cannot be read.
pub(crate) fn manifest(
    file: &ExperimentFile,
    jobs: &Jobs,
    image: &str,
    queue: Option<&str>,
) -> anyhow::Result<String> {
    let [folder, record] = &file.written;
    demand_relative("folder", folder)?;
    demand_relative("record", record)?;
    let mut tasks =
        file.variants.iter().filter_map(|v| v.tasks.as_ref()).chain([&file.tasks]).flatten();
    if let Some(task) = tasks.find(|task| Path::new(task).extension().is_some()) {
        let why = format!(
            "{task} is a file of this host; --submit k8s needs tasks that `s2mia tasks` lists"
        );
        return Err(Usage::new(why).into());
    }
    let text = std::fs::read_to_string(&file.path);
    let text = text.with_context(|| format!("cannot read {}", file.path.display()))?;
    let text: Vec<String> = text.lines().map(|line| format!("    {line}")).collect();
    let queue = queue.map(|queue| word("--queue", queue)).transpose()?;
    let queue = queue.map_or_else(String::new, |queue| {
        format!("\n  labels: {{kueue.x-k8s.io/queue-name: \"{queue}\"}}")
    });
    let count = jobs.count();
    let file_name = file.path.file_name().unwrap_or_default().to_string_lossy();
    Ok(filled(
        MANIFEST,
        &[
            ("NAME", &name(file)),
            ("QUEUE", &queue),
            ("COUNT", &count.to_string()),
            ("PARALLEL", &jobs.limit.unwrap_or(count).min(count).to_string()),
            ("IMAGE", word("--image", image)?),
            ("CPUS", &cores(file).to_string()),
            ("MEMORY", &MEMORY_GIB.to_string()),
            ("FILE", key_of_a_map(&file_name)?),
            ("TEXT", &text.join("\n")),
        ],
    ))
}

/// Refuses a name that no key of a ConfigMap can have.
fn key_of_a_map(name: &str) -> Result<&str, Usage> {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    if !name.chars().all(plain) {
        return Err(Usage::new(format!(
            "{name}: --submit k8s needs a file name of letters, digits, `-`, `_` and `.`"
        )));
    }
    Ok(name)
}

/// The volume holds the paths that start in the working folder.
fn demand_relative(key: &str, path: &Path) -> Result<(), Usage> {
    let is_inside = |part| matches!(part, Component::Normal(_) | Component::CurDir);
    if !path.components().all(is_inside) {
        return Err(Usage::new(format!(
            "{key} = \"{}\" does not exist in a pod; --submit k8s needs a relative path without `..`",
            path.display()
        )));
    }
    Ok(())
}
