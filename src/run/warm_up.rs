//! A note on a run that ends before its learning rule begins to learn, or to train policies.

use marl::config::Rule;

use crate::config::run_config::RunConfig;
use crate::figures::chart::{counted, thousands};

/// A line for a run whose rule collects transitions to its end, without an optimiser step, or that trains only critics; `None` for
/// others.
pub(crate) fn remark(config: &RunConfig) -> Option<String> {
    let replay = config.training.replay()?;
    let steps = config.env_steps();
    let learning = steps.saturating_sub(replay.warm_up);
    let updates = (replay.updates_per_step * learning as f64).floor() as u64;
    let every = config.training.hasac.as_ref().map_or(1, |own| own.policy_every);
    if updates >= every {
        return None;
    }
    if updates > 0 {
        return Some(format!(
            "note: a run of {} steps trains no policy: hasac.policy_every = {}, and it has {}; set run.env_steps above that, or \
             lower hasac.policy_every",
            thousands(steps),
            thousands(every),
            counted(updates, "optimiser step"),
        ));
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
        let rare = ["algorithm=hasac", "run.env_steps=8000", "hasac.policy_every=3001"];
        let words =
            " trains no policy: hasac.policy_every = 3,001, and it has 3,000 optimiser steps; ";
        assert!(of(&rare).unwrap().contains(words));
        assert!(of(&["algorithm=maddpg", "run.env_steps=2000", "maddpg.warm_up=2000"]).is_some());
        assert_eq!(of(&["run.env_steps=2000"]), None);
    }
}
