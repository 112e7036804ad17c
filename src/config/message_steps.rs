//! The steps of a message, which follow the steps of a slot unless the user gives them, and the messages of a new run, which fit
//! its environment: where observations are large, messages have fewer steps, or the settings that leave no fitting message
//! are refused with values that fit.

use learner::launch::Launch;
use proto::{Digest, RunDescription};

use super::conditions::OFF_POLICY_RULES;
use super::resolved::Resolved;
use crate::config::ConfigError;
use crate::config::keys::URL;
use crate::config::run_config::RunConfig;

/// Steps of a message.
pub(crate) const MESSAGE: &str = "environments.message_steps";

/// Steps of an iteration, which messages divide.
pub(crate) const SLOT: &str = "environments.steps";

/// Steps of a sequence, which divide a message.
pub(crate) const WINDOW: &str = "policy.backpropagation_steps";

/// More steps of an iteration are refused.
const MOST: u64 = 1_000_000;

/// Replaces steps of a message that do not divide the steps of an iteration, or that sequences do not divide, by steps that
/// fit, unless the user gave them: the most that are no more than before, else the fewest. If sequences do not divide the steps
/// of an iteration, which is refused later, a message has all of them.
pub(super) fn followed(mut resolved: Resolved) -> Resolved {
    // As `TrainingConfig::sequence_steps`, before the settings are known to be valid.
    let has_replay = OFF_POLICY_RULES.contains(&resolved.text("update.rule"));
    let window = if has_replay { Some(1) } else { resolved.whole(WINDOW) };
    let (Some(slot), Some(window), Some(now)) =
        (resolved.whole(SLOT), window, resolved.whole(MESSAGE))
    else {
        return resolved;
    };
    let fits = |steps: u64| slot.is_multiple_of(steps) && steps.is_multiple_of(window);
    let is_refused = window == 0 || !(1..=MOST).contains(&slot);
    if resolved.is_given(MESSAGE) || is_refused || (now > 0 && fits(now)) {
        return resolved;
    }
    let fewer = (1..=now.min(slot) / window)
        .rev()
        .map(|windows| windows * window)
        .find(|steps| fits(*steps));
    set(&mut resolved, fewer.unwrap_or(if fits(window) { window } else { slot }));
    resolved
}

/// Lowers the steps of a message until one fits, unless the user gave them.
///
/// Refuses settings with which no message fits.
pub(crate) fn fit(config: &mut RunConfig, launch: &mut Launch) -> Result<(), ConfigError> {
    let environments = &config.learner.environments;
    let now = StepCounts::of(config);
    let run = launch.smallest_description();
    if fits(&run, now) {
        return Ok(());
    }
    let fitting = largest(&run, now, environments.steps);
    let alone = |sizes: StepCounts| sizes == StepCounts { message: sizes.message, ..now };
    match fitting {
        Some(sizes) if alone(sizes) && !config.resolved.is_given(MESSAGE) => {
            set(&mut config.resolved, sizes.message as u64);
            config.learner.environments.message_steps = sizes.message;
            launch.config = config.learner.clone();
            launch.config_toml = config.resolved.to_toml();
            launch.config_sha256 = Digest(config.resolved.sha256());
            Ok(())
        }
        fitting => Err(refused(config, &run, (now, fitting))),
    }
}

/// Sets the steps of a message.
fn set(resolved: &mut Resolved, steps: u64) {
    // All callers choose at most the steps of an iteration, a setting.
    let steps = i64::try_from(steps).unwrap_or(i64::MAX);
    resolved.set(MESSAGE, steps, SLOT);
}

/// What determines the size of a message with one environment: slots are as small as their messages need.
#[derive(Clone, Copy, PartialEq)]
struct StepCounts {
    /// Steps of a message.
    message: usize,
    /// Steps of a sequence, which divide a message.
    window: usize,
}

impl StepCounts {
    fn of(config: &RunConfig) -> Self {
        let environments = &config.learner.environments;
        let window = config.training.sequence_steps(&config.policy);
        Self { message: environments.message_steps, window }
    }
}

fn bytes(run: &RunDescription, sizes: StepCounts) -> Option<u64> {
    let number = |size: usize| u32::try_from(size).unwrap_or(u32::MAX);
    let run = RunDescription {
        chunk_steps: number(sizes.message),
        hidden_every: number(sizes.window),
        ..run.clone()
    };
    run.largest_message_bytes()
}

fn fits(run: &RunDescription, sizes: StepCounts) -> bool {
    bytes(run, sizes).is_some_and(|bytes| bytes <= RunDescription::MESSAGE_LIMIT_BYTES)
}

/// The largest sizes that fit and are no larger than `now`. Sequences are shortened last, because that changes what is learnt.
fn largest(run: &RunDescription, now: StepCounts, steps: usize) -> Option<StepCounts> {
    for window in divisors(steps, now.window) {
        let messages = divisors(steps, now.message).filter(|steps| steps.is_multiple_of(window));
        let mut sizes = messages.map(|message| StepCounts { message, window });
        if let Some(sizes) = sizes.find(|sizes| fits(run, *sizes)) {
            return Some(sizes);
        }
    }
    None
}

/// Divisors of `whole` up to `most`, the largest first.
fn divisors(whole: usize, most: usize) -> impl Iterator<Item = usize> {
    (1..=most.min(whole)).rev().filter(move |part| whole.is_multiple_of(*part))
}

fn refused(
    config: &RunConfig,
    run: &RunDescription,
    (now, fitting): (StepCounts, Option<StepCounts>),
) -> ConfigError {
    let limit = RunDescription::MESSAGE_LIMIT_BYTES;
    let resolved = &config.resolved;
    let refused = |key: &str, detail: String| {
        let cause = if resolved.is_given(key) { key } else { URL };
        ConfigError::at(resolved.origin(cause), detail)
    };
    let Some(fitting) = fitting else {
        let least = bytes(run, StepCounts { message: 1, window: 1 });
        let least = least.map_or_else(|| "too many".to_owned(), |bytes| bytes.to_string());
        let detail = format!(
            "{URL} = {} does not fit: one step of one environment could have {least} bytes in a message, the limit is \
             {limit}; its observations and its state must be smaller",
            resolved.plain(URL)
        );
        return refused(URL, detail);
    };
    let sizes = [(MESSAGE, now.message, fitting.message), (WINDOW, now.window, fitting.window)];
    // Steps of a message that the user did not give follow.
    let is_free = |key: &str| key == MESSAGE && !resolved.is_given(MESSAGE);
    let mut changed = sizes.into_iter().filter(|(key, now, fits)| now != fits && !is_free(key));
    let set = changed.clone().map(|(key, _, fits)| format!("{key}={fits}"));
    let set = set.collect::<Vec<_>>().join(" ");
    let (key, value, _) = changed.next().unwrap_or(sizes[0]);
    let detail = format!(
        "{key} = {value} does not fit this environment: messages could be larger than {limit} bytes; set {set}"
    );
    refused(key, detail)
}

#[cfg(test)]
#[expect(dead_code, reason = "the tests of messages also need chunks")]
#[path = "../../proto/tests/wire/sample.rs"]
mod sample;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ConfigError;
    use crate::config::run_config::RunConfig;

    fn built(settings: &[&str]) -> Result<usize, ConfigError> {
        Ok(RunConfig::with(settings)?.learner.environments.message_steps)
    }

    #[test]
    fn the_steps_of_a_message_follow_those_of_an_iteration_and_of_a_sequence() {
        for (settings, expected) in [
            (&["environments.steps=40"][..], 40),
            (&["environments.steps=130"], 10),
            (&["environments.steps=200"], 50),
            (&["environments.steps=40", "algorithm=maddpg"], 40),
            (&["environments.steps=45", "algorithm=hasac"], 45),
            (&["policy.backpropagation_steps=25"], 50),
            (&["policy.backpropagation_steps=100", "environments.steps=200"], 100),
            (&["environments.steps=30", "policy.backpropagation_steps=6"], 30),
            (&["environments.steps=40", "environments.message_steps=20"], 20),
        ] {
            assert_eq!(built(settings), Ok(expected), "{settings:?}");
        }
    }

    #[test]
    fn steps_that_no_message_fits_are_laid_at_the_setting_that_the_user_gave() {
        let refusal = |settings: &[&str]| built(settings).unwrap_err().to_string();
        assert_eq!(
            refusal(&["environments.steps=45"]),
            "command line: environments.steps = 45 is out of range: a multiple of \
             policy.backpropagation_steps = 10"
        );
        assert_eq!(
            refusal(&["policy.backpropagation_steps=7"]),
            "command line: policy.backpropagation_steps = 7 does not fit: environments.steps = 50 is out of \
             range: a multiple of policy.backpropagation_steps = 7"
        );
        assert_eq!(
            refusal(&["environments.steps=40", "environments.message_steps=60"]),
            "command line: environments.message_steps = 60 is out of range: 1 to environments.steps = 40"
        );
    }

    fn config(settings: &[&str]) -> RunConfig {
        let url = "environment_service.url=http://localhost:7";
        RunConfig::with(&[settings, &[url]].concat()).unwrap()
    }

    /// A run of two agents that observe so many features each.
    fn run(observed: usize) -> RunDescription {
        let task = config(&["halfcheetah-2x3"]).task;
        let world = sim::environments(&task, 1).unwrap();
        let mut environment = world.description().clone();
        for agent in &mut environment.agents {
            agent.observation = vec![agent.observation[0].clone(); observed];
        }
        RunDescription {
            environment,
            environments_per_slot: 1,
            slot_steps: 50,
            chunk_steps: 50,
            hidden_sizes: vec![64; 2],
            hidden_every: 10,
            ..sample::run()
        }
    }

    fn sizes(observed: usize) -> Option<(usize, usize)> {
        let found = largest(&run(observed), StepCounts { message: 50, window: 10 }, 50)?;
        Some((found.message, found.window))
    }

    #[test]
    fn messages_shrink_before_sequences() {
        // A row has 16 bytes for each feature that both agents observe, the limit is 4 MiB.
        assert_eq!(sizes(3_000), Some((50, 10)));
        assert_eq!(sizes(20_000), Some((10, 10)));
        assert_eq!(sizes(84 * 84 * 4), Some((5, 5)));
        assert_eq!(sizes(300_000), None);
    }

    fn refusal(settings: &[&str], observed: usize) -> String {
        let config = config(settings);
        let now = StepCounts::of(&config);
        let run = run(observed);
        refused(&config, &run, (now, largest(&run, now, 50))).to_string()
    }

    #[test]
    fn a_refusal_names_the_setting_the_value_that_fits_and_who_gave_it() {
        assert_eq!(
            refusal(&["environments.message_steps=50"], 20_000),
            "command line: environments.message_steps = 50 does not fit this environment: messages could be \
             larger than 4177920 bytes; set environments.message_steps=10"
        );
        let images = 84 * 84 * 4;
        assert_eq!(
            refusal(&[], images),
            "command line: policy.backpropagation_steps = 10 does not fit this environment: messages could be \
             larger than 4177920 bytes; set policy.backpropagation_steps=5"
        );
        assert!(refusal(&[], 300_000).contains("its observations and its state must be smaller"));
    }
}
