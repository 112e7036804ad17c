//! The trained policies from which a run starts. Its settings identify them by their SHA-256, wherever they are, and its folder
//! keeps a copy.

use std::path::Path;

use anyhow::{Context as _, ensure};
use learner::store::run_folder::START_POLICIES;
use learner::store::{checkpoint, plain_file};
use policy::PolicySnapshot;
use proto::{AgentSpec, Digest};

use crate::config::keys::{START, START_SHA256};
use crate::config::run_config::RunConfig;
use crate::config::{ConfigError, Resolved, layers};
use crate::process::shell;
use crate::run::chosen::ChosenArguments;
use crate::run::stored;

/// How the environment or the learner scales observations. Policies know only the learner's scale.
const NORM: &str = "observation.norm";

/// Policies of a place that the setting may name.
struct Found {
    /// The encoded policies.
    bytes: Vec<u8>,
    /// The configuration of their run; `None` for a file outside a run, which does not say it.
    config: Option<RunConfig>,
}

/// Sets the SHA-256 of the policies that the settings name. Without any, no setting of them remains.
///
/// # Errors
/// There are no such policies, they see other observations or move other joints, or they are not those with the SHA-256 that the
/// same file or command gives.
pub(crate) fn identify(config: &mut RunConfig) -> Result<(), ConfigError> {
    let resolved = &mut config.resolved;
    let named = resolved.text(START).to_owned();
    if named.is_empty() {
        if resolved.is_given(START_SHA256) {
            let why = format!("`{START_SHA256}` has no effect in this run: it needs {START}");
            return Err(ConfigError::refused(resolved, &[START_SHA256], &why));
        }
        resolved.remove_start();
        return Ok(());
    }
    let Found { bytes, config: trained } = named_policies(resolved)?;
    if let Some(why) = trained.and_then(|trained| difference(&trained, config)) {
        let why = format!("{START}: the policies of {named} {why}");
        return Err(ConfigError::refused(&config.resolved, &[START], &why));
    }
    let resolved = &mut config.resolved;
    let origin = resolved.origin(START_SHA256);
    if origin == resolved.origin(START) || layers::is_of_this_command(origin) {
        demand_digest(resolved, &bytes)?;
    }
    resolved.set(START_SHA256, Digest::of(&bytes).to_string(), START);
    Ok(())
}

/// The policies from which a run with these settings starts, if it starts from any: those that the settings name, or those that
/// the folder of the run `resumed` keeps. A run with a checkpoint needs them no more.
///
/// # Errors
/// They are gone or have changed.
pub(crate) fn policies(
    resolved: &Resolved,
    resumed: Option<&Path>,
) -> anyhow::Result<Option<Vec<u8>>> {
    if resolved.text(START_SHA256).is_empty() {
        return Ok(None);
    }
    let bytes = match resumed {
        None => named_policies(resolved)?.bytes,
        Some(run) if checkpoint::newest_iteration(run)?.is_some() => {
            if let Err(why) = demand_kept(resolved, run) {
                tracing::warn!("{why:#}; `s2mia verify` and `s2mia pack` of this run need it");
            }
            return Ok(None);
        }
        Some(run) => return kept(resolved, run).map(Some),
    };
    demand_digest(resolved, &bytes)?;
    Ok(Some(bytes))
}

/// Refuses the run in `folder` if it started from trained policies and its copy of them is damaged or gone.
pub(crate) fn demand_kept(resolved: &Resolved, folder: &Path) -> anyhow::Result<()> {
    if resolved.text(START_SHA256).is_empty() {
        return Ok(());
    }
    kept(resolved, folder).map(drop)
}

/// The policies from which the run in `folder` started, as it keeps them.
fn kept(resolved: &Resolved, folder: &Path) -> anyhow::Result<Vec<u8>> {
    let (file, expected) = (folder.join(START_POLICIES), resolved.text(START_SHA256));
    let remedy = || format!("restore it from the run that {START} names, or from a pack");
    let bytes = of_file(&file).with_context(remedy)?;
    let found = Digest::of(&bytes).to_string();
    let place = file.display();
    ensure!(
        found == expected,
        "{place} has the SHA-256 {found}, the settings have {expected}; {}",
        remedy()
    );
    Ok(bytes)
}

/// Why a run cannot start from the policies of the run `trained`, if it cannot. Sizes are compared when training begins.
fn difference(trained: &RunConfig, own: &RunConfig) -> Option<String> {
    let [norm, own_norm] = [trained, own].map(|config| config.resolved.text(NORM));
    if norm != own_norm {
        return Some(format!("need {NORM} = {norm}, this run has {own_norm}"));
    }
    let [(task, agents), (own_task, own_agents)] = [simulated(trained)?, simulated(own)?];
    if agents.len() != own_agents.len() {
        return None;
    }
    let mut differences = agents.iter().zip(&own_agents).filter_map(|(agent, own)| {
        let [names, own_names] = [names(agent), names(own)];
        let mut pairs = names.iter().zip(&own_names);
        let (name, own_name) = pairs.find(|(a, b)| names.len() == own_names.len() && a != b)?;
        Some(format!(
            "are for {task}, whose {} has `{name}` where that of {own_task} has `{own_name}`",
            agent.name
        ))
    });
    differences.next()
}

/// Name and agents of the task; `None` if an external program offers it, which is not asked yet, or if it cannot be built, which
/// is an error when the run starts.
fn simulated(config: &RunConfig) -> Option<(String, Vec<AgentSpec>)> {
    if !config.environment.url.is_empty() {
        return None;
    }
    let world = sim::environments(&config.task, 1).ok()?;
    let description = world.description();
    Some((description.task.clone(), description.agents.clone()))
}

/// Names of what an agent observes and then of the joints that it moves.
fn names(agent: &AgentSpec) -> Vec<&str> {
    let observed = agent.observation.iter().map(|feature| feature.name.as_str());
    observed.chain(agent.joints.iter().map(String::as_str)).collect()
}

fn named_policies(resolved: &Resolved) -> Result<Found, ConfigError> {
    found(resolved.text(START)).map_err(|why| {
        let detail = format!("{START}: {}", actor::causes(why.as_ref()));
        ConfigError::refused(resolved, &[START], &detail)
    })
}

/// The policies of a file, a run, `RUN:CHECKPOINT`, a checkpoint or a team that comes with the program.
fn found(named: &str) -> anyhow::Result<Found> {
    let mut path = shell::expanded(Path::new(named))?;
    if path.is_file() || path.ends_with(START_POLICIES) {
        return Ok(Found { bytes: of_file(&path)?, config: config_beside(&path) });
    }
    let mut checkpoint = None;
    if let Some((run, which)) = named.rsplit_once(':').filter(|_| !path.exists()) {
        path = shell::expanded(Path::new(run))?;
        checkpoint = Some(which.into());
    }
    let trained = stored::trained(&ChosenArguments { run: Some(path), checkpoint }.path()?)?;
    Ok(Found { bytes: trained.policy.to_bytes()?, config: Some(trained.config) })
}

/// The settings of the run that keeps these policies as those from which it started, or in a checkpoint; `None` for another file.
fn config_beside(file: &Path) -> Option<RunConfig> {
    let folder = file.parent()?;
    let run = if file.ends_with(START_POLICIES) { folder } else { folder.parent()?.parent()? };
    let is_kept =
        file.ends_with(START_POLICIES) || folder.parent() == Some(&*checkpoint::folder(run));
    is_kept.then(|| stored::config_of_run(run).ok()).flatten()
}

/// The encoded policies in a file.
fn of_file(file: &Path) -> anyhow::Result<Vec<u8>> {
    let unreadable = || format!("cannot read {}", file.display());
    let bytes = plain_file::read(file).with_context(unreadable)?;
    PolicySnapshot::from_bytes(&bytes).with_context(unreadable)?;
    Ok(bytes)
}

/// Refuses other policies than those with the SHA-256 in the settings.
fn demand_digest(resolved: &Resolved, bytes: &[u8]) -> Result<(), ConfigError> {
    let (named, expected) = (resolved.text(START), resolved.text(START_SHA256));
    let found = Digest::of(bytes).to_string();
    if found == expected {
        return Ok(());
    }
    let detail = format!(
        "{START}: the policies of {named} have the SHA-256 {found}, the settings {expected}; a run that started from those keeps \
         them in its {START_POLICIES}"
    );
    Err(ConfigError::refused(resolved, &[START], &detail))
}

/// Names the copy that the folder of a run keeps as the place of the policies from which it started, if it started from any.
pub(crate) fn take_kept(resolved: &mut Resolved, run: &Path) {
    if !resolved.text(START_SHA256).is_empty() {
        resolved.set(START, run.join(START_POLICIES).display().to_string(), "run folder");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Request;
    use crate::run::{command, pretrained, resume};

    const TASK: &str = "halfcheetah-2x3";

    fn config(settings: &[&str]) -> Result<RunConfig, String> {
        RunConfig::with(&[&[TASK], settings].concat()).map_err(|error| error.to_string())
    }

    fn sha256(config: &RunConfig) -> String {
        policy::arrays::hex(&config.resolved.sha256())
    }

    /// The settings of a run whose own are in `file`, resumed with these.
    fn resumed(file: &Path, settings: &[&str]) -> Result<RunConfig, ConfigError> {
        let settings = settings.iter().map(|setting| (*setting).to_owned()).collect();
        let resumed = Some(file.to_path_buf());
        RunConfig::of(&Request { resumed, settings, ..Request::default() })
    }

    #[test]
    fn the_settings_identify_the_policies_by_their_content_and_are_the_same_without_any() {
        let team = pretrained::of_task(TASK).unwrap().unwrap().trained().unwrap();
        let bytes = team.policy.to_bytes().unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("copy.safetensors");
        std::fs::write(&file, &bytes).unwrap();
        let named = config(&["policy.start=halfcheetah-2x3"]).unwrap();
        let copied = config(&[&format!("policy.start={}", file.display())]).unwrap();
        let digest = Digest::of(&bytes).to_string();
        assert_eq!(named.resolved.text(START_SHA256), digest);
        assert_eq!(team.weights.digest.to_string(), digest);
        assert_eq!(sha256(&named), sha256(&copied));
        let (plain, empty) = (config(&[]).unwrap(), config(&["policy.start="]).unwrap());
        assert_eq!(plain.resolved.to_toml(), empty.resolved.to_toml());
        assert!(!plain.resolved.to_toml().contains("start_sha256"));
        assert_ne!(sha256(&plain), sha256(&named));
        assert_eq!(policies(&copied.resolved, None).unwrap().unwrap(), bytes);
        assert!(policies(&plain.resolved, None).unwrap().is_none());
    }

    #[test]
    fn policies_that_are_gone_changed_or_see_other_observations_are_refused_in_one_line() {
        for (settings, words) in [
            (&["policy.start=halfcheetah-2x2"][..], "did you mean `halfcheetah-2x3`?"),
            (&["policy.start=no/such/run"], "command line: policy.start: "),
            (&["policy.start=run/start_policies.safetensors"], "cannot read run/start_policies"),
            (&["policy.start=halfcheetah-2x3:best"], "has no checkpoints to choose from"),
            (
                &["policy.start=halfcheetah-2x3", "observation.norm=none"],
                "policy.start: the policies of halfcheetah-2x3 need observation.norm = running, this run has none",
            ),
            (
                &["policy.start=halfcheetah-2x3", "policy.start_sha256=ab"],
                "the settings ab; a run that started from those keeps them in its start_policies.safetensors",
            ),
            (&["policy.start_sha256=ab"], "it needs policy.start"),
        ] {
            let line = config(settings).unwrap_err();
            assert!(line.contains(words) && !line.contains('\n'), "{line}");
        }
    }

    #[test]
    fn policies_of_equal_sizes_but_another_robot_are_refused_with_the_first_names_that_differ() {
        let refused = RunConfig::with(&["walker2d-2x3", "policy.start=halfcheetah-2x3"]);
        let line = refused.unwrap_err().to_string();
        let why = "the policies of halfcheetah-2x3 are for halfcheetah-2x3, whose agent_0 has `bthigh.position` where \
                   that of walker2d-2x3 has `thigh.position`";
        assert!(line.contains(why), "{line}");
        for (task, same) in
            [("halfcheetah-pushed-2x3", "halfcheetah-2x3"), ("carry-heavy-2x2", "carry-light-2x2")]
        {
            RunConfig::with(&[task, &format!("policy.start={same}")]).unwrap();
        }
    }

    #[test]
    fn the_copy_of_policies_that_a_run_keeps_has_the_names_of_that_run() {
        let folder = tempfile::tempdir().unwrap();
        let team = pretrained::of_task(TASK).unwrap().unwrap().trained().unwrap();
        let settings = config(&["policy.start=halfcheetah-2x3"]).unwrap().resolved.to_toml();
        std::fs::write(folder.path().join("config.toml"), settings).unwrap();
        let checkpoint = folder.path().join("checkpoints/iter_00000001");
        std::fs::create_dir_all(&checkpoint).unwrap();
        for file in [folder.path().join(START_POLICIES), checkpoint.join("policy.safetensors")] {
            std::fs::write(&file, team.policy.to_bytes().unwrap()).unwrap();
            let named = format!("policy.start={}", file.display());
            let line = RunConfig::with(&["walker2d-2x3", &named]).unwrap_err().to_string();
            assert!(line.contains("are for halfcheetah-2x3, whose agent_0 has"), "{line}");
            config(&[&named]).unwrap();
        }
    }

    #[test]
    fn the_settings_of_a_run_are_read_without_the_policies_unless_others_are_given() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("config.toml");
        let text = config(&["policy.start=halfcheetah-2x3"]).unwrap().resolved.to_toml();
        std::fs::write(&file, text.replace("\"halfcheetah-2x3\"\nstart_", "\"gone\"\nstart_"))
            .unwrap();
        let own = resumed(&file, &[]).unwrap().resolved;
        assert_eq!(own.text(START), "gone");
        for named in ["policy.start=gone", "policy.start=halfcheetah-2x3"] {
            let again = resumed(&file, &[named]).unwrap().resolved;
            assert_eq!(again.text(START_SHA256), own.text(START_SHA256), "{named}");
        }
        assert!(resumed(&file, &["policy.start=gone-too"]).is_err());
        let new = Request { files: vec![file.clone()], ..Request::default() };
        assert!(RunConfig::of(&new).is_err(), "a new run reads them");
    }

    #[test]
    fn a_resume_neither_adds_nor_removes_policies_from_which_the_run_started() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("config.toml");
        let team = "policy.start=halfcheetah-2x3";
        for (old, new, line) in [
            (
                &[][..],
                team,
                "command line: `policy.start` cannot change on resume: the run has none, found \"halfcheetah-2x3\"; ",
            ),
            (
                &[team],
                "policy.start=",
                "`policy.start` cannot change on resume: the run has \"halfcheetah-2x3\", found none; ",
            ),
        ] {
            let old = config(old).unwrap();
            std::fs::write(&file, old.resolved.to_toml()).unwrap();
            let refused = resume::check(&old, &resumed(&file, &[new]).unwrap());
            let refused = refused.unwrap_err().to_string();
            assert!(refused.starts_with(line), "{refused}");
        }
    }

    #[test]
    fn the_command_that_trains_such_a_run_again_names_the_copy_of_its_policies() {
        let run = config(&["policy.start=halfcheetah-2x3"]).unwrap();
        assert_eq!(
            command(&run, Path::new("runs/first")),
            "s2mia train halfcheetah-2x3 policy.start=runs/first/start_policies.safetensors"
        );
    }
}
