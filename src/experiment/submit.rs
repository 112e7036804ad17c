//! Jobs of a cluster that compute an experiment: each job is one shard of the runs.

pub(crate) mod k8s;
pub(crate) mod slurm;

use super::file::ExperimentFile;
use crate::errors::Usage;

/// Memory limit of a job. A run with one actor takes less than half of a GiB.
const MEMORY_GIB: usize = 4;

/// Longest name of a job, because Kubernetes adds an index to it and allows 63 letters.
const NAME_CHARS: usize = 50;

/// What the user chose, for any engine.
#[derive(Clone, Debug)]
pub(crate) struct Jobs {
    /// Runs of the experiment.
    pub(crate) runs: usize,
    /// Runs that one job computes one after the other.
    pub(crate) runs_per_job: usize,
    /// Jobs at the same time; `None`: no limit.
    pub(crate) limit: Option<usize>,
}

impl Jobs {
    /// Number of jobs, which is the number of shards.
    fn count(&self) -> usize {
        self.runs.div_ceil(self.runs_per_job)
    }
}

/// Cores of one job, which computes one run at a time: actors and learner threads work alternately.
fn cores(file: &ExperimentFile) -> usize {
    file.actors.max(file.threads)
}

/// Name of the job: lowercase letters, digits and `-`.
fn name(file: &ExperimentFile) -> String {
    let stem = file.path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    let plain = |letter: char| if letter.is_ascii_alphanumeric() { letter } else { '-' };
    let name: String = format!("s2mia-{stem}").chars().map(plain).take(NAME_CHARS).collect();
    name.trim_end_matches('-').to_owned()
}

/// Refuses a value that would not remain one word of a script or of YAML.
fn word<'a>(option: &str, value: &'a str) -> Result<&'a str, Usage> {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.,:/@+".contains(letter);
    if value.is_empty() || !value.chars().all(plain) {
        let why = format!("{option} {value}: use only letters, digits and - _ . , : / @ +");
        return Err(Usage::new(why));
    }
    Ok(value)
}

/// Replaces each `@KEY@` by its value.
fn filled(template: &str, values: &[(&str, &str)]) -> String {
    let put = |text: String, (key, value): &(&str, &str)| text.replace(&format!("@{key}@"), value);
    values.iter().fold(template.to_owned(), put)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_jobs_of_an_experiment_contain_all_its_runs() {
        let jobs = |runs, runs_per_job| Jobs { runs, runs_per_job, limit: None }.count();
        assert_eq!([jobs(12, 1), jobs(12, 5), jobs(1, 5)], [12, 3, 1]);
    }

    #[test]
    fn a_word_with_a_line_break_or_a_space_is_refused() {
        assert_eq!(word("--time", "1-12:00:00").unwrap(), "1-12:00:00");
        for value in ["", "a b", "a\n#SBATCH --uid=0"] {
            assert!(word("--time", value).unwrap_err().to_string().starts_with("--time "));
        }
    }
}
