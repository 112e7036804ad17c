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
/// Tells what `sbatch` refuses.
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
    if is_of_this_host(url) {
        return refused(format!(
            "{url} is the loopback address, which differs in a pod; set environments.{} to a host that pods reach",
            run.task
        ));
    }
    Ok(())
}

/// Whether only processes of this host reach the URL.
fn is_of_this_host(url: &str) -> bool {
    let Some((_, rest)) = url.split_once("://") else { return false };
    let authority = rest.split(['/', '?', '#']).next().unwrap_or(rest);
    let host = authority.rsplit_once('@').map_or(authority, |(_, host)| host);
    let host = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or(rest),
        None => host.split(':').next().unwrap_or(host),
    };
    addresses::is_loopback(host)
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
mod tests {
    use super::*;
    use crate::experiment::file::tests::SAMPLE;
    use crate::experiment::plan;

    #[test]
    fn the_jobs_of_an_experiment_contain_all_its_runs() {
        let jobs = |runs, runs_per_job| Jobs { runs, runs_per_job, limit: None }.count();
        assert_eq!([jobs(12, 1), jobs(12, 5), jobs(1, 5)], [12, 3, 1]);
    }

    #[test]
    fn a_word_with_a_line_break_or_a_space_and_a_path_with_a_line_break_are_refused() {
        assert_eq!(word("--time", "1-12:00:00").unwrap(), "1-12:00:00");
        for value in ["", "a b", "a\n#SBATCH --uid=0"] {
            assert!(word("--time", value).unwrap_err().to_string().starts_with("--time "));
        }
        let error = quoted("a\nb").unwrap_err().to_string();
        assert!(error.contains(r#""a\nb""#), "{error}");
    }

    fn sample(path: &str) -> ExperimentFile {
        let file: ExperimentFile = toml::from_str(SAMPLE).unwrap();
        ExperimentFile { path: path.into(), folder: "runs/it's".into(), ..file }
    }

    #[test]
    fn the_script_asks_for_the_cores_of_a_run_and_computes_one_shard_in_each_job() {
        let jobs = Jobs { runs: 5, runs_per_job: 2, limit: Some(2) };
        let options = SlurmOptions { partition: Some("short"), time: Some("1:00:00") };
        let text = slurm_script(&sample("a b.toml"), &jobs, options).unwrap();
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
        let text = slurm_script(&sample("a.toml"), &jobs, SlurmOptions::default()).unwrap();
        assert!(text.contains("#SBATCH --array=0-4\n"), "{text}");
        assert!(!text.contains("--time") && !text.contains("--partition"), "{text}");
    }

    #[test]
    fn a_pod_gets_no_setting_that_only_this_host_knows() {
        let refused = |line: &str| {
            let text = SAMPLE.replacen("threads", &format!("{line}\nthreads"), 1);
            let file: ExperimentFile = toml::from_str(&text).unwrap();
            let runs = plan(&ExperimentFile { path: "a.toml".into(), ..file.clone() }).unwrap();
            let place = ExperimentFile { path: "a.toml".into(), ..file };
            let refused = runs.iter().try_for_each(|run| demand_known_in_pod(&place, run));
            refused.err().map(|error| error.to_string())
        };
        assert_eq!(refused("environments.ant-4x2 = \"http://environments:7\""), None);
        let line = refused("environments.ant-4x2 = \"http://localhost:7\"").unwrap();
        let words = "a.toml, variant happo on ant-4x2: http://localhost:7 is the loopback address";
        assert!(line.starts_with(words), "{line}");
        for (url, own) in [
            ("http://127.0.0.3:7", true),
            ("https://[::1]:7/", true),
            ("http://LOCALHOST", true),
            ("http://10.0.0.1:7", false),
            ("http://localhost.example:7", false),
        ] {
            assert_eq!(is_of_this_host(url), own, "{url}");
        }
    }

    #[test]
    fn policies_in_a_file_and_an_environment_variable_of_this_host_are_refused_for_a_pod() {
        let file = ExperimentFile { path: "a.toml".into(), ..toml::from_str(SAMPLE).unwrap() };
        let mut run = plan(&file).unwrap().remove(0);
        run.config.resolved.set(START, "halfcheetah-2x3".to_owned(), "a.toml");
        demand_known_in_pod(&file, &run).unwrap();
        run.config.resolved.set(START, "runs/one".to_owned(), "a.toml");
        let line = demand_known_in_pod(&file, &run).unwrap_err().to_string();
        assert!(line.contains("policy.start = runs/one is a place of this host"), "{line}");
        let variable = format!("{VARIABLE} S2MIA__POLICY__START");
        run.config.resolved.set(START, "halfcheetah-2x3".to_owned(), &variable);
        let line = demand_known_in_pod(&file, &run).unwrap_err().to_string();
        let words = "environment variable S2MIA__POLICY__START does not exist in a pod; unset it, or write settings.policy.start = ";
        assert!(line.contains(words), "{line}");
    }
}
