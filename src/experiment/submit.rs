//! Jobs of a cluster that compute an experiment, each one shard of the runs: a Slurm job array, or an Indexed Job of Kubernetes
//! with its volume and the experiment's file.

use std::io::ErrorKind;
use std::path::{Component, Path};
use std::process::Command;

use anyhow::Context as _;
use learner::store::plain_file;
use security::addresses;

use super::PlannedRun;
use super::file::{ExperimentFile, LIMIT_BYTES};
use crate::config::keys::START;
use crate::config::layers::VARIABLE;
use crate::errors::Usage;
use crate::run::pretrained::team_record;

/// Memory limit of a job. A run with one actor takes less than half of a GiB.
const MEMORY_GIB: usize = 4;

/// Longest name of a job, because Kubernetes adds an index to it and allows 63 letters.
const NAME_CHARS: usize = 50;

/// Shortest time limit of a job of Slurm, minutes.
const LEAST_MINUTES: f64 = 5.0;

/// The script of each job.
const SLURM_SCRIPT: &str = include_str!("submit/slurm.sh");

/// Name of the script in the experiment's folder.
pub(crate) const SLURM_SCRIPT_NAME: &str = "slurm.sh";

/// All documents.
const K8S_MANIFEST: &str = include_str!("submit/k8s.yaml");

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
pub(crate) fn slurm_script(
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
    options.time.map_or(Ok(()), demand_time)?;
    // Slurm replaces %A and %a by the ids of the array and the job, and %% by %.
    let log = directory.join(&file.folder).join("slurm-").display().to_string().replace('%', "%%");
    let limit = jobs.limit.map_or_else(String::new, |limit| format!("%{limit}"));
    Ok(filled(
        SLURM_SCRIPT,
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
/// `sbatch` refuses the script; the error has its reason.
pub(crate) fn submit_to_slurm(script: &Path) -> anyhow::Result<String> {
    let output = Command::new("sbatch").arg(script).output().context("cannot start sbatch")?;
    if !output.status.success() {
        let why = String::from_utf8_lossy(&output.stderr);
        let why = why.split_whitespace().collect::<Vec<_>>().join(" ");
        anyhow::bail!("sbatch refuses {}: {why}", script.display());
    }
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// The manifest for `kubectl apply`.
///
/// # Errors
/// Names an option, a folder, a task or a setting that does not exist in a pod, or the file if it cannot be read.
pub(crate) fn k8s_manifest(
    (file, runs): (&ExperimentFile, &[PlannedRun]),
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
    runs.iter().try_for_each(|run| demand_known_in_pod(file, run))?;
    let text = plain_file::named_text(&file.path, LIMIT_BYTES);
    let text = text.with_context(|| format!("cannot read {}", file.path.display()))?;
    let text: Vec<String> = text.lines().map(|line| format!("    {line}")).collect();
    let queue = queue.map(|queue| word("--queue", queue)).transpose()?;
    let queue = queue.map_or_else(String::new, |queue| {
        format!("\n  labels: {{kueue.x-k8s.io/queue-name: \"{queue}\"}}")
    });
    let count = jobs.count();
    let file_name = file.path.file_name().unwrap_or_default().to_string_lossy();
    Ok(filled(
        K8S_MANIFEST,
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

/// Refuses a time limit that Slurm does not know, or that leaves no time for a run: its script stops it 120 s before.
fn demand_time(text: &str) -> Result<(), Usage> {
    let (days, time) = text.split_once('-').map_or((None, text), |(days, time)| (Some(days), time));
    let is_digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let number = |text: &str| text.parse::<u32>().ok().filter(|_| is_digits(text)).map(f64::from);
    let parts: Option<Vec<f64>> = time.split(':').map(number).collect();
    let minutes = match (days.map(number), parts.as_deref()) {
        (None, Some([minutes])) => Some(*minutes),
        (None, Some([minutes, secs])) => Some(minutes + secs / 60.0),
        (None, Some([hours, minutes, secs])) => Some(60.0 * hours + minutes + secs / 60.0),
        (Some(Some(days)), Some([hours, rest @ ..])) if rest.len() < 3 => {
            Some(1440.0 * days + 60.0 * hours + rest.first().unwrap_or(&0.0))
        }
        _ => None,
    };
    let refused = |why: &str| Err(Usage::new(format!("--time {text}: {why}")));
    match minutes {
        _ if ["unlimited", "infinite"].contains(&text.to_lowercase().as_str()) => Ok(()),
        // No limit.
        Some(0.0) => Ok(()),
        None => refused("write it as Slurm does: MINUTES, HOURS:MINUTES:SECONDS or DAYS-HOURS"),
        Some(minutes) if minutes < LEAST_MINUTES => {
            refused(&format!("must be at least {LEAST_MINUTES} minutes"))
        }
        Some(_) => Ok(()),
    }
}

/// Replaces each `@KEY@` by its value.
fn filled(template: &str, values: &[(&str, &str)]) -> String {
    let put = |text: String, (key, value): &(&str, &str)| text.replace(&format!("@{key}@"), value);
    values.iter().fold(template.to_owned(), put)
}

/// One word of a shell, and of a line that Slurm reads.
fn quoted(path: &str) -> Result<String, Usage> {
    if path.contains('\n') {
        return Err(Usage::new(format!("a script cannot name a path with a line break: {path:?}")));
    }
    Ok(format!("'{}'", path.replace('\'', r"'\''")))
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

/// Refuses a run with settings that only this host knows: of its environment variables, its files or its loopback address.
fn demand_known_in_pod(file: &ExperimentFile, run: &PlannedRun) -> Result<(), Usage> {
    let place = format!("{}, variant {} on {}", file.path.display(), run.variant, run.task);
    let refused = |why: String| Err(Usage::new(format!("{place}: {why}")));
    let resolved = &run.config.resolved;
    let of_process = |key: &&String| resolved.origin(key).starts_with(VARIABLE);
    if let Some(key) = resolved.entries.keys().find(of_process) {
        let origin = resolved.origin(key);
        return refused(format!(
            "{origin} does not exist in a pod; unset it, or write settings.{key} = {} into the file",
            resolved.shown(key)
        ));
    }
    let start = resolved.text(START);
    if !start.is_empty() && team_record(start).is_none() {
        return refused(format!(
            "{START} = {start} is a place of this host; --submit k8s needs the name of a team that comes with the program"
        ));
    }
    let url = &run.config.environment.url;
    if addresses::is_loopback(addresses::host(url)) {
        return refused(format!(
            "{url} is the loopback address, which differs in a pod; set environments.{} to a host that pods reach",
            run.task
        ));
    }
    Ok(())
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

#[cfg(test)]
mod tests;
