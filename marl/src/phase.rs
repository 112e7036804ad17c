//! Who wants to know in which part of an update the time goes. Nothing here reads a clock: an observer
//! that does brings its own.

/// A part of an on-policy update, in the order in which they begin; the last two run side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    /// The critic values every state.
    Values,
    /// Generalised advantages and returns.
    Advantages,
    /// The behaviour weights are asked about every row.
    Behaviour,
    /// Posteriors learn the actions taken.
    Posteriors,
    /// Policies climb Eq. (10).
    Sweep,
    /// The critic learns the returns.
    Critic,
}

/// Is told when parts of an update begin and end, from the threads that compute them.
pub trait PhaseObserver: Send + Sync {
    /// `phase` begins.
    fn begin(&self, phase: Phase);

    /// `phase` has ended.
    fn end(&self, phase: Phase);
}

/// Listens to nothing.
pub(crate) struct Nobody;

impl PhaseObserver for Nobody {
    fn begin(&self, _phase: Phase) {}

    fn end(&self, _phase: Phase) {}
}

/// What `work` gives, its beginning and its end told to `observer`.
pub(crate) fn during<T>(observer: &dyn PhaseObserver, phase: Phase, work: impl FnOnce() -> T) -> T {
    observer.begin(phase);
    let result = work();
    observer.end(phase);
    result
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use policy::RunSeed;

    use super::*;
    use crate::{algorithm, probe};

    #[derive(Default)]
    struct Told(Mutex<Vec<(Phase, &'static str)>>);

    impl PhaseObserver for Told {
        fn begin(&self, phase: Phase) {
            self.0.lock().expect("nobody panics").push((phase, "begins"));
        }

        fn end(&self, phase: Phase) {
            self.0.lock().expect("nobody panics").push((phase, "ends"));
        }
    }

    #[test]
    fn on_one_thread_an_update_tells_its_six_parts_one_after_the_other() {
        let (problem, batch) = (probe::problem(), probe::batch());
        let built = algorithm::build(&probe::config(), &probe::policy(), &problem, RunSeed(0));
        let mut algorithm = built.expect("the probe's settings fit");
        let told = Arc::new(Told::default());
        algorithm.observe_phases(Arc::clone(&told) as Arc<dyn PhaseObserver>);
        let rewards = vec![batch.reward.clone(); problem.agents.len()];
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
        pool.install(|| algorithm.update(&batch, &rewards, 0)).expect("the probe's batch fits");
        let parts = [
            Phase::Values,
            Phase::Advantages,
            Phase::Behaviour,
            Phase::Posteriors,
            Phase::Sweep,
            Phase::Critic,
        ];
        let expected: Vec<_> =
            parts.into_iter().flat_map(|part| [(part, "begins"), (part, "ends")]).collect();
        assert_eq!(*told.0.lock().expect("nobody panics"), expected);
    }
}
