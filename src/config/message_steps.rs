//! The steps of a message, which follow the steps of a slot unless the user gives them.

use toml::Value;

use super::resolved::Resolved;

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
    let (Some(slot), Some(window), Some(now)) =
        (resolved.whole(SLOT), resolved.whole(WINDOW), resolved.whole(MESSAGE))
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

/// Sets the steps of a message.
pub(crate) fn set(resolved: &mut Resolved, steps: u64) {
    // All callers choose at most the steps of an iteration, a setting.
    let steps = i64::try_from(steps).unwrap_or(i64::MAX);
    resolved.set(MESSAGE, Value::Integer(steps), SLOT);
}

#[cfg(test)]
mod tests {
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
            refusal(&["algorithm=maddpg", "policy.backpropagation_steps=7"]),
            "command line: policy.backpropagation_steps = 7 does not fit: environments.steps = 50 is out of \
             range: a multiple of policy.backpropagation_steps = 7"
        );
        assert_eq!(
            refusal(&["environments.steps=40", "environments.message_steps=60"]),
            "command line: environments.message_steps = 60 is out of range: 1 to environments.steps = 40"
        );
    }
}
