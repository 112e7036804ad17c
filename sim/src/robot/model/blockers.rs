//! What of a model cannot be built, collected over the whole document, so that one message names everything.

use std::cell::RefCell;
use std::collections::BTreeSet;

use super::super::document::Element;

/// Most reasons in a message.
const MOST_SHOWN: usize = 20;

/// Reasons why a model cannot be built.
#[derive(Debug, Default)]
pub(super) struct Blockers(RefCell<Reasons>);

#[derive(Debug, Default)]
struct Reasons {
    /// The first of them, in their order.
    shown: Vec<String>,
    /// What distinguishes all of them: the reason, or the default that causes it.
    causes: BTreeSet<String>,
}

impl Blockers {
    /// Notes a reason; an empty one follows from another.
    pub(super) fn note(&self, reason: String) {
        if reason.is_empty() {
            return;
        }
        // A default that cannot be built is one reason, however many elements it applies to.
        let cause = reason.split("; it is the default of").next().unwrap_or_default();
        let mut reasons = self.0.borrow_mut();
        if reasons.causes.insert(cause.to_owned()) && reasons.shown.len() < MOST_SHOWN {
            reasons.shown.push(reason);
        }
    }

    /// The value; an error is noted.
    pub(super) fn keep<T>(&self, result: Result<T, String>) -> Option<T> {
        result.map_err(|reason| self.note(reason)).ok()
    }

    /// One number of an element; the default in place of an error, which is noted.
    pub(super) fn number(&self, element: &Element, name: &str, default: f64) -> f64 {
        self.keep(element.number(name, default)).unwrap_or(default)
    }

    /// Whether nothing was noted. What follows from a missing part is not worth a message.
    pub(super) fn is_empty(&self) -> bool {
        self.0.borrow().causes.is_empty()
    }

    /// All reasons as one error. Several have numbers, and lines of their own, which a log may join.
    pub(super) fn finish(&self) -> Result<(), String> {
        let reasons = self.0.borrow();
        let (shown, count) = (&reasons.shown, reasons.causes.len());
        match shown.as_slice() {
            [] => return Ok(()),
            [reason] if count == 1 => return Err(reason.clone()),
            _ => {}
        }
        let numbered = (1..).zip(shown).map(|(number, reason)| format!("({number}) {reason}"));
        let mut lines: Vec<String> = numbered.collect();
        if count > shown.len() {
            lines.push(format!("and {} more", count - shown.len()));
        }
        Err(format!("{count} things are not supported:\n  {}", lines.join(";\n  ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twenty_reasons_are_named_and_the_rest_is_counted() {
        let blockers = Blockers::default();
        assert_eq!(blockers.finish(), Ok(()));
        (0..23).for_each(|line| blockers.note(format!("line {line}")));
        blockers.note("line 3".to_owned());
        let text = blockers.finish().unwrap_err();
        let start = "23 things are not supported:\n  (1) line 0;\n  (2) line 1;\n";
        assert!(text.starts_with(start), "{text}");
        assert!(text.ends_with(";\n  (20) line 19;\n  and 3 more"), "{text}");
    }

    #[test]
    fn a_default_that_applies_to_several_elements_is_one_reason() {
        let blockers = Blockers::default();
        for joint in ["a", "b"] {
            blockers.note(format!("line 2, <joint>: no; it is the default of line 9, <{joint}>"));
        }
        assert_eq!(blockers.finish().unwrap_err().matches("line 2").count(), 1);
    }
}
