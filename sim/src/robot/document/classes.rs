//! Default classes of a document.

use std::collections::{BTreeMap, BTreeSet};
use std::iter;

use super::Element;
use crate::spelling;

/// Actuators share one default, whatever their tag.
const ACTUATORS: [&str; 5] = ["general", "motor", "position", "velocity", "damper"];
/// Attributes of the gain and the bias, of which each kind of actuator states others. Those of a motor are fixed.
const LAWS: [&str; 10] = [
    "kp",
    "kv",
    "dampratio",
    "timeconst",
    "gainprm",
    "biasprm",
    "dynprm",
    "dyntype",
    "biastype",
    "gaintype",
];
const MAIN: &str = "main";
/// Most bytes of the attributes of a default, which all elements of its class have.
const MOST_BYTES: usize = 4096;
/// Elements with defaults.
const DEFAULTS: [&str; 19] = [
    "mesh",
    "material",
    "joint",
    "geom",
    "site",
    "camera",
    "light",
    "pair",
    "equality",
    "tendon",
    "general",
    "motor",
    "position",
    "velocity",
    "damper",
    "intvelocity",
    "cylinder",
    "muscle",
    "adhesion",
];

/// Default classes: for each tag an element with the attributes of the class and of its parents.
#[derive(Debug)]
pub(in crate::robot) struct Classes(BTreeMap<String, BTreeMap<String, Element>>);

impl Classes {
    /// Reads all `default` elements of a document.
    pub(in crate::robot) fn new(root: &Element) -> Result<Self, String> {
        let mut classes = Self(BTreeMap::from([(MAIN.to_owned(), BTreeMap::new())]));
        for default in root.all("default") {
            let main = classes.0.remove(MAIN).unwrap_or_default();
            classes.add(default, MAIN, main)?;
        }
        // All outermost elements describe the main class, which then has their names too.
        let main = classes.0.get(MAIN).cloned().unwrap_or_default();
        let names: BTreeSet<&str> =
            root.all("default").filter_map(|default| default.text("class")).collect();
        for name in names.into_iter().filter(|name| *name != MAIN) {
            if classes.0.insert(name.to_owned(), main.clone()).is_some() {
                let mut twice =
                    root.all("default").filter(|default| default.text("class") == Some(name));
                let reason = format!("two defaults have the class `{name}`; rename one");
                return Err(twice.next().map_or(reason.clone(), |default| default.refuse(reason)));
            }
        }
        Ok(classes)
    }

    fn add(
        &mut self,
        default: &Element,
        name: &str,
        mut class: BTreeMap<String, Element>,
    ) -> Result<(), String> {
        default.only(&[&["class"]])?;
        for child in default.children.iter().filter(|child| child.tag != "default") {
            if !DEFAULTS.contains(&child.tag.as_str()) {
                return Err(child.refuse("this element is not supported; remove it"));
            }
            let slot = slot(&child.tag);
            let base = class.entry(slot.to_owned());
            let merged = base.or_insert_with(|| Element::merged(slot, iter::empty()));
            merged.overlay(child);
            if LAWS.iter().any(|name| child.attributes.contains_key(*name)) {
                merged.tag.clone_from(&child.tag);
            }
            let sizes = merged.attributes.iter().map(|(name, value)| name.len() + value.len());
            if sizes.sum::<usize>() > MOST_BYTES {
                let reason =
                    format!("its attributes have more than {MOST_BYTES} bytes; shorten them");
                return Err(child.refuse(reason));
            }
        }
        for child in default.all("default") {
            let name =
                child.text("class").ok_or_else(|| child.refuse("it has no `class`; add one"))?;
            self.add(child, name, class.clone())?;
        }
        match self.0.insert(name.to_owned(), class) {
            None => Ok(()),
            Some(_) => {
                Err(default.refuse(format!("two defaults have the class `{name}`; rename one")))
            }
        }
    }

    /// An element with the attributes of its class: its own `class`, else `childclass`, else the main class. It has no
    /// children.
    pub(in crate::robot) fn resolve(
        &self,
        element: &Element,
        childclass: Option<&str>,
    ) -> Result<Element, String> {
        if let Some(child) = element.children.first() {
            return Err(child.refuse("this element is not supported; remove it"));
        }
        self.resolve_as(slot(&element.tag), element, childclass)
    }

    /// As [`Self::resolve`], with the defaults of the elements `slot`.
    pub(in crate::robot) fn resolve_as(
        &self,
        slot: &str,
        element: &Element,
        childclass: Option<&str>,
    ) -> Result<Element, String> {
        let name = element.text("class").or(childclass).unwrap_or(MAIN);
        let class = self.0.get(name);
        let class = class.ok_or_else(|| {
            let hint = spelling::choice(name, self.0.keys().map(String::as_str));
            element.refuse(format!("no default has the class `{name}`; {hint}"))
        })?;
        let mut resolved = element.with(BTreeMap::new());
        if let Some(defaults) = class.get(slot) {
            // MuJoCo translates the default into gains, and the actuator starts from those.
            let is_translated = defaults.tag != slot && defaults.tag != element.tag;
            if is_translated && element.tag != "motor" {
                let reason = format!(
                    "the gains of its class `{name}` are those of a <{}>; give it another class and state its own",
                    defaults.tag
                );
                return Err(element.refuse(reason));
            }
            resolved.overlay(defaults);
        }
        resolved.overlay(element);
        element.attributes.keys().for_each(|name| drop(resolved.stated.remove(name)));
        Ok(resolved)
    }
}

fn slot(tag: &str) -> &str {
    if ACTUATORS.contains(&tag) { "actuator" } else { tag }
}
