//! Durations of iterations, from the times of the trainer's events.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use learner::observe::event::Event;

use crate::clock::{median, process_secs};
use crate::processes::{self, children};

/// Durations of one iteration, seconds.
#[derive(Clone, Copy)]
pub(crate) struct Iteration {
    /// From the opening of its slots to the last chunk.
    pub(crate) rollout: f64,
    /// From the last chunk to the new weights.
    pub(crate) update: f64,
    /// From the end of the previous iteration to the end of this one.
    pub(crate) whole: f64,
    /// Processor time of this process and its children in the same span.
    pub(crate) processor: f64,
}

/// Medians of some iterations.
pub(crate) fn typical(iterations: &[Iteration]) -> Iteration {
    let of = |part: fn(&Iteration) -> f64| median(iterations.iter().map(part));
    Iteration {
        rollout: of(|it| it.rollout),
        update: of(|it| it.update),
        whole: of(|it| it.whole),
        processor: of(|it| it.processor),
    }
}

/// Processor time of this process and its children so far, seconds.
pub(crate) fn processor_secs() -> f64 {
    let actors = children(std::process::id()).into_iter().map(processes::processor_secs);
    process_secs() + actors.sum::<f64>()
}

/// End of an iteration: wall time and processor time so far.
type End = (Instant, f64);

/// Collects iterations; the first one only starts the measurement.
#[derive(Clone, Default)]
pub(crate) struct IterationLog(Arc<Mutex<Vec<(End, Iteration)>>>);

impl IterationLog {
    /// The observer of the trainer's events.
    pub(crate) fn observer(&self) -> learner::train::trainer::Observer {
        let log = Arc::clone(&self.0);
        Box::new(move |event| {
            let Event::Iteration(report) = event else { return };
            let mut log = log.lock().expect("no observer panics");
            let (now, used) = (Instant::now(), processor_secs());
            let unknown = (f64::NAN, f64::NAN);
            let (whole, processor) = log.last().map_or(unknown, |((before, base), _)| {
                ((now - *before).as_secs_f64(), used - base)
            });
            let (rollout, update) = (report.rollout_secs, report.update_secs);
            log.push(((now, used), Iteration { rollout, update, whole, processor }));
        })
    }

    /// All iterations but the first `cold`; `cold` is at least one.
    pub(crate) fn after(&self, cold: usize) -> Vec<Iteration> {
        let log = self.0.lock().expect("no observer panics");
        log.iter().skip(cold).map(|(_, iteration)| *iteration).collect()
    }
}
