//! An MJCF document as a tree of elements with their lines. Included files are inlined and default classes applied.

pub(super) mod bounds;
mod classes;
mod elements;
mod laws;
mod parsing;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::rc::Rc;

use crate::spelling;

pub(in crate::robot) use classes::Classes;
pub(in crate::robot) use elements::SECTIONS;

/// An element with its attributes, without text.
#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) tag: String,
    /// `None` for an element that several elements of the document state together.
    place: Option<Place>,
    pub(super) attributes: BTreeMap<String, String>,
    /// Where another element states an attribute of this one: the default of a class, or one of several elements.
    stated: BTreeMap<String, Place>,
    pub(super) children: Vec<Element>,
}

/// Start of an element in the document.
#[derive(Clone, Debug, PartialEq)]
struct Place {
    /// Included file that the element is in; `None` for the document itself.
    file: Option<Rc<str>>,
    line: u32,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.file {
            Some(file) => write!(f, "{file} line {}", self.line),
            None => write!(f, "line {}", self.line),
        }
    }
}

impl Element {
    /// Error message for this element.
    pub(super) fn refuse(&self, reason: impl fmt::Display) -> String {
        format!("{}: {reason}", self.shown())
    }

    /// Error message for an attribute of this element. It names the element that states the attribute.
    pub(super) fn refuse_for(&self, attribute: &str, reason: impl fmt::Display) -> String {
        match (self.stated.get(attribute), &self.place) {
            (None, _) => self.refuse(reason),
            (Some(place), None) => format!("{place}, <{}>: {reason}", self.tag),
            (Some(place), Some(_)) => {
                format!("{place}, <{}>: {reason}; it is the default of {}", self.tag, self.shown())
            }
        }
    }

    fn shown(&self) -> String {
        let place = self.place.as_ref().map_or(String::new(), |place| format!("{place}, "));
        let named = ["name", "file", "class", "joint"];
        let name = named.iter().find_map(|key| Some((key, self.attributes.get(*key)?)));
        let name =
            name.map_or(String::new(), |(key, value)| format!(" {key}=\"{}\"", start(value)));
        format!("{place}<{}{name}>", self.tag)
    }

    /// Included file that the element is in; `None` for the document itself.
    pub(super) fn file(&self) -> Option<&str> {
        self.place.as_ref()?.file.as_deref()
    }

    /// The element without its children.
    pub(super) fn alone(&self) -> Self {
        Self { stated: self.stated.clone(), ..self.with(self.attributes.clone()) }
    }

    /// The element without its children and with other attributes.
    pub(super) fn with(&self, attributes: BTreeMap<String, String>) -> Self {
        let (tag, place) = (self.tag.clone(), self.place.clone());
        Self { tag, place, attributes, stated: BTreeMap::new(), children: Vec::new() }
    }

    /// An element of no place with the attributes of all these; the last one of a name counts.
    pub(super) fn merged<'a>(tag: &str, elements: impl Iterator<Item = &'a Self>) -> Self {
        let mut merged = Self {
            tag: tag.to_owned(),
            place: None,
            attributes: BTreeMap::new(),
            stated: BTreeMap::new(),
            children: Vec::new(),
        };
        elements.for_each(|element| merged.overlay(element));
        merged
    }

    /// Replaces attributes by those of `top`, as MuJoCo does: an orientation replaces any other, an empty attribute none,
    /// and numbers that are not stated remain.
    fn overlay(&mut self, top: &Self) {
        if ORIENTATIONS.iter().any(|name| top.attributes.contains_key(*name)) {
            ORIENTATIONS.iter().for_each(|name| drop(self.attributes.remove(*name)));
        }
        for (name, value) in &top.attributes {
            let old = self.attributes.get(name).map_or("", String::as_str);
            let value = if PADDED.contains(&name.as_str()) {
                filled(value, old)
            } else if value.trim().is_empty() && !old.is_empty() {
                continue;
            } else {
                value.clone()
            };
            self.attributes.insert(name.clone(), value);
            match top.stated.get(name).or(top.place.as_ref()) {
                Some(place) => self.stated.insert(name.clone(), place.clone()),
                None => self.stated.remove(name),
            };
        }
    }

    /// An attribute as text.
    pub(super) fn text(&self, name: &str) -> Option<&str> {
        self.attributes.get(name).map(String::as_str)
    }

    /// What a keyword means; that of the first one without the attribute.
    pub(super) fn word<T: Copy>(&self, name: &str, words: &[(&str, T)]) -> Result<T, String> {
        let word = self.text(name).unwrap_or(words[0].0);
        let found = words.iter().find(|(known, _)| *known == word);
        found.map(|(_, meaning)| *meaning).ok_or_else(|| {
            let known: Vec<&str> = words.iter().map(|(known, _)| *known).collect();
            let choice = if known.len() > 1 { "set one of " } else { "set " };
            let (word, known) = (start(word), known.join(", "));
            self.refuse_for(name, format!("{name}=\"{word}\" is not supported; {choice}{known}"))
        })
    }

    /// Error message for an attribute that names no `kind`; `known` are the names of all.
    pub(super) fn refuse_name<'a>(
        &self,
        attribute: &str,
        kind: &str,
        known: impl IntoIterator<Item = &'a str>,
    ) -> String {
        let name = self.text(attribute).unwrap_or_default();
        let hint = spelling::choice(name, known);
        self.refuse_for(attribute, format!("no {kind} has the name `{}`; {hint}", start(name)))
    }

    /// Children with this tag.
    pub(super) fn all<'a>(&'a self, tag: &'a str) -> impl Iterator<Item = &'a Element> {
        self.children.iter().filter(move |child| child.tag == tag)
    }

    /// Refuses attributes that are not in `known`.
    pub(super) fn only(&self, known: &[&[&str]]) -> Result<(), String> {
        let is_known = |name: &str| known.iter().any(|names| names.contains(&name));
        let mut unknown = self.attributes.keys().filter(|name| !is_known(name));
        let Some(first) = unknown.next() else { return Ok(()) };
        let known = known.iter().flat_map(|names| names.iter().copied());
        let hint = match spelling::nearest(first, known) {
            Some(name) => format!("did you mean `{name}`?"),
            None => "remove it".to_owned(),
        };
        let more: String = unknown.map(|name| format!(", nor is `{name}`")).collect();
        let reason = format!("the attribute `{first}` is not supported{more}; {hint}");
        Err(self.refuse_for(first, reason))
    }

    /// An attribute as text; `None` if it is empty.
    fn stated_text(&self, name: &str) -> Option<&str> {
        self.text(name).filter(|text| !text.trim().is_empty())
    }

    /// Numbers of an attribute within its bounds, at least one.
    pub(super) fn list(&self, name: &str) -> Result<Option<Vec<f64>>, String> {
        let Some(text) = self.stated_text(name) else { return Ok(None) };
        let numbers: Result<Vec<f64>, _> = text.split_ascii_whitespace().map(str::parse).collect();
        let numbers = match numbers {
            Ok(numbers) if numbers.iter().all(|x| x.is_finite()) => numbers,
            _ => {
                let reason = format!("{name}=\"{}\" must be finite numbers", start(text));
                return Err(self.refuse_for(name, reason));
            }
        };
        match numbers.iter().find_map(|number| bounds::refusal(name, *number)) {
            None => Ok(Some(numbers)),
            Some(reason) => Err(self.refuse_for(name, format!("`{name}` {reason}"))),
        }
    }

    /// Exactly `N` numbers.
    pub(super) fn numbers<const N: usize>(&self, name: &str) -> Result<Option<[f64; N]>, String> {
        let Some(list) = self.list(name)? else { return Ok(None) };
        let found = list.len();
        let array = list
            .try_into()
            .map_err(|_| {
                let needed =
                    if N == 1 { "be one number".to_owned() } else { format!("have {N} numbers") };
                format!("`{name}` must {needed}, it has {found}")
            })
            .map_err(|reason| self.refuse_for(name, reason))?;
        Ok(Some(array))
    }

    /// `default` with its first numbers replaced by the attribute's.
    pub(super) fn padded<const N: usize>(
        &self,
        name: &str,
        mut default: [f64; N],
    ) -> Result<[f64; N], String> {
        let Some(list) = self.list(name)? else { return Ok(default) };
        if list.len() > N {
            let found = list.len();
            let reason = format!("`{name}` has {found} numbers, at most {N} are allowed");
            return Err(self.refuse_for(name, reason));
        }
        default[..list.len()].copy_from_slice(&list);
        Ok(default)
    }

    /// One number.
    pub(super) fn number(&self, name: &str, default: f64) -> Result<f64, String> {
        Ok(self.numbers::<1>(name)?.map_or(default, |[number]| number))
    }

    /// An integer of 32 bits.
    pub(super) fn integer(&self, name: &str, default: i64) -> Result<i64, String> {
        let Some(text) = self.stated_text(name) else { return Ok(default) };
        let reason = || format!("{name}=\"{}\" must be a whole number of 32 bits", start(text));
        let number = text.trim().parse::<i32>().map(i64::from);
        number.map_err(|_| self.refuse_for(name, reason()))
    }

    /// `true` or `false`; `None` without the attribute, or if it is `auto`.
    pub(super) fn flag(&self, name: &str) -> Result<Option<bool>, String> {
        match self.text(name) {
            None | Some("auto") => Ok(None),
            Some("true" | "1" | "enable") => Ok(Some(true)),
            Some("false" | "0" | "disable") => Ok(Some(false)),
            Some(word) => {
                Err(self
                    .refuse_for(name, format!("{name}=\"{}\" must be true or false", start(word))))
            }
        }
    }
}

/// The start of a text, for a message.
fn start(text: &str) -> &str {
    text.char_indices().nth(40).map_or(text, |(end, _)| &text[..end])
}

/// Attributes that state an orientation. An element's own replaces that of its class.
pub(super) const ORIENTATIONS: [&str; 5] = ["quat", "axisangle", "euler", "xyaxes", "zaxis"];

/// Attributes of which an element may state the first numbers only, and its class the others.
const PADDED: [&str; 12] = [
    "friction",
    "size",
    "gear",
    "solref",
    "solimp",
    "solreflimit",
    "solimplimit",
    "solreffriction",
    "solimpfriction",
    "gainprm",
    "biasprm",
    "dynprm",
];

/// Numbers, and those of `old` that follow them.
fn filled(numbers: &str, old: &str) -> String {
    let stated = numbers.split_ascii_whitespace();
    let rest = old.split_ascii_whitespace().skip(stated.clone().count());
    stated.chain(rest).collect::<Vec<_>>().join(" ")
}

/// Refuses a second element with the same name.
pub(super) fn check_names<'a>(elements: impl Iterator<Item = &'a Element>) -> Result<(), String> {
    check_unique(elements.filter_map(|element| Some((element, element.text("name")?))))
}

/// Refuses a second element with the same name, which may be an implied one.
pub(super) fn check_unique<'a>(
    named: impl Iterator<Item = (&'a Element, &'a str)>,
) -> Result<(), String> {
    let mut names = BTreeSet::new();
    for (element, name) in named {
        if !names.insert(name) {
            let reason = format!("another element has the name `{name}`, too; rename one");
            return Err(element.refuse(reason));
        }
    }
    Ok(())
}
