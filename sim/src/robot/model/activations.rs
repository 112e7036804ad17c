//! Activations of actuators.

use super::super::activation::{Activation, ActivationKind};
use super::super::document::Element;
use super::context::Context;

/// Shortest time constant of a filter, s.
const SHORTEST_SECS: f64 = 1e-6;

/// Reads the activation of an actuator; `None` if its gain multiplies the control.
pub(super) fn read(element: &Element, context: &Context) -> Result<Option<Activation>, String> {
    let word = |name| element.text(name).unwrap_or("none");
    let (attribute, kind) = match (element.tag.as_str(), word("dyntype")) {
        ("position", _) => ("timeconst", ActivationKind::ExactFilter),
        ("general", "integrator") => ("dynprm", ActivationKind::Integrator),
        ("general", "filter") => ("dynprm", ActivationKind::Filter),
        ("general", "filterexact") => ("dynprm", ActivationKind::ExactFilter),
        ("general", "none") | ("motor" | "velocity", _) => return Ok(None),
        (_, kind) => {
            let reason = format!(
                "dyntype=\"{kind}\" is not supported; set none, integrator, filter or filterexact"
            );
            return Err(element.refuse_for("dyntype", reason));
        }
    };
    let time_constant_secs = match element.list(attribute)?.as_deref() {
        None | Some([]) if attribute == "timeconst" => 0.0,
        None | Some([]) => 1.0,
        Some([first, ..]) => *first,
    };
    if attribute == "timeconst" && time_constant_secs == 0.0 {
        return Ok(None);
    }
    if kind != ActivationKind::Integrator && time_constant_secs < SHORTEST_SECS {
        let reason =
            format!("`{attribute}` must start with a time constant of at least {SHORTEST_SECS} s");
        return Err(element.refuse_for(attribute, reason));
    }
    let stated = element.numbers::<2>("actrange")?;
    let limited = element.flag("actlimited")?;
    let limited = limited.unwrap_or(context.options.autolimits && stated.is_some());
    let range = stated.filter(|_| limited).map(|range| range.map(|end| end as f32));
    if limited && range.is_none_or(|[low, high]| low >= high) {
        let reason =
            "`actrange` must have a lower and a higher end; set it, or actlimited=\"false\"";
        return Err(element.refuse_for("actrange", reason));
    }
    let is_early = element.flag("actearly")? == Some(true);
    let time_constant_secs = time_constant_secs as f32;
    Ok(Some(Activation { kind, time_constant_secs, range, is_early }))
}
