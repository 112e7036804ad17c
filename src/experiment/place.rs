//! Whether an experiment may write into its folder.

use std::io::ErrorKind;

use anyhow::Context as _;
use learner::store::run_folder::RunFolder;

use super::file::ExperimentFile;
use super::plan::PlannedRun;
use super::report;
use crate::errors::Usage;
use crate::run::new_folder::{Others, demand_outside_runs};

/// Refuses a folder in a run, and one with files of others but no run.
///
/// # Errors
/// Names the folder and a file in it.
pub(crate) fn check(
    file: &ExperimentFile,
    runs: &[PlannedRun],
    others: Others,
) -> anyhow::Result<()> {
    runs.first().map_or(Ok(()), |run| demand_outside_runs(&run.folder))?;
    let shown = file.folder.display();
    let entries = match file.folder.read_dir() {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries.with_context(|| format!("cannot read {shown}"))?,
    };
    let names: Vec<String> = entries
        .filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()))
        .collect();
    let is_used = others == Others::Accepted || names.iter().any(|name| belongs(file, runs, name));
    match names.iter().find(|name| !report::is_part(name)) {
        Some(name) if !is_used => Err(Usage::new(format!(
            "{shown} contains {name} and no run of an experiment; choose another `folder`, or pass --force to use it"
        ))
        .into()),
        _ => Ok(()),
    }
}

/// Whether a file or folder of this name shows that an experiment used the folder.
fn belongs(file: &ExperimentFile, runs: &[PlannedRun], name: &str) -> bool {
    let stem = name.strip_suffix(".log").unwrap_or(name);
    name.starts_with("slurm")
        || runs.iter().any(|run| run.name() == stem)
        || RunFolder::holds_run(&file.folder.join(name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::file::tests::SAMPLE;
    use crate::experiment::plan::plan;

    #[test]
    fn a_folder_with_files_of_others_is_used_only_on_request() {
        let folder = tempfile::tempdir().unwrap();
        let file: ExperimentFile = toml::from_str(SAMPLE).unwrap();
        let file = ExperimentFile { folder: folder.path().into(), ..file };
        let runs = plan(&file).unwrap();
        check(&file, &runs, Others::Refused).unwrap();
        std::fs::write(folder.path().join("results.md"), "").unwrap();
        check(&file, &runs, Others::Refused).unwrap();
        std::fs::write(folder.path().join("thesis.tex"), "").unwrap();
        let error = check(&file, &runs, Others::Refused).unwrap_err().to_string();
        assert!(error.contains("contains thesis.tex and no run"), "{error}");
        check(&file, &runs, Others::Accepted).unwrap();
        std::fs::write(folder.path().join("ant-4x2-happo-seed0.log"), "").unwrap();
        check(&file, &runs, Others::Refused).unwrap();
        let run = RunFolder::claim_new(&folder.path().join("run")).unwrap();
        run.begin("", &serde_json::json!({"config_sha256": "aa"})).unwrap();
        let file = ExperimentFile { folder: run.path().join("study"), ..file };
        let error = check(&file, &plan(&file).unwrap(), Others::Accepted).unwrap_err().to_string();
        assert!(error.contains("is inside the run"), "{error}");
    }
}
