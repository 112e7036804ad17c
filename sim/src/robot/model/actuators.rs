//! Actuators: motors, and servos of the position or the speed of a joint; thrusters on sites.

use std::collections::BTreeSet;

use proto::ActivationKind;
use rapier3d::glamx::DVec3;

use super::super::activation::Activation;
use super::super::blueprint::{Hinge, LinkPlan, MotorPlan, Servo};
use super::super::coupling::{Combination, TendonPlan, Thrust};
use super::super::document::{Element, bounds};
use super::bodies::Body;
use super::context::Context;
use super::links::Links;
use super::{couplings, joints};

/// What else an actuator of MuJoCo can act on.
const ELSEWHERE: [&str; 4] = ["refsite", "body", "cranksite", "slidersite"];
const KINDS: [&str; 5] = ["motor", "position", "velocity", "intvelocity", "general"];
/// `gear` unless stated.
const GEAR: [f64; 6] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
/// Parameters of a gain or bias in a document.
const MOST_PARAMETERS: usize = 10;

/// A joint or tendon that an actuator moves, or a site on which it acts.
struct Driven {
    name: String,
    moved: Combination,
    thrust: Option<Thrust>,
    /// Index of the tendon among all tendons.
    tendon: Option<usize>,
    /// Offset from this crate's position to MuJoCo's.
    reference: f64,
    /// Range of the position, and of the force.
    range: Option<[f32; 2]>,
    torque_range: Option<[f32; 2]>,
    gear: f64,
}

/// The bodies, links and tendons of a model.
type Parts<'a> = (&'a [Body], &'a Links<'a>, &'a [TendonPlan]);

/// Force of an actuator: `gain c + bias . (1, q, v)`, with MuJoCo's coordinate `q`.
struct Law {
    gain: f64,
    bias: [f64; 3],
    /// Range of the force, if limited.
    range: Option<[f32; 2]>,
}

/// Reads all actuators.
pub(super) fn read(root: &Element, context: &Context, parts: Parts<'_>) -> Vec<MotorPlan> {
    let elements = root.all("actuator").flat_map(|section| &section.children);
    let read = |element: &Element| {
        let element = context.classes.resolve(element, None)?;
        motor(&element, context, parts).map(|motor| (element, motor))
    };
    let read: Vec<(Element, MotorPlan)> =
        elements.filter_map(|element| context.blockers.keep(read(element))).collect();
    named(&read)
}

/// The motors with names of their own: the stated one, else that of the joint, with the kind of actuator if the joint has
/// several or another actuator has its name, and with a number if that is taken.
fn named(read: &[(Element, MotorPlan)]) -> Vec<MotorPlan> {
    let mut taken: BTreeSet<String> =
        read.iter().filter_map(|(element, _)| element.text("name").map(str::to_owned)).collect();
    let mut motors: Vec<MotorPlan> = Vec::new();
    for (element, motor) in read {
        let of_joint = read.iter().filter(|(_, other)| other.joint == motor.joint).count();
        let kind = format!("{}.{}", motor.joint, element.tag);
        let numbered = (2..).map(|number| format!("{kind}.{number}"));
        let own = Some(motor.joint.clone()).filter(|_| of_joint == 1);
        let mut candidates = own.into_iter().chain([kind.clone()]).chain(numbered);
        let name = match element.text("name") {
            Some(name) => name.to_owned(),
            None => candidates.find(|name| taken.insert(name.clone())).unwrap_or_default(),
        };
        motors.push(MotorPlan { name, ..motor.clone() });
    }
    motors
}

/// Reads an actuator, without its name.
fn motor(element: &Element, context: &Context, parts: Parts<'_>) -> Result<MotorPlan, String> {
    if let Some(target) = ELSEWHERE.iter().find(|name| element.text(name).is_some()) {
        let reason = format!(
            "an actuator must act on a joint, a fixed tendon or a site, not on a {target}; state its `joint`, or remove it"
        );
        return Err(element.refuse_for(target, reason));
    }
    if !KINDS.contains(&element.tag.as_str()) {
        let reason =
            "this actuator is not supported; use motor, position, velocity, intvelocity or general";
        return Err(element.refuse(reason));
    }
    let driven = driven(element, context, parts)?;
    let law = law(element, context)?;
    if driven.thrust.is_some() && law.bias[1..] != [0.0; 2] {
        let reason = "a servo needs a joint or tendon; use a motor on this site, or state `joint`";
        return Err(element.refuse_for("site", reason));
    }
    let has_one_axis = driven.tendon.is_some() || driven.moved.only_hinge().is_some();
    if law.bias[2] > 0.0 && !has_one_axis {
        return Err(element.refuse("a damping ratio needs one axis of a ball joint; state `kv`"));
    }
    let activation = activation(element, (&driven, &law), context)?;
    let range = control_range(element, &driven, (&law, activation.as_ref()), context)?;
    Ok(MotorPlan {
        name: String::new(),
        gear: driven.gear as f32,
        range: range.map(|end| end as f32),
        servo: law.servo(&driven),
        activation,
        joint: driven.name,
        moved: driven.moved,
        thrust: driven.thrust,
        tendon: driven.tendon,
    })
}

/// What an actuator moves.
fn driven(
    element: &Element,
    context: &Context,
    (bodies, links, tendons): Parts<'_>,
) -> Result<Driven, String> {
    let targets = ["joint", "jointinparent", "tendon", "site"];
    let mut stated = targets.iter().filter(|target| element.text(target).is_some());
    match (stated.next(), stated.next()) {
        (Some(&"tendon"), None) => {
            let known = tendons.iter().map(|tendon| tendon.name.as_str());
            let index = context.index(element, "tendon", ("fixed tendon", known))?;
            let [gear, ..] = element.padded("gear", GEAR)?;
            Ok(Driven::tendon(index, &tendons[index], gear))
        }
        (Some(&"site"), None) => on_site(element, context, bodies, links),
        (Some(attribute), None) => on_joint(element, attribute, context, links),
        (None, _) => Err(element.refuse("an actuator must act on a joint; state its `joint`")),
        (Some(_), Some(_)) => {
            Err(element.refuse("it acts on a `joint` and on something else; remove one"))
        }
    }
}

/// The joint that an attribute names.
fn on_joint(
    element: &Element,
    attribute: &str,
    context: &Context,
    links: &Links<'_>,
) -> Result<Driven, String> {
    let name = element.text(attribute).unwrap_or_default().to_owned();
    let [gear, y, z, ..] = element.padded("gear", GEAR)?;
    let hinges = joints::hinges(&links.plans);
    let balls: Vec<&Hinge> = links.plans.iter().filter_map(LinkPlan::ball).collect();
    let known: Vec<&str> = joints::names(&hinges).chain(joints::names(&balls)).collect();
    let mut free = links.plans.iter().filter_map(|link| joints::free_name(&link.joint));
    if !known.contains(&name.as_str()) && free.any(|free| free == name) {
        let reason = format!(
            "`{name}` is a free joint, which no actuator moves here; remove it, or replace the joint by slides and hinges"
        );
        return Err(element.refuse_for(attribute, reason));
    }
    let index = context.index(element, attribute, ("hinge, slide or ball joint", known))?;
    match hinges.get(index) {
        Some(hinge) => Ok(Driven {
            moved: Combination::of_hinge(index),
            reference: f64::from(hinge.reference),
            range: hinge.range,
            torque_range: hinge.torque_range,
            gear,
            ..Driven::unlimited(name)
        }),
        None if attribute == "jointinparent" => {
            let reason =
                "an actuator turns a ball joint about axes of the child; state it as `joint`";
            Err(element.refuse_for(attribute, reason))
        }
        // The three rotations of each ball joint follow all hinges.
        None => Ok(Driven::ball(name, 3 * index - 2 * hinges.len(), [gear, y, z])),
    }
}

/// The site that an actuator names, at which it exerts a force and a torque along the site's axes: the parts of `gear`.
fn on_site(
    element: &Element,
    context: &Context,
    bodies: &[Body],
    links: &Links<'_>,
) -> Result<Driven, String> {
    let (body, frame) = couplings::site(element, "site", context, bodies)?;
    let (link, home) = links.homes[body];
    let fixed = "its site is fixed to the world, where nothing moves; name a site of a moving body";
    let moves = link.filter(|link| !links.plans[*link].is_base());
    // Without a reason of its own if a joint of the body is refused.
    let refusal = || {
        if bodies[body].is_static { element.refuse_for("site", fixed) } else { String::new() }
    };
    let link = moves.ok_or_else(refusal)?;
    let site = home * frame.pose();
    let [x, y, z, roll, pitch, yaw] = element.padded("gear", GEAR)?;
    let turn = site.rotation.as_dquat();
    let [force, torque] = [turn * DVec3::new(x, y, z), turn * DVec3::new(roll, pitch, yaw)];
    let gear = if force == DVec3::ZERO { torque.length() } else { force.length() };
    let unit = |part: DVec3| if gear > 0.0 { part / gear } else { part };
    let (force, torque) = (unit(force), unit(torque));
    let thrust = Some(Thrust { link, point: site.translation, force, torque });
    let name = element.text("site").unwrap_or_default().to_owned();
    Ok(Driven { thrust, gear, ..Driven::unlimited(name) })
}

impl Driven {
    /// A ball joint, of which an actuator turns the child about the axis `gear` in its own axes.
    fn ball(name: String, first: usize, gear: [f64; 3]) -> Self {
        let parts = (first..).zip(gear).filter(|(_, part)| *part != 0.0);
        let parts: Vec<(usize, f32)> = parts.map(|(hinge, part)| (hinge, part as f32)).collect();
        let (moved, gear) = match parts.as_slice() {
            [] => (Combination::of_hinge(first), 0.0),
            [(hinge, part)] => (Combination::of_hinge(*hinge), f64::from(*part)),
            _ => (Combination(parts.into()), 1.0),
        };
        Self { moved, gear, ..Self::unlimited(name) }
    }

    fn tendon(index: usize, tendon: &TendonPlan, gear: f64) -> Self {
        Self {
            moved: tendon.moved.clone(),
            tendon: Some(index),
            reference: f64::from(tendon.reference),
            range: tendon.range,
            gear,
            ..Self::unlimited(tendon.name.clone())
        }
    }

    fn unlimited(name: String) -> Self {
        let moved = Combination([].into());
        let (thrust, tendon, range, torque_range) = (None, None, None, None);
        Self { name, moved, thrust, tendon, reference: 0.0, range, torque_range, gear: 1.0 }
    }

    /// Range of MuJoCo's position.
    fn stated_range(&self) -> Option<[f64; 2]> {
        self.range.map(|range| range.map(|end| f64::from(end) + self.reference))
    }

    /// The range that an actuator states by these attributes, unless it `inherits` that of the position.
    fn range_of(
        &self,
        element: &Element,
        names: [&str; 2],
        (law, inherits): (&Law, bool),
        context: &Context,
    ) -> Result<Option<[f64; 2]>, String> {
        let inherited = if inherits { self.inherited_range(element, law)? } else { None };
        inherited.map_or_else(|| context.range(element, names), |range| Ok(Some(range)))
    }

    /// The part of the position's range that `inheritrange` of an actuator takes, if any.
    fn inherited_range(&self, element: &Element, law: &Law) -> Result<Option<[f64; 2]>, String> {
        let inherited = element.number("inheritrange", 0.0)?;
        // As in MuJoCo, only a servo of the position inherits.
        if inherited == 0.0 || law.gain != -law.bias[1] {
            return Ok(None);
        }
        let Some([low, high]) = self.stated_range() else {
            let reason = "its joint or tendon has no range to inherit; set that `range`, or state this actuator's range instead";
            return Err(element.refuse_for("inheritrange", reason));
        };
        let (middle, half) = ((low + high) / 2.0, inherited * (high - low) / 2.0);
        Ok(Some([middle - half, middle + half]))
    }
}

/// Range of the control. A policy needs one, so a range that is not stated follows from those of the joint or the force.
fn control_range(
    element: &Element,
    driven: &Driven,
    (law, activation): (&Law, Option<&Activation>),
    context: &Context,
) -> Result<[f64; 2], String> {
    // The sum of an integrator's controls has the range of the joint.
    let is_summed = activation.is_some_and(|own| own.kind == ActivationKind::Integrator);
    let names = ["ctrlrange", "ctrllimited"];
    let range = match driven.range_of(element, names, (law, !is_summed), context)? {
        Some(range) => Some(range),
        None if is_summed => None,
        None => law.implied_range(driven, driven.stated_range()),
    };
    match range {
        Some(range) if matches!(range.map(|end| end as f32), [low, high] if low < high) => {
            Ok(range)
        }
        _ if element.text("ctrlrange").is_some() => {
            let reason = "its control must be limited: let `ctrlrange` ascend, without ctrllimited=\"false\"";
            Err(element.refuse_for("ctrlrange", reason))
        }
        _ => Err(element.refuse("its control must be limited: set `ctrlrange`")),
    }
}

impl Law {
    /// Range of the control that the joint's range gives a servo of the position, or the force's range a motor.
    fn implied_range(&self, driven: &Driven, of_joint: Option<[f64; 2]>) -> Option<[f64; 2]> {
        let [constant, stiffness, slope] = self.bias;
        let ends = if stiffness != 0.0 {
            let gear = driven.gear;
            of_joint?.map(|angle| -(constant + stiffness * gear * angle) / self.gain)
        } else if slope == 0.0 {
            let of_joint = driven.torque_range;
            let of_joint = of_joint.map(|range| range.map(|end| f64::from(end) / driven.gear));
            let force = self.range.map(|range| range.map(f64::from)).or(of_joint)?;
            force.map(|force| (force - constant) / self.gain)
        } else {
            return None;
        };
        let [a, b] = ends;
        let fits = |end: f64| bounds::refusal("ctrlrange", end).is_none();
        (fits(a) && fits(b)).then(|| [a.min(b), a.max(b)])
    }

    /// The feedback; `None` if the force is the control.
    fn servo(&self, driven: &Driven) -> Option<Servo> {
        let [constant, stiffness, slope] = self.bias;
        if self.gain == 1.0 && self.bias == [0.0; 3] && self.range.is_none() {
            return None;
        }
        let at_rest = constant + stiffness * driven.gear * driven.reference;
        let bias = [at_rest, stiffness, slope].map(|number| number as f32);
        let (gain, observed_constant) = (self.gain as f32, constant as f32);
        Some(Servo { gain, bias, observed_constant, range: self.range })
    }
}

/// The law, which [`Classes`](super::super::document::Classes) state as attributes of `general`.
fn law(element: &Element, context: &Context) -> Result<Law, String> {
    element.word("gaintype", &[("fixed", ())])?;
    let mut one = [0.0; MOST_PARAMETERS];
    one[0] = 1.0;
    let gain = element.padded("gainprm", one)?[0];
    let [a, b, c, ..] = element.padded("biasprm", [0.0; MOST_PARAMETERS])?;
    let bias = element.word("biastype", &[("none", [0.0; 3]), ("affine", [a, b, c])])?;
    let range = context.range(element, ["forcerange", "forcelimited"])?;
    Ok(Law { gain, bias, range: range.map(|range| range.map(|end| end as f32)) })
}

/// Reads the activation of an actuator; `None` if its gain multiplies the control.
fn activation(
    element: &Element,
    (driven, law): (&Driven, &Law),
    context: &Context,
) -> Result<Option<Activation>, String> {
    let is_summed = element.text("dyntype") == Some("integrator");
    let kinds = [
        ("none", None),
        ("integrator", Some(ActivationKind::Integrator)),
        ("filter", Some(ActivationKind::Filter)),
        ("filterexact", Some(ActivationKind::FilterExact)),
    ];
    let kind = element.word("dyntype", &kinds)?;
    // Of a class it does not matter for an actuator without activation.
    let is_limited = element.flag("actlimited")? == Some(true) && element.tag == "general";
    if kind.is_none() && !is_limited && element.text("actrange").is_none() {
        return Ok(None);
    }
    let range = driven.range_of(element, ["actrange", "actlimited"], (law, is_summed), context)?;
    let kind = match (kind, range) {
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
