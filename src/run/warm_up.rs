//! A note on a run that ends before its learning rule begins to learn.

use marl::config::Rule;

use crate::config::run_config::RunConfig;
use crate::figures::chart::thousands;

/// A line for a run whose rule collects transitions to its end, without an optimiser step; `None` for others.
pub(crate) fn remark(config: &RunConfig) -> Option<String> {
    let replay = config.training.replay()?;
    let steps = config.env_steps();
    let learning = steps.saturating_sub(replay.warm_up);
    if replay.updates_per_step * learning as f64 >= 1.0 {
        return None;
    }
    let section = if config.training.update.rule == Rule::Hasac { "hasac" } else { "maddpg" };
    Some(format!(
        "note: a run of {} steps learns nothing: {section} learns after {section}.warm_up = {}; set run.env_steps above that, or \
         lower {section}.warm_up",
        thousands(steps),
        thousands(replay.warm_up),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_is_not_longer_than_its_warm_up_is_remarked_on() {
        let of = |settings: &[&str]| {
            let own = [&["halfcheetah-2x3"], settings].concat();
            remark(&RunConfig::with(&own).unwrap())
        };
        let line = of(&["algorithm=hasac", "run.env_steps=3000"]).unwrap();
        let words = "learns nothing: hasac learns after hasac.warm_up = 5,000; set run.env_steps";
        assert!(line.starts_with("note: a run of ") && line.contains(words), "{line}");
        assert_eq!(of(&["algorithm=hasac", "run.env_steps=8000"]), None);
        assert!(of(&["algorithm=maddpg", "run.env_steps=2000", "maddpg.warm_up=2000"]).is_some());
        assert_eq!(of(&["run.env_steps=2000"]), None);
    }
}
