//! What agents observe of the global state if a task disturbs their sensors: bias, noise and delay of the measured features.

use crate::robot::Robot;
use crate::state::{LARGEST_MEASUREMENT, State};
use crate::task::{DrawnEpisode, Rules};

/// The sensors of one environment.
pub(super) struct Sensors {
    /// Measurement of the current state, `[M]`.
    pub(super) measured: Vec<f32>,
    /// The global state with the measurement that the agents observe, `[S]`.
    pub(super) observed: Vec<f32>,
}

impl Sensors {
    /// Sensors of a task; `None` if it does not disturb them.
    pub(super) fn of(rules: &Rules, robot: &Robot) -> Option<Self> {
        let measured = vec![0.0; rules.measured_features(robot).len()];
        rules.disturbance.change_sensors().then_some(Self { measured, observed: Vec::new() })
    }

    /// Measures the global state `seen` of the state `now`. At the start of an episode, all earlier measurements are the first
    /// one.
    pub(super) fn measure(
        &mut self,
        rules: &Rules,
        now: &mut State,
        drawn: &DrawnEpisode,
        seen: &[f32],
    ) {
        let count = self.measured.len();
        self.measured.copy_from_slice(&seen[..count]);
        if let Some(draws) = &now.draws {
            let step = now.position.step;
            rules.disturbance.measure(draws, step, &drawn.bias, &mut self.measured);
        }
        let largest = LARGEST_MEASUREMENT;
        self.measured.iter_mut().for_each(|number| *number = number.clamp(-largest, largest));
        if now.position.step == 0 {
            now.measurements
                .chunks_exact_mut(count)
                .for_each(|row| row.copy_from_slice(&self.measured));
        }
        self.observed.clear();
        self.observed.extend_from_slice(seen);
        let shown = match drawn.observation_delay.checked_sub(1) {
            None => &self.measured,
            Some(back) => &now.measurements[back as usize * count..][..count],
        };
        self.observed[..count].copy_from_slice(shown);
    }
}
