//! Advice for a run with more actor threads than slots: each slot has one thread at a time, so the others have no work.

use crate::config::EnvironmentsConfig;

/// Number of `actors` that cannot have a slot, and what to set in a new run; `None` if there are enough slots.
pub(super) fn advice(actors: u64, environments: &EnvironmentsConfig) -> Option<String> {
    let slots = environments.slots() as u64;
    let idle = actors.checked_sub(slots).filter(|idle| *idle > 0)?;
    let more = match environments.per_slot {
        1 => "a larger environments.count".to_owned(),
        _ => {
            let most = environments.count;
            format!(
                "environments.per_slot=1 ({most} slots, same results) or a larger environments.count"
            )
        }
    };
    Some(format!(
        "{idle} of {actors} actor threads have no slot: there are {slots} slots; set {more} in \
         a new run, or start fewer threads"
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
    fn threads_without_a_slot_are_counted_with_the_setting_that_gives_them_one() {
        assert_eq!(
            advice(24, &environments(2)).unwrap(),
            "14 of 24 actor threads have no slot: there are 10 slots; set environments.per_slot=1 \
             (20 slots, same results) or a larger environments.count in a new run, or start fewer threads"
        );
        let line = advice(24, &environments(1)).unwrap();
        assert!(line.contains("there are 20 slots; set a larger environments.count in"), "{line}");
    }

    #[test]
    fn there_is_no_advice_while_every_thread_can_have_a_slot() {
        assert_eq!(advice(10, &environments(2)), None);
    }
}
