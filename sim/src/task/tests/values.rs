//! Tests of values of task files that are of another type or without an effect.

use super::*;

#[test]
fn values_of_another_type_are_refused_with_what_to_write() {
    for (from, to, part) in [
        (
            "[start]\n",
            "[start]\ncoordinates = { root.z = 0.7 }\n",
            "if it is a name with a dot, quote it: \"root.z\"",
        ),
        (
            "positions = { uniform = 0.005 }",
            "positions = { uniform = 0.1, normal = 0.1 }",
            "expected only one of uniform and normal",
        ),
        (
            "[start]\n",
            "[disturbance]\naction_delay = [1.5, 2]\n[start]\n",
            "expected a whole number from 0 to 20",
        ),
    ] {
        let reason = refusal(&changed(from, to));
        assert!(reason.contains(part), "{reason}");
    }
}

/// The hip turns from -0.5 to 1.5 rad; a state ends 3 rad beyond.
#[test]
fn bounds_that_a_joint_never_reaches_are_refused() {
    let added = |lines: &str| format!("{HOPPER}\n{lines}");
    for (file, part) in [
        (
            added("[[healthy]]\ncoordinate = \"hip\"\nabove = -20"),
            "healthy.hip.above = -20 has no effect, since the number is always in -3.5..=4.5 (a joint's limits, 3 rad or m wider); remove",
        ),
        (
            added("[[healthy]]\nfeature = \"hip.position\"\nbelow = 20"),
            "healthy.hip.position.below = 20 has no effect",
        ),
        (
            added(
                "[[reward]]\nterm = \"in_range\"\nweight = 1\ncoordinate = \"hip\"\nrange = [-20, 20]",
            ),
            "reward.in_range is constant, because the coordinate is always in -3.5..=4.5 (a joint's limits, 3 rad or m wider); change its range",
        ),
        (
            added(
                "[[reward]]\nterm = \"in_range\"\nweight = 1\ncoordinate = \"hip\"\nrange = [20, 30]",
            ),
            "reward.in_range is constant",
        ),
    ] {
        let reason = refusal(&file);
        assert!(reason.contains(part), "{reason}");
    }
}
