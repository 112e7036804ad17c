//! An MJCF document as a tree of elements with their lines. Included files are inlined and default classes applied.

mod bounds;
mod classes;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::rc::Rc;

use roxmltree::{Document, Node, ParsingOptions};

use super::folder::Folder;
use super::nesting::deepest;
use crate::spelling;

pub(in crate::robot) use classes::Classes;

/// Most elements inside each other, those of included files counted where they are included.
const DEEPEST_ELEMENT: usize = 200;
/// Nesting depth of included files.
const DEEPEST_INCLUDE: usize = 8;
const ROOT_END: &str = "</mujoco>";
/// Most nodes of a file: elements, comments and texts between them.
const MOST_NODES: u32 = 200_000;

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
#[derive(Clone, Debug)]
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
    /// Parses a document and all files that it includes.
    pub(super) fn parse(text: &str, folder: &mut Folder<'_>) -> Result<Self, String> {
        let document = parsed(text)?;
        let root = document.root_element();
        if root.tag_name().name() != "mujoco" {
            return Err(format!(
                "the document is <{}>, not <mujoco>; name an MJCF file",
                root.tag_name().name()
            ));
        }
        read(root, &Source::of(text, None), folder, Depth { elements: 1, includes: 0 })
    }

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

    /// Replaces attributes by those of `top`. An orientation replaces any other.
    fn overlay(&mut self, top: &Self) {
        if ORIENTATIONS.iter().any(|name| top.attributes.contains_key(*name)) {
            ORIENTATIONS.iter().for_each(|name| drop(self.attributes.remove(*name)));
        }
        for (name, value) in &top.attributes {
            self.attributes.insert(name.clone(), value.clone());
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

    /// Numbers of an attribute within its bounds, at least one.
    pub(super) fn list(&self, name: &str) -> Result<Option<Vec<f64>>, String> {
        let Some(text) = self.text(name) else { return Ok(None) };
        let numbers: Result<Vec<f64>, _> = text.split_ascii_whitespace().map(str::parse).collect();
        let numbers = match numbers {
            Ok(numbers) if !numbers.is_empty() && numbers.iter().all(|x| x.is_finite()) => numbers,
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
            .map_err(|_| format!("`{name}` must have {N} numbers, it has {found}"))
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

    /// An integer.
    pub(super) fn integer(&self, name: &str, default: i64) -> Result<i64, String> {
        let Some(text) = self.text(name) else { return Ok(default) };
        let number = text.trim().parse();
        let reason = |_| format!("{name}=\"{}\" must be a whole number", start(text));
        number.map_err(|error| self.refuse_for(name, reason(error)))
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

/// A file of a document.
struct Source {
    /// `None` for the document itself.
    file: Option<Rc<str>>,
    /// Bytes before the end of each line.
    line_ends: Vec<usize>,
}

impl Source {
    fn of(text: &str, file: Option<Rc<str>>) -> Self {
        let line_ends = text.match_indices('\n').map(|(at, _)| at).collect();
        Self { file, line_ends }
    }

    /// Number of the line with this byte.
    fn line(&self, byte: usize) -> u32 {
        self.line_ends.partition_point(|end| *end < byte) as u32 + 1
    }
}

/// How many elements, and how many included files, an element is in.
#[derive(Clone, Copy)]
struct Depth {
    /// With the element itself.
    elements: usize,
    includes: usize,
}

fn read(
    node: Node<'_, '_>,
    source: &Source,
    folder: &mut Folder<'_>,
    depth: Depth,
) -> Result<Element, String> {
    if depth.elements > DEEPEST_ELEMENT {
        return Err(too_deep());
    }
    folder.count_element()?;
    let mut element = Element {
        tag: node.tag_name().name().to_owned(),
        place: Some(Place { file: source.file.clone(), line: source.line(node.range().start) }),
        stated: BTreeMap::new(),
        attributes: node
            .attributes()
            .map(|a| (a.name().to_owned(), a.value().to_owned()))
            .collect(),
        children: Vec::new(),
    };
    check_plain(node, &element)?;
    let inside = Depth { elements: depth.elements + 1, ..depth };
    for child in node.children().filter(Node::is_element) {
        let child_element = read(child, source, folder, inside)?;
        if child_element.tag == "include" {
            element.children.extend(included(&child_element, folder, inside)?);
        } else {
            element.children.push(child_element);
        }
    }
    Ok(element)
}

/// Refuses prefixes, which could give an element two attributes of one name, and text with words, such as a tag without
/// its `<`.
fn check_plain(node: Node<'_, '_>, element: &Element) -> Result<(), String> {
    let outside = node.parent_element().map_or(node, |parent| parent).tag_name().namespace();
    let prefixed = node.attributes().find(|attribute| attribute.namespace().is_some());
    if prefixed.is_some() || node.tag_name().namespace() != outside {
        return Err(element.refuse("names with a prefix are not supported; remove it"));
    }
    let texts = node.children().filter_map(|child| child.text().filter(|_| child.is_text()));
    match texts.map(str::trim).find(|text| text.contains(char::is_alphanumeric)) {
        None => Ok(()),
        Some(text) => {
            let reason = "text between elements has no meaning, remove it";
            Err(element.refuse(format!("{reason}: {}", start(text))))
        }
    }
}

/// The start of a text, for a message.
fn start(text: &str) -> &str {
    text.char_indices().nth(40).map_or(text, |(end, _)| &text[..end])
}

/// Parses XML that is not nested so deeply that the parser's stack would overflow.
fn parsed(text: &str) -> Result<Document<'_>, String> {
    if deepest(text) > DEEPEST_ELEMENT {
        return Err(too_deep());
    }
    // MuJoCo's parser ignores what follows the root, such as a second end in Unitree's files.
    let mut text = text.trim_end();
    while let Some(rest) = text.strip_suffix(ROOT_END).map(str::trim_end)
        && rest.ends_with(ROOT_END)
    {
        text = rest;
    }
    let options = ParsingOptions { nodes_limit: MOST_NODES, ..ParsingOptions::default() };
    let parsed = Document::parse_with_options(text, options);
    parsed.map_err(|error| format!("it must be valid XML without a DTD: {error}"))
}

fn too_deep() -> String {
    format!("elements are nested more than {DEEPEST_ELEMENT} deep")
}

/// Children of the root of an included file.
fn included(
    include: &Element,
    folder: &mut Folder<'_>,
    depth: Depth,
) -> Result<Vec<Element>, String> {
    include.only(&[&["file"]])?;
    let name = include.text("file").ok_or_else(|| include.refuse("it has no `file`; add one"))?;
    if depth.includes == DEEPEST_INCLUDE {
        return Err(include.refuse(format!("files are included more than {DEEPEST_INCLUDE} deep")));
    }
    let (path, text) = folder.read_document(name).map_err(|error| include.refuse(error))?;
    let document = parsed(&text).map_err(|error| include.refuse(error))?;
    // The children of the root take the place of the include.
    let outside = Depth { elements: depth.elements - 1, includes: depth.includes + 1 };
    let source = Source::of(&text, Some(Rc::from(path)));
    Ok(read(document.root_element(), &source, folder, outside)?.children)
}

/// Attributes that state an orientation. An element's own replaces that of its class.
pub(super) const ORIENTATIONS: [&str; 5] = ["quat", "axisangle", "euler", "xyaxes", "zaxis"];

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
