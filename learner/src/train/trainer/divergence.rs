//! Reports that simulated environments diverge: each such step ends an episode early, and a policy learns from what is left. Also
//! reports that the update diverges: steps with a gradient that is not finite are skipped.

use crate::observe::event::IterationReport;
use crate::train::trainer::RunningTrainer;

/// Share of an iteration's steps above which divergence is an error: few episodes reach their end.
const SEVERE: f64 = 0.01;

/// Counts the iterations in which environments diverged.
#[derive(Debug, Default)]
pub(super) struct Divergence {
    iterations: u64,
    /// Whether a divergence of the update has been reported.
    update_reported: bool,
}

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Severity {
    /// Some episodes are cut.
    Some,
    /// Few episodes reach their end.
    Severe,
}

impl Divergence {
    /// The line about an iteration of `steps` environment steps, of which `faults` diverged; `None` without a fault, and if
    /// the last line is recent: it comes with the iterations 1, 2, 4, 8 and so on that have faults.
    pub(super) fn report(
        &mut self,
        iteration: u64,
        (faults, steps): (u64, u64),
        remedy: &str,
    ) -> Option<(Severity, String)> {
        if faults == 0 {
            return None;
        }
        self.iterations += 1;
        let severity =
            if faults as f64 > SEVERE * steps as f64 { Severity::Severe } else { Severity::Some };
        let line = format!(
            "the simulation diverged in {faults} of the {steps} environment steps of iteration {iteration}: the robot's \
             state left its bounds, which ended the episodes early (environment_faults); {remedy}"
        );
        self.iterations.is_power_of_two().then_some((severity, line))
    }
}

/// The line about figures of an iteration that show a divergence of the update; `None` without one.
fn instability(report: &IterationReport) -> Option<String> {
    let shows = |(name, value): &&(String, f64)| {
        let skipped = name.contains("skipped") && *value > 0.0;
        skipped || name.ends_with("_loss") && !value.is_finite()
    };
    let mut figures = report.metrics.iter().filter(shows);
    let (name, value) = figures.next()?;
    let others = match figures.count() {
        0 => String::new(),
        count => format!(" and {count} others like it"),
    };
    let iteration = report.iteration;
    Some(format!(
        "the update diverges: after iteration {iteration} {name} is {value}{others} (metrics.jsonl); optimiser steps whose \
         gradient is not finite are skipped; lower update.learning_rate, critic.learning_rate or influence.learning_rate"
    ))
}

impl RunningTrainer {
    /// Logs once that the update diverges.
    pub(super) fn report_instability(&mut self, report: &IterationReport) {
        let line = instability(report).filter(|_| !self.divergence.update_reported);
        if let Some(line) = line {
            tracing::warn!("{line}");
            self.divergence.update_reported = true;
        }
    }

    /// Logs that simulated environments diverged in the iteration just finished.
    pub(super) fn report_divergence(&mut self) {
        let trainer = &self.trainer;
        let remedy = &trainer.launch.divergence_remedy;
        if remedy.is_empty() {
            // An external environment may have its own time limit; reaching it is not a fault.
            return;
        }
        let steps = trainer.launch.config.environments.steps_per_iteration();
        let faults = (trainer.environments.faults, steps);
        match self.divergence.report(trainer.iteration, faults, remedy) {
            Some((Severity::Severe, line)) => tracing::error!("{line}"),
            Some((Severity::Some, line)) => tracing::warn!("{line}"),
            None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skipped_steps_and_losses_that_are_not_finite_show_a_divergence_of_the_update() {
        let line = |metrics: &[(&str, f64)]| {
            let metrics =
                metrics.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
            instability(&IterationReport { iteration: 3, metrics, ..IterationReport::default() })
        };
        let fine = [("losses/value_loss", 4e44), ("agent0/skipped_steps", 0.0)];
        assert_eq!(line(&fine), None);
        assert_eq!(line(&[("agent0/explained_variance", f64::NAN)]), None);
        for (name, value, shown) in [
            ("losses/value_skipped_steps", 498.0, "losses/value_skipped_steps is 498 ("),
            ("losses/update_skipped", 1.0, "losses/update_skipped is 1 ("),
            ("losses/value_loss", f64::NAN, "losses/value_loss is NaN ("),
        ] {
            let found = line(&[(name, value)]).unwrap();
            assert!(found.contains(&format!("after iteration 3 {shown}")), "{found}");
        }
        let two = line(&[("agent0/skipped_steps", 1.0), ("agent1/skipped_steps", 2.0)]).unwrap();
        assert!(two.contains("agent0/skipped_steps is 1 and 1 others like it"), "{two}");
    }

    #[test]
    fn faults_are_reported_at_once_and_then_less_and_less_often() {
        let mut divergence = Divergence::default();
        assert_eq!(divergence.report(1, (0, 200), "lower it"), None);
        let (severity, line) = divergence.report(2, (200, 200), "lower it").unwrap();
        assert_eq!(severity, Severity::Severe);
        assert!(line.contains("200 of the 200 environment steps of iteration 2"), "{line}");
        assert!(line.ends_with("; lower it"), "{line}");
        let reported = (3..10).filter(|k| divergence.report(*k, (1, 200), "").is_some());
        assert_eq!(reported.collect::<Vec<_>>(), [3, 5, 9]);
        assert_eq!(Divergence::default().report(1, (1, 200), "").unwrap().0, Severity::Some);
    }
}
