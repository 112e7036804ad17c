//! A complete environment state and its encoding, which actors exchange and checkpoints store.
//!
//! Little-endian: `s2st`, layout version u32, FNV-1a of the state's kind u32, episode u64, step u32, limit u32,
//! coordinates f32 `[nq]`, velocities f32 `[nv]`, activations f32 `[m]`, last actions f32 `[k, A]`, earlier measurements f32 `[d, M]`. If the
//! task draws a command or disturbances, then the episode's key (32 bytes) and u32 1 if it is disturbed, else 0.

use proto::EpisodePosition;

use crate::error::StateError;

const MARK: &[u8; 4] = b"s2st";
const HEADER_BYTES: usize = 28;
const DRAWS_BYTES: usize = 36;

/// Version of the layout above.
pub(crate) const STATE_VERSION: u32 = 1;

/// Largest action of the last step, as in trajectories: beyond it, a reward of the next step would not be finite.
pub(crate) const LARGEST_ACTION: f32 = 1e9;
/// Largest error of the squared length of an orientation's quaternion.
const LARGEST_DRIFT: f32 = 1e-3;

/// Largest measurement of an earlier step, m, rad, m/s or rad/s; larger ones are clipped.
pub(crate) const LARGEST_MEASUREMENT: f32 = 1e9;

/// What the draws of an episode follow from, besides the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EpisodeDraws {
    /// The key of its reset.
    pub key: [u8; 32],
    /// Whether the task's disturbances act.
    pub is_disturbed: bool,
}

/// Complete state from which an environment continues.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Position in the episode.
    pub position: EpisodePosition,
    /// Generalised coordinates relative to the model's rest pose `[nq]`, m and rad, in the order of
    /// [`crate::Robot::coordinate_names`].
    pub coordinates: Vec<f32>,
    /// Generalised velocities `[nv]`, m/s and rad/s, in the order of [`crate::Robot::velocity_names`].
    pub velocities: Vec<f32>,
    /// Activations of the actuators that have one, in the order of the model `[m]`.
    pub activations: Vec<f32>,
    /// Controls of the last `k` steps, the newest first, not clamped to their ranges, in the order of the joint action, `[k, A]`; at the
    /// start those of action 0. `k` is 0 unless the task's reward or its delays read them.
    pub actions: Vec<f32>,
    /// Measurements in the `d` steps before, the newest first, `[d, M]`, m, rad, m/s and rad/s; at the start the first
    /// one. `d` is 0 unless the task delays observations.
    pub measurements: Vec<f32>,
    /// `None` unless the task draws a command or disturbances.
    pub draws: Option<EpisodeDraws>,
}

/// Bounds of a state of a robot in a task.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateBounds {
    /// Kind of the state, such as `rapier/halfcheetah`.
    pub kind: String,
    /// Episode limit of the task.
    pub longest: u32,
    /// Lowest and highest value of each coordinate, `[nq]`.
    pub coordinates: Vec<[f32; 2]>,
    /// Whether all coordinates are whole numbers.
    pub is_whole: bool,
    /// Number of velocities `nv`.
    pub velocities: usize,
    /// Lowest and highest value of each activation, `[m]`.
    pub activations: Vec<[f32; 2]>,
    /// Largest velocity, m/s or rad/s.
    pub fastest: f32,
    /// Number of actions of the last steps `k A`.
    pub actions: usize,
    /// Number of measurements `d M`.
    pub measurements: usize,
    /// Whether the task draws a command or disturbances.
    pub has_draws: bool,
    /// First coordinate of each unit quaternion.
    pub orientations: Vec<usize>,
}

impl State {
    /// Encodes the state.
    pub fn to_bytes(&self, kind: &str) -> Vec<u8> {
        let EpisodePosition { episode, step, limit } = self.position;
        let motion = || self.coordinates.iter().chain(&self.velocities);
        let states = || motion().chain(&self.activations);
        let numbers = || states().chain(&self.actions).chain(&self.measurements);
        let mut bytes = Vec::with_capacity(HEADER_BYTES + 4 * numbers().count() + DRAWS_BYTES);
        bytes.extend_from_slice(MARK);
        bytes.extend_from_slice(&STATE_VERSION.to_le_bytes());
        bytes.extend_from_slice(&fnv1a(kind).to_le_bytes());
        bytes.extend_from_slice(&episode.to_le_bytes());
        bytes.extend_from_slice(&step.to_le_bytes());
        bytes.extend_from_slice(&limit.to_le_bytes());
        for value in numbers() {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        if let Some(EpisodeDraws { key, is_disturbed }) = self.draws {
            bytes.extend_from_slice(&key);
            bytes.extend_from_slice(&u32::from(is_disturbed).to_le_bytes());
        }
        bytes
    }

    /// Decodes a state. The checks run in this order: length, magic bytes, version, kind, limit, step, numbers, draws.
    pub fn from_bytes(bytes: &[u8], bounds: &StateBounds) -> Result<Self, StateError> {
        let expected = bounds.bytes();
        if bytes.len() != expected {
            let (got, kind) = (bytes.len(), &bounds.kind);
            return invalid(format!("it has {got} bytes; a state of {kind} has {expected}"));
        }
        bounds.check_header(bytes)?;
        let end = if bounds.has_draws { expected - DRAWS_BYTES } else { expected };
        let (body, draws) = bytes.split_at(end);
        let numbers: Vec<f32> =
            body[HEADER_BYTES..].chunks_exact(4).map(|b| f32::from_le_bytes(array(b))).collect();
        let (coordinates, rest) = numbers.split_at(bounds.coordinates.len());
        let (velocities, rest) = rest.split_at(bounds.velocities);
        let (activations, rest) = rest.split_at(bounds.activations.len());
        let (actions, measurements) = rest.split_at(bounds.actions);
        let mut state = Self {
            position: EpisodePosition {
                episode: u64::from_le_bytes(array(&bytes[12..20])),
                step: u32::from_le_bytes(array(&bytes[20..24])),
                limit: u32::from_le_bytes(array(&bytes[24..28])),
            },
            coordinates: coordinates.to_vec(),
            velocities: velocities.to_vec(),
            activations: activations.to_vec(),
            actions: actions.to_vec(),
            measurements: measurements.to_vec(),
            draws: None,
        };
        bounds.check_position(state.position)?;
        bounds.check_motion(&state.coordinates, &state.velocities)?;
        for (index, (&value, &[low, high])) in
            activations.iter().zip(&bounds.activations).enumerate()
        {
            check_number("activation", index, value, low, high)?;
        }
        check_all("action", &state.actions, LARGEST_ACTION)?;
        check_all("measurement", &state.measurements, LARGEST_MEASUREMENT)?;
        if bounds.has_draws {
            state.draws = Some(EpisodeDraws::from_bytes(draws)?);
        }
        Ok(state)
    }
}

impl EpisodeDraws {
    fn from_bytes(bytes: &[u8]) -> Result<Self, StateError> {
        let (key, word) = bytes.split_at(32);
        let is_disturbed = match u32::from_le_bytes(array(word)) {
            0 => false,
            1 => true,
            got => {
                let what = "the number that says whether it is disturbed";
                return invalid(format!("{what} is {got}, not 0 or 1"));
            }
        };
        Ok(Self { key: array(key), is_disturbed })
    }
}

/// Divides a quaternion by its length.
pub(crate) fn normalise(quaternion: &mut [f32]) {
    let length = quaternion.iter().map(|q| q * q).sum::<f32>().sqrt();
    quaternion.iter_mut().for_each(|q| *q /= length);
}

impl StateBounds {
    /// Encoded size in bytes.
    pub fn bytes(&self) -> usize {
        let motion = self.coordinates.len() + self.velocities + self.activations.len();
        let draws = if self.has_draws { DRAWS_BYTES } else { 0 };
        HEADER_BYTES + 4 * (motion + self.actions + self.measurements) + draws
    }

    /// Checks that all coordinates and velocities are finite and within bounds.
    pub(crate) fn check_motion(
        &self,
        coordinates: &[f32],
        velocities: &[f32],
    ) -> Result<(), StateError> {
        for (index, (&value, &[low, high])) in coordinates.iter().zip(&self.coordinates).enumerate()
        {
            check_number("coordinate", index, value, low, high)?;
            if self.is_whole && value.fract() != 0.0 {
                return invalid(format!("coordinate {index} is {value}, not a whole number"));
            }
        }
        for (index, &value) in velocities.iter().enumerate() {
            check_number("velocity", index, value, -self.fastest, self.fastest)?;
        }
        for &index in &self.orientations {
            let squared: f32 = coordinates[index..index + 4].iter().map(|q| q * q).sum();
            if (squared - 1.0).abs() > LARGEST_DRIFT {
                let place = format!("the orientation at coordinate {index}");
                return invalid(format!("{place} has squared length {squared}, not 1"));
            }
        }
        Ok(())
    }

    /// Normalises orientations whose squared length has drifted by half of what [`Self::check_motion`] allows: their rounding
    /// errors add up while a body turns steadily. Returns whether there was one.
    pub(crate) fn normalise_drifted(&self, coordinates: &mut [f32]) -> bool {
        let mut drifted = false;
        for &index in &self.orientations {
            let quaternion = &mut coordinates[index..index + 4];
            let squared: f32 = quaternion.iter().map(|q| q * q).sum();
            if (squared - 1.0).abs() > 0.5 * LARGEST_DRIFT {
                normalise(quaternion);
                drifted = true;
            }
        }
        drifted
    }

    fn check_header(&self, bytes: &[u8]) -> Result<(), StateError> {
        if &bytes[..4] != MARK {
            return invalid("it does not start with the magic bytes of a state".to_owned());
        }
        let version = u32::from_le_bytes(array(&bytes[4..8]));
        if version != STATE_VERSION {
            let own = STATE_VERSION;
            return invalid(format!("its layout version is {version}; this program reads {own}"));
        }
        if u32::from_le_bytes(array(&bytes[8..12])) != fnv1a(&self.kind) {
            return invalid(format!("it is not a state of {}", self.kind));
        }
        Ok(())
    }

    fn check_position(&self, position: EpisodePosition) -> Result<(), StateError> {
        let EpisodePosition { step, limit, .. } = position;
        if limit == 0 || limit > self.longest {
            let longest = self.longest;
            return invalid(format!("its episode limit is {limit}; it must be 1 to {longest}"));
        }
        if step >= limit {
            return invalid(format!("its episode is over: step {step} of {limit}"));
        }
        Ok(())
    }
}

/// Checks that all values are finite and between `-largest` and `largest`.
fn check_all(field: &str, values: &[f32], largest: f32) -> Result<(), StateError> {
    let mut values = values.iter().enumerate();
    values.try_for_each(|(index, &value)| check_number(field, index, value, -largest, largest))
}

fn check_number(
    field: &str,
    index: usize,
    value: f32,
    low: f32,
    high: f32,
) -> Result<(), StateError> {
    if !value.is_finite() {
        return invalid(format!("{field} {index} is not finite"));
    }
    if value < low || value > high {
        let range = format!("it must be between {low} and {high}");
        return invalid(format!("{field} {index} is {value}; {range}"));
    }
    Ok(())
}

fn invalid<T>(why: String) -> Result<T, StateError> {
    Err(StateError(why))
}

fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.try_into().expect("the slice was cut to this length")
}

fn fnv1a(text: &str) -> u32 {
    text.bytes().fold(0x811c_9dc5, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}
