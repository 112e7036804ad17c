//! What a script for Slurm and a manifest for Kubernetes contain.

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

#[test]
fn a_time_limit_is_one_of_slurm_and_at_least_five_minutes() {
    for time in ["5", "5:00", "90:30", "1:00:00", "1-0", "2-12:30", "1-12:00:00", "0", "UNLIMITED"]
    {
        demand_time(time).unwrap();
    }
    for (time, words) in [
        ("bla", "write it as Slurm does"),
        ("1:2:3:4", "write it as Slurm does"),
        ("1-", "write it as Slurm does"),
        ("+5", "write it as Slurm does"),
        ("-5", "write it as Slurm does"),
        ("1:00", "must be at least 5 minutes"),
        ("0-0:4", "must be at least 5 minutes"),
    ] {
        let why = demand_time(time).unwrap_err().to_string();
        assert!(why.starts_with(&format!("--time {time}: {words}")), "{why}");
    }
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
