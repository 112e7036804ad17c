//! Activations of actuators.

use super::super::activation::{Activation, ActivationKind};
use super::super::document::{Element, bounds};
use super::context::Context;

/// Reads the activation of an actuator; `None` if its gain multiplies the control.
pub(super) fn read(element: &Element, context: &Context) -> Result<Option<Activation>, String> {
    let range = context.range(element, ["actrange", "actlimited"])?;
    let kinds = [
        ("none", None),
        ("integrator", Some(ActivationKind::Integrator)),
        ("filter", Some(ActivationKind::Filter)),
        ("filterexact", Some(ActivationKind::ExactFilter)),
    ];
    let kind = match (element.word("dyntype", &kinds)?, range) {
        (Some(kind), _) => kind,
        (None, None) => return Ok(None),
        (None, Some(_)) => {
            let reason = "an `actrange` needs an activation; remove it, or set `dyntype`";
            return Err(element.refuse_for("actrange", reason));
        }
    };
    let time_constant_secs = element.list("dynprm")?.map_or(1.0, |numbers| numbers[0]);
    if kind != ActivationKind::Integrator {
        let zero = || (time_constant_secs == 0.0).then(|| "must not be 0".to_owned());
        if let Some(reason) = bounds::refusal("timeconst", time_constant_secs).or_else(zero) {
            let reason = format!("the time constant at the start of `dynprm` {reason}");
            return Err(element.refuse_for("dynprm", reason));
        }
    }
    let range = range.map(|range| range.map(|end| end as f32));
    let is_early = element.flag("actearly")? == Some(true);
    let time_constant_secs = time_constant_secs as f32;
    Ok(Some(Activation { kind, time_constant_secs, range, is_early }))
}
