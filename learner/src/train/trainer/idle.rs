//! Advice for a run with more actor threads than slots: each slot has one thread at a time, so the others have no work.

use crate::config::{EnvironmentsConfig, slot_size};

/// Number of `actors` that cannot have a slot, and what limits the slots; `None` if there can be enough.
pub(super) fn advice(actors: u64, environments: &EnvironmentsConfig) -> Option<String> {
    let slots = environments.most_slots() as u64;
    let idle = actors.checked_sub(slots).filter(|idle| *idle > 0)?;
    let count = environments.count;
    let all = match count {
        1 => "1 environment".to_owned(),
        _ => format!("{count} environments"),
    };
    let more = "set a larger environments.count in a new run, which changes its results";
    let (limit, remedy) = match environments.per_slot {
        0 | 1 => (format!("the run has {all}, and a slot has at least one"), more.to_owned()),
        fixed => {
            let threads = usize::try_from(actors).unwrap_or(usize::MAX);
            let cut = count / slot_size(count, threads, 0);
            let rest = if cut < threads { format!("; for more, {more}") } else { String::new() };
            (
                format!("environments.per_slot={fixed} cuts the {all} into {slots} slots"),
                format!(
                    "resume with environments.per_slot=0, which makes {cut} with the same results{rest}"
                ),
            )
        }
    };
    let have = if idle == 1 { "has" } else { "have" };
    Some(format!(
        "{idle} of {actors} actor threads {have} no slot: {limit}; {remedy}, or start fewer threads"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Phase;

    fn environments(per_slot: usize) -> EnvironmentsConfig {
        let (steps, message_steps, phase) = (200, 50, Phase::Staggered);
        EnvironmentsConfig { count: 20, steps, per_slot, message_steps, phase }
    }

    #[test]
    fn threads_without_a_slot_are_counted_with_what_limits_the_slots() {
        let fixed = "environments.per_slot=2 cuts the 20 environments into 10 slots; resume with \
                     environments.per_slot=0, which makes 20 with the same results";
        let one = "the run has 20 environments, and a slot has at least one";
        let more = "set a larger environments.count in a new run, which changes its results";
        for (threads, per_slot, line) in [
            (16, 2, format!("6 of 16 actor threads have no slot: {fixed}")),
            (24, 2, format!("14 of 24 actor threads have no slot: {fixed}; for more, {more}")),
            (24, 0, format!("4 of 24 actor threads have no slot: {one}; {more}")),
            (24, 1, format!("4 of 24 actor threads have no slot: {one}; {more}")),
        ] {
            let line = format!("{line}, or start fewer threads");
            assert_eq!(advice(threads, &environments(per_slot)), Some(line));
        }
        assert_eq!(advice(10, &environments(2)), None, "every thread can have a slot");
        assert_eq!(advice(20, &environments(0)), None, "every thread can have a slot");
    }
}
