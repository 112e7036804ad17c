//! Fits the messages of a new run to its environment, whose observations may be large: messages have fewer steps, or the
//! settings that leave no fitting message are refused with values that fit.

use learner::launch::Launch;
use proto::{Digest, RunDescription};

use crate::config::keys::{self, URL};
use crate::config::message_steps::{MESSAGE, WINDOW};
use crate::config::run_config::RunConfig;
use crate::config::{ConfigError, message_steps};

/// What determines the size of a message.
#[derive(Clone, Copy, PartialEq)]
struct Sizes {
    /// Environments of a slot.
    per_slot: usize,
    /// Steps of a message.
    message: usize,
    /// Steps of a sequence, which divide a message.
    window: usize,
}

impl Sizes {
    fn of(config: &RunConfig) -> Self {
        let environments = &config.learner.environments;
        Self {
            // Slots of no fixed size are as small as their messages need.
            per_slot: environments.per_slot.max(1),
            message: environments.message_steps,
            window: config.policy.backpropagation_steps,
        }
    }
}

/// Lowers the steps of a message until one fits, unless the user gave them.
///
/// Refuses settings with which no message fits.
pub(crate) fn fit(config: &mut RunConfig, launch: &mut Launch) -> Result<(), ConfigError> {
    let environments = &config.learner.environments;
    let now = Sizes::of(config);
    let run = launch.smallest_description();
    if fits(&run, now) {
        return Ok(());
    }
    let fitting = largest(&run, now, (environments.count, environments.steps));
    let alone = |sizes: Sizes| sizes == Sizes { message: sizes.message, ..now };
    match fitting {
        Some(sizes) if alone(sizes) && !config.resolved.is_given(MESSAGE) => {
            message_steps::set(&mut config.resolved, sizes.message as u64);
            config.learner.environments.message_steps = sizes.message;
            launch.config = config.learner.clone();
            launch.config_toml = config.resolved.to_toml();
            launch.config_sha256 = Digest(config.resolved.sha256());
            Ok(())
        }
        fitting => Err(refused(config, &run, (now, fitting))),
    }
}

fn bytes(run: &RunDescription, sizes: Sizes) -> Option<u64> {
    let number = |size: usize| u32::try_from(size).unwrap_or(u32::MAX);
    let run = RunDescription {
        environments_per_slot: number(sizes.per_slot),
        chunk_steps: number(sizes.message),
        hidden_every: number(sizes.window),
        ..run.clone()
    };
    run.largest_message_bytes()
}

fn fits(run: &RunDescription, sizes: Sizes) -> bool {
    bytes(run, sizes).is_some_and(|bytes| bytes <= RunDescription::MESSAGE_LIMIT_BYTES)
}

/// The largest sizes that fit and are no larger than `now`. Sequences are shortened last, because that changes what is learnt.
fn largest(run: &RunDescription, now: Sizes, (count, steps): (usize, usize)) -> Option<Sizes> {
    for window in divisors(steps, now.window) {
        for per_slot in divisors(count, now.per_slot) {
            let messages =
                divisors(steps, now.message).filter(|steps| steps.is_multiple_of(window));
            let mut sizes = messages.map(|message| Sizes { per_slot, message, window });
            if let Some(sizes) = sizes.find(|sizes| fits(run, *sizes)) {
                return Some(sizes);
            }
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
    (now, fitting): (Sizes, Option<Sizes>),
) -> ConfigError {
    let limit = RunDescription::MESSAGE_LIMIT_BYTES;
    let resolved = &config.resolved;
    let refused = |key: &str, detail| {
        let cause = if resolved.is_given(key) { key } else { URL };
        let place = resolved.origin(cause).to_owned();
        let key = key.to_owned();
        ConfigError::Refused { place, key, detail }
    };
    let Some(fitting) = fitting else {
        let least = bytes(run, Sizes { per_slot: 1, message: 1, window: 1 });
        let least = least.map_or_else(|| "too many".to_owned(), |bytes| bytes.to_string());
        let detail = format!(
            "{URL} = {} does not fit: one step of one environment could have {least} bytes in a message, the limit is \
             {limit}; its observations and its state must be smaller",
            resolved.plain(URL)
        );
        return refused(URL, detail);
    };
    let sizes = [
        (keys::PER_SLOT, now.per_slot, fitting.per_slot),
        (MESSAGE, now.message, fitting.message),
        (WINDOW, now.window, fitting.window),
    ];
    // Steps of a message that the user did not give follow.
    let is_free = |key: &str| key == MESSAGE && !resolved.is_given(MESSAGE);
    let mut changed = sizes.into_iter().filter(|(key, now, fits)| now != fits && !is_free(key));
    let set = changed.clone().map(|(key, _, fits)| format!("{key}={fits}"));
    let set = set.collect::<Vec<_>>().join(" ");
    let (key, value, _) = changed.next().unwrap_or(sizes[1]);
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

    fn sizes(observed: usize, per_slot: usize) -> Option<(usize, usize, usize)> {
        let now = Sizes { per_slot, message: 50, window: 10 };
        let found = largest(&run(observed), now, (20, 50))?;
        Some((found.per_slot, found.message, found.window))
    }

    #[test]
    fn messages_shrink_before_slots_and_slots_before_sequences() {
        // A row has 16 bytes for each feature that both agents observe, the limit is 4 MiB.
        assert_eq!(sizes(3_000, 1), Some((1, 50, 10)));
        assert_eq!(sizes(20_000, 1), Some((1, 10, 10)));
        assert_eq!(sizes(3_000, 10), Some((5, 10, 10)));
        assert_eq!(sizes(84 * 84 * 4, 1), Some((1, 5, 5)));
        assert_eq!(sizes(300_000, 1), None);
    }

    fn refusal(settings: &[&str], observed: usize) -> String {
        let config = config(settings);
        let now = Sizes::of(&config);
        let run = run(observed);
        refused(&config, &run, (now, largest(&run, now, (20, 50)))).to_string()
    }

    #[test]
    fn a_refusal_names_the_setting_the_value_that_fits_and_who_gave_it() {
        assert_eq!(
            refusal(&["environments.per_slot=10"], 3_000),
            "command line: environments.per_slot = 10 does not fit this environment: messages could be \
             larger than 4177920 bytes; set environments.per_slot=5"
        );
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
