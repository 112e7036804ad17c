//! Actuators of simulated robots: how a torque follows from a control.

use serde::Serialize;

use crate::wire;

/// An actuator, which one number of an action controls.
///
/// With the control `c`, and `q` and `v` for `gear` times the position and speed of what it acts on, the force is
/// `gain c + constant - kp q - kd v`, within `force_range`. The torque is `gear` times the force, N m; on a slide or tendon a
/// force, N. An activation takes the place of `c`. A hinge's or slide's position and speed are those that agents observe.
/// About a ball joint's axis, `q` and `v` are sums along `ball_axis`. An actuator on a site has neither `q` nor `v`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ActuatorSpec {
    /// Name of the actuator; that of its joint, unless the model states one or the joint has several.
    pub name: String,
    /// Joint, tendon or site that it acts on.
    pub joint: String,
    /// The kind of law.
    pub kind: ActuatorKind,
    /// Range to which the control is clamped.
    pub control_limits: [f32; 2],
    /// N m per unit of force.
    pub gear: f32,
    /// Force per unit of the control.
    pub gain: f32,
    /// Force without a control, position and speed.
    pub constant: f32,
    /// Stiffness: force per unit of `q`, such as N m/rad.
    pub kp: f32,
    /// Damping: force per unit of `v`, such as N m s/rad.
    pub kd: f32,
    /// Range to which the force is clamped.
    pub force_range: Option<[f32; 2]>,
    /// Range to which the joint clamps the sum of its actuators' torques, N m or N.
    pub torque_range: Option<[f32; 2]>,
    /// How the activation follows the control; `None` without one.
    pub activation: Option<ActivationKind>,
    /// Time constant of a filter, s.
    pub time_constant_secs: Option<f32>,
    /// Range to which the activation is clamped.
    pub activation_range: Option<[f32; 2]>,
    /// On a ball joint, the axis by which `gear` is multiplied, in axes of the child.
    pub ball_axis: Option<[f32; 3]>,
    /// On a site, the link on which it acts.
    pub link: Option<String>,
    /// The point at which it acts, in the link's frame, m.
    pub link_point: Option<[f32; 3]>,
    /// The force there per unit of `gear` times the force, in axes of the link, N.
    pub link_force: Option<[f32; 3]>,
    /// The torque, likewise, N m.
    pub link_torque: Option<[f32; 3]>,
}

/// Kind of an actuator's law.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ActuatorKind {
    /// The force depends on the control only.
    Motor,
    /// Servo of the position: `kp (c - q) - kd v`.
    Position,
    /// Servo of the speed: `kd (c - v)`.
    Velocity,
    /// Another law.
    General,
}

/// MuJoCo's `dyntype`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ActivationKind {
    /// `dw/dt = c`.
    Integrator,
    /// `dw/dt = (c - w) / time constant`, by the model's integrator.
    Filter,
    /// The same, exactly for a constant control.
    FilterExact,
}

impl ActuatorSpec {
    /// As a message.
    #[must_use]
    pub fn to_wire(&self) -> wire::Actuator {
        let kind = match self.kind {
            ActuatorKind::Motor => wire::ActuatorKind::Motor,
            ActuatorKind::Position => wire::ActuatorKind::Position,
            ActuatorKind::Velocity => wire::ActuatorKind::Velocity,
            ActuatorKind::General => wire::ActuatorKind::General,
        };
        let activation = match self.activation {
            None => wire::ActivationKind::Unspecified,
            Some(ActivationKind::Integrator) => wire::ActivationKind::Integrator,
            Some(ActivationKind::Filter) => wire::ActivationKind::Filter,
            Some(ActivationKind::FilterExact) => wire::ActivationKind::Filterexact,
        };
        let range = |[low, high]: [f32; 2]| wire::ControlRange { low, high };
        let numbers = |vector: Option<[f32; 3]>| vector.map(Vec::from).unwrap_or_default();
        wire::Actuator {
            name: self.name.clone(),
            joint: self.joint.clone(),
            kind: kind.into(),
            control_limits: Some(range(self.control_limits)),
            gear: self.gear,
            gain: self.gain,
            constant: self.constant,
            kp: self.kp,
            kd: self.kd,
            force_range: self.force_range.map(range),
            torque_range: self.torque_range.map(range),
            activation: activation.into(),
            time_constant_secs: self.time_constant_secs,
            activation_range: self.activation_range.map(range),
            ball_axis: numbers(self.ball_axis),
            link: self.link.clone().unwrap_or_default(),
            link_point: numbers(self.link_point),
            link_force: numbers(self.link_force),
            link_torque: numbers(self.link_torque),
        }
    }
}
