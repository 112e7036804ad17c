//! Default classes of a document.

use std::collections::{BTreeMap, BTreeSet};
use std::iter;
use std::rc::Rc;

use super::{Element, laws};
use crate::spelling;

const MAIN: &str = "main";
/// Most bytes of the attributes of a default, which all elements of its class have.
const MOST_BYTES: usize = 4096;
/// Elements with defaults.
const DEFAULTS: [&str; 10] =
    ["mesh", "material", "joint", "geom", "site", "camera", "light", "pair", "equality", "tendon"];
/// The default of all actuators without their laws.
const ACTUATOR: &str = "actuator";
/// Kinds of actuators that start from the law of a default.
const LAWS: [&str; 4] = ["general", "position", "velocity", "intvelocity"];

/// For each tag the attributes of a class and of its parents. The laws of actuators have the tags of their kinds.
type Defaults = BTreeMap<String, Rc<Element>>;

/// Default classes by name.
#[derive(Debug)]
pub(in crate::robot) struct Classes(BTreeMap<String, Defaults>);

impl Classes {
    /// Reads all `default` elements of a document, with the reasons against those that cannot be read.
    pub(in crate::robot) fn new(root: &Element) -> (Self, Vec<String>) {
        let mut classes = Self(BTreeMap::from([(MAIN.to_owned(), Defaults::new())]));
        let mut reasons = Vec::new();
        for default in root.all("default") {
            let main = classes.0.remove(MAIN).unwrap_or_default();
            classes.add(default, MAIN, main, &mut reasons);
        }
        // MuJoCo refuses other names of the main class. What uses them is no further reason.
        let main = classes.0.get(MAIN).cloned().unwrap_or_default();
        let mut names = BTreeSet::from(["", MAIN]);
        for default in root.all("default") {
            let Some(name) = default.text("class").filter(|name| names.insert(*name)) else {
                continue;
            };
            reasons.push(default.refuse(
                "an outermost default has the class `main`; remove its `class`, or put it into another \
                 <default>",
            ));
            classes.0.entry(name.to_owned()).or_insert_with(|| main.clone());
        }
        (classes, reasons)
    }

    fn add(&mut self, default: &Element, name: &str, outside: Defaults, reasons: &mut Vec<String>) {
        reasons.extend(default.only(&[&["class"]]).err());
        let mut class = outside.clone();
        for child in default.children.iter().filter(|child| child.tag != "default") {
            reasons.extend(add_element(&mut class, &outside, child).err());
        }
        for child in default.all("default") {
            match child.text("class") {
                Some(name) => self.add(child, name, class.clone(), reasons),
                None => reasons.push(child.refuse("it has no `class`; add one")),
            }
        }
        if self.0.insert(name.to_owned(), class).is_some() {
            reasons.push(twice(default, name));
        }
    }

    /// An element with the attributes of its class: its own `class`, else `childclass`, else the main class. It has no
    /// children. An actuator has the law of its kind as attributes of `general`.
    pub(in crate::robot) fn resolve(
        &self,
        element: &Element,
        childclass: Option<&str>,
    ) -> Result<Element, String> {
        if let Some(child) = element.children.first() {
            return Err(child.refuse_element());
        }
        self.resolve_as(&element.tag, element, childclass)
    }

    /// As [`Self::resolve`], with the defaults of the elements `tag`.
    pub(in crate::robot) fn resolve_as(
        &self,
        tag: &str,
        element: &Element,
        childclass: Option<&str>,
    ) -> Result<Element, String> {
        let name = element.text("class").or(childclass).unwrap_or(MAIN);
        let class = self.0.get(name).ok_or_else(|| {
            let hint = spelling::choice(name, self.0.keys().map(String::as_str));
            element.refuse(format!("no default has the class `{name}`; {hint}"))
        })?;
        let mut resolved = element.with(BTreeMap::new());
        let is_actuator = laws::KINDS.contains(&tag);
        if let Some(defaults) = class.get(if is_actuator { ACTUATOR } else { tag }) {
            resolved.overlay(defaults);
        }
        if is_actuator {
            let law = laws::law(element, &law_of(class, tag))?;
            laws::overlay(&mut resolved, element, &law);
            resolved.overlay(&law);
        } else {
            resolved.overlay(element);
        }
        resolved.stated.retain(|_, place| Some(&*place) != element.place.as_ref());
        Ok(resolved)
    }
}

fn twice(default: &Element, name: &str) -> String {
    default.refuse(format!("two defaults have the class `{name}`; rename one"))
}

/// Adds an element to the defaults of a class. Those of the class around it are `outside`.
fn add_element(class: &mut Defaults, outside: &Defaults, child: &Element) -> Result<(), String> {
    let is_actuator = laws::KINDS.contains(&child.tag.as_str());
    if !is_actuator && !DEFAULTS.contains(&child.tag.as_str()) {
        return Err(child.refuse("this element is not supported; remove it"));
    }
    let tag = if is_actuator { ACTUATOR } else { &child.tag };
    let mut merged = class.get(tag).map_or_else(|| empty(tag), |own| own.as_ref().clone());
    if is_actuator {
        let law = laws::law(child, &law_of(class, &child.tag))?;
        laws::overlay(&mut merged, child, &law);
        check_size(child, &law)?;
        let law = Rc::new(law);
        let states_it = ["position", "intvelocity"].contains(&child.tag.as_str());
        let before = class.get("general").filter(|_| !states_it);
        let general = Rc::new(with_inherited_range(&law, before));
        for kind in LAWS {
            // The law of another kind leaves that of the class around this one.
            let applies = [kind, "general"].contains(&child.tag.as_str()) || kind == "general";
            let law = if kind == "general" { &general } else { &law };
            match if applies { Some(law) } else { outside.get(kind) } {
                Some(law) => class.insert(kind.to_owned(), Rc::clone(law)),
                None => class.remove(kind),
            };
        }
    } else {
        merged.overlay(child);
    }
    check_size(child, &merged)?;
    class.insert(tag.to_owned(), Rc::new(merged));
    Ok(())
}

/// The law of `general` after one of a kind that has no `inheritrange`: that of the law before remains, as in MuJoCo.
fn with_inherited_range(law: &Element, before: Option<&Rc<Element>>) -> Element {
    const NAME: &str = "inheritrange";
    let mut law = law.clone();
    if let Some(share) = before.and_then(|before| before.text(NAME)) {
        law.attributes.entry(NAME.to_owned()).or_insert_with(|| share.to_owned());
    }
    law
}

fn check_size(child: &Element, merged: &Element) -> Result<(), String> {
    let sizes = merged.attributes.iter().map(|(name, value)| name.len() + value.len());
    if sizes.sum::<usize>() <= MOST_BYTES {
        Ok(())
    } else {
        Err(child.refuse(format!("its attributes have more than {MOST_BYTES} bytes; shorten them")))
    }
}

/// The law from which an actuator of this kind starts.
fn law_of(class: &Defaults, kind: &str) -> Rc<Element> {
    class.get(kind).map_or_else(|| Rc::new(empty(kind)), Rc::clone)
}

fn empty(tag: &str) -> Element {
    Element::merged(tag, iter::empty())
}
