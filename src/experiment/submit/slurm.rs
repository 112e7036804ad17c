//! A Slurm job array.

use std::io::ErrorKind;
use std::path::Path;
use std::process::Command;

use anyhow::Context as _;

use super::{Jobs, MEMORY_GIB, cores, filled, name, word};
use crate::errors::Usage;
use crate::experiment::file::ExperimentFile;

/// The script of each job.
const SCRIPT: &str = include_str!("slurm.sh");

/// Name of the script in the experiment's folder.
pub(crate) const SCRIPT_NAME: &str = "slurm.sh";

/// Options that the script passes to Slurm.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SlurmOptions<'a> {
    /// Partition; `None`: the cluster's default.
    pub(crate) partition: Option<&'a str>,
    /// Time limit in Slurm's notation; `None`: the partition's.
    pub(crate) time: Option<&'a str>,
}

/// The script of the job array. Paths are absolute, because jobs start in another folder.
///
/// # Errors
/// Names an option or a path that a script cannot contain.
pub(crate) fn script(
    file: &ExperimentFile,
    jobs: &Jobs,
    options: SlurmOptions<'_>,
) -> anyhow::Result<String> {
    let directory = std::env::current_dir().context("cannot find the current folder")?;
    let program = std::env::current_exe().context("cannot find this program")?;
    let lines = [("--partition", options.partition), ("--time", options.time)];
    let lines = lines.into_iter().filter_map(|(option, value)| Some((option, value?)));
    let lines =
        lines.map(|(option, value)| Ok(format!("#SBATCH {option}={}\n", word(option, value)?)));
    let lines: String = lines.collect::<Result<_, Usage>>()?;
    // Slurm replaces %A and %a by the ids of the array and the job, and %% by %.
    let log = directory.join(&file.folder).join("slurm-").display().to_string().replace('%', "%%");
    let limit = jobs.limit.map_or_else(String::new, |limit| format!("%{limit}"));
    Ok(filled(
        SCRIPT,
        &[
            ("NAME", &name(file)),
            ("LAST", &(jobs.count() - 1).to_string()),
            ("LIMIT", &limit),
            ("CPUS", &cores(file).to_string()),
            ("MEMORY", &MEMORY_GIB.to_string()),
            ("COUNT", &jobs.count().to_string()),
            ("OPTIONS", &lines),
            ("LOG", &quoted(&format!("{log}%A_%a.log"))?),
            ("DIRECTORY", &quoted(&directory.to_string_lossy())?),
            ("PROGRAM", &quoted(&program.to_string_lossy())?),
            ("FILE", &quoted(&directory.join(&file.path).to_string_lossy())?),
        ],
    ))
}

/// Refuses a host without `sbatch`, before anything is written.
pub(crate) fn demand_sbatch() -> Result<(), Usage> {
    match Command::new("sbatch").arg("--version").output() {
        Err(error) if error.kind() == ErrorKind::NotFound => Err(Usage::new(
            "sbatch is not installed on this host; run the command on a login node of the cluster, \
             or print the script with --dry-run",
        )),
        _ => Ok(()),
    }
}

/// Submits the script; returns what `sbatch` says.
///
/// # Errors
/// Tells what `sbatch` refuses.
pub(crate) fn submit(script: &Path) -> anyhow::Result<String> {
    let output = Command::new("sbatch").arg(script).output().context("cannot start sbatch")?;
    if !output.status.success() {
        let why = String::from_utf8_lossy(&output.stderr);
        let why = why.split_whitespace().collect::<Vec<_>>().join(" ");
        anyhow::bail!("sbatch refuses {}: {why}", script.display());
    }
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// One word of a shell, and of a line that Slurm reads.
fn quoted(path: &str) -> Result<String, Usage> {
    if path.contains('\n') {
        return Err(Usage::new(format!("a script cannot name a path with a line break: {path:?}")));
    }
    Ok(format!("'{}'", path.replace('\'', r"'\''")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::file::tests::SAMPLE;

    fn sample(path: &str) -> ExperimentFile {
        let file: ExperimentFile = toml::from_str(SAMPLE).unwrap();
        ExperimentFile { path: path.into(), folder: "runs/it's".into(), ..file }
    }

    #[test]
    fn the_script_asks_for_the_cores_of_a_run_and_computes_one_shard_in_each_job() {
        let jobs = Jobs { runs: 5, runs_per_job: 2, limit: Some(2) };
        let options = SlurmOptions { partition: Some("short"), time: Some("1:00:00") };
        let text = script(&sample("a b.toml"), &jobs, options).unwrap();
        for line in [
            "#SBATCH --job-name=s2mia-a-b\n",
            "#SBATCH --array=0-2%2\n",
            "#SBATCH --cpus-per-task=2\n",
            "#SBATCH --partition=short\n",
            "#SBATCH --time=1:00:00\n",
            "/a b.toml' --shard \"$SLURM_ARRAY_TASK_ID/3\" --jobs 1 &\n",
            "/runs/it'\\''s/slurm-%A_%a.log'\n",
            "#SBATCH --signal=B:TERM@120\n",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
        // What is left out is left to the cluster.
        let jobs = Jobs { runs: 5, runs_per_job: 1, limit: None };
        let text = script(&sample("a.toml"), &jobs, SlurmOptions::default()).unwrap();
        assert!(text.contains("#SBATCH --array=0-4\n"), "{text}");
        assert!(!text.contains("--time") && !text.contains("--partition"), "{text}");
    }

    #[test]
    fn a_path_with_a_line_break_is_refused() {
        let error = quoted("a\nb").unwrap_err().to_string();
        assert!(error.contains(r#""a\nb""#), "{error}");
    }
}
