//! Reports that simulated environments diverge: each such step ends an episode early, and a policy learns from what is left.

use crate::train::trainer::RunningTrainer;

/// Share of an iteration's steps above which divergence is an error: few episodes reach their end.
const SEVERE: f64 = 0.01;

/// Counts the iterations in which environments diverged.
#[derive(Debug, Default)]
pub(super) struct Divergence {
    iterations: u64,
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

impl RunningTrainer {
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
