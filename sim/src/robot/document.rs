//! An MJCF document as a tree of elements with their lines. Included files are inlined and default classes applied.

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use roxmltree::{Document, Node};

use super::folder::Folder;

/// Most elements inside each other.
const DEEPEST_ELEMENT: usize = 200;
/// Nesting depth of included files.
const DEEPEST_INCLUDE: usize = 8;

/// An element with its attributes, without text.
#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) tag: String,
    /// Included file that the element is in; `None` for the document itself.
    file: Option<Rc<str>>,
    line: u32,
    pub(super) attributes: BTreeMap<String, String>,
    pub(super) children: Vec<Element>,
}

impl Element {
    /// Parses a document and all files that it includes.
    pub(super) fn parse(text: &str, folder: &mut Folder<'_>) -> Result<Self, String> {
        let document = parsed(text)?;
        let root = document.root_element();
        if root.tag_name().name() != "mujoco" {
            return Err(format!("the document is <{}>, not <mujoco>", root.tag_name().name()));
        }
        read(root, None, folder, DEEPEST_INCLUDE)
    }

    /// Error message for this element.
    pub(super) fn refuse(&self, reason: impl std::fmt::Display) -> String {
        let file = self.file.as_ref().map_or(String::new(), |file| format!("{file} "));
        let named = ["name", "file", "class", "joint"];
        let name = named.iter().find_map(|key| Some((key, self.attributes.get(*key)?)));
        let name = name.map_or(String::new(), |(key, value)| format!(" {key}=\"{value}\""));
        format!("{file}line {}, <{}{name}>: {reason}", self.line, self.tag)
    }

    /// The element without its children.
    pub(super) fn alone(&self) -> Self {
        self.with(self.attributes.clone())
    }

    /// The element without its children and with other attributes.
    pub(super) fn with(&self, attributes: BTreeMap<String, String>) -> Self {
        let (tag, file) = (self.tag.clone(), self.file.clone());
        Self { tag, file, line: self.line, attributes, children: Vec::new() }
    }

    /// An attribute as text.
    pub(super) fn text(&self, name: &str) -> Option<&str> {
        self.attributes.get(name).map(String::as_str)
    }

    /// Children with this tag.
    pub(super) fn all<'a>(&'a self, tag: &'a str) -> impl Iterator<Item = &'a Element> {
        self.children.iter().filter(move |child| child.tag == tag)
    }

    /// Refuses attributes that are not in `known`.
    pub(super) fn only(&self, known: &[&[&str]]) -> Result<(), String> {
        let known = |name: &str| known.iter().any(|names| names.contains(&name));
        match self.attributes.keys().find(|name| !known(name)) {
            None => Ok(()),
            Some(name) => Err(self.refuse(format!("the attribute `{name}` is not supported"))),
        }
    }

    /// Numbers of an attribute, at least one.
    pub(super) fn list(&self, name: &str) -> Result<Option<Vec<f64>>, String> {
        let Some(text) = self.text(name) else { return Ok(None) };
        let numbers: Result<Vec<f64>, _> = text.split_ascii_whitespace().map(str::parse).collect();
        match numbers {
            Ok(numbers)
                if !numbers.is_empty()
                    && numbers.iter().all(|x| x.abs() <= f64::from(f32::MAX)) =>
            {
                Ok(Some(numbers))
            }
            _ => Err(self.refuse(format!("{name}=\"{text}\" must be finite numbers"))),
        }
    }

    /// Exactly `N` numbers.
    pub(super) fn numbers<const N: usize>(&self, name: &str) -> Result<Option<[f64; N]>, String> {
        let Some(list) = self.list(name)? else { return Ok(None) };
        let found = list.len();
        let array = list
            .try_into()
            .map_err(|_| self.refuse(format!("`{name}` must have {N} numbers, it has {found}")))?;
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
            return Err(
                self.refuse(format!("`{name}` has {found} numbers, at most {N} are allowed"))
            );
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
        number.map_err(|_| self.refuse(format!("{name}=\"{text}\" must be a whole number")))
    }

    /// `true` or `false`; other words, such as `auto`, are `None`.
    pub(super) fn flag(&self, name: &str) -> Option<bool> {
        match self.text(name) {
            Some("true" | "1" | "enable") => Some(true),
            Some("false" | "0" | "disable") => Some(false),
            _ => None,
        }
    }
}

fn read(
    node: Node<'_, '_>,
    file: Option<&Rc<str>>,
    folder: &mut Folder<'_>,
    depth: usize,
) -> Result<Element, String> {
    let mut element = Element {
        tag: node.tag_name().name().to_owned(),
        file: file.cloned(),
        line: node.document().text_pos_at(node.range().start).row,
        attributes: node
            .attributes()
            .map(|a| (a.name().to_owned(), a.value().to_owned()))
            .collect(),
        children: Vec::new(),
    };
    for child in node.children().filter(Node::is_element) {
        let child_element = read(child, file, folder, depth)?;
        if child_element.tag == "include" {
            element.children.extend(included(&child_element, folder, depth)?);
        } else {
            element.children.push(child_element);
        }
    }
    Ok(element)
}

/// Parses XML that is not nested so deeply that the parser's stack would overflow.
fn parsed(text: &str) -> Result<Document<'_>, String> {
    if deepest(text) > DEEPEST_ELEMENT {
        return Err(format!("elements are nested more than {DEEPEST_ELEMENT} deep"));
    }
    Document::parse(text).map_err(|error| error.to_string())
}

/// How many elements are inside each other, at most. Attributes contain no `<`; tags in comments count too.
fn deepest(text: &str) -> usize {
    let (mut depth, mut deepest) = (0_usize, 0);
    for tag in text.split('<').skip(1) {
        let is_empty = tag.split('>').next().is_some_and(|tag| tag.ends_with('/'));
        if tag.starts_with('/') {
            depth = depth.saturating_sub(1);
        } else if !is_empty && !tag.starts_with(['!', '?']) {
            depth += 1;
            deepest = deepest.max(depth);
        }
    }
    deepest
}

/// Children of the root of an included file.
fn included(
    include: &Element,
    folder: &mut Folder<'_>,
    depth: usize,
) -> Result<Vec<Element>, String> {
    let name = include.text("file").ok_or_else(|| include.refuse("it has no `file`"))?;
    if depth == 0 {
        return Err(include.refuse(format!("files are included more than {DEEPEST_INCLUDE} deep")));
    }
    let (path, bytes) = folder.read("", name).map_err(|error| include.refuse(error))?;
    let text = std::str::from_utf8(&bytes).map_err(|_| include.refuse("it is not UTF-8 text"))?;
    let document = parsed(text).map_err(|error| include.refuse(error))?;
    let root = read(document.root_element(), Some(&Rc::from(path)), folder, depth - 1)?;
    Ok(root.children)
}

/// Attributes that state an orientation. An element's own replaces that of its class.
pub(super) const ORIENTATIONS: [&str; 5] = ["quat", "axisangle", "euler", "xyaxes", "zaxis"];
/// Actuators share one default, whatever their tag.
const ACTUATORS: [&str; 5] = ["general", "motor", "position", "velocity", "damper"];
const MAIN: &str = "main";

/// Default classes: attributes by tag, with those of the parent classes.
#[derive(Debug)]
pub(super) struct Classes(BTreeMap<String, BTreeMap<String, BTreeMap<String, String>>>);

impl Classes {
    /// Reads all `default` elements of a document.
    pub(super) fn new(root: &Element) -> Result<Self, String> {
        let mut classes = Self(BTreeMap::from([(MAIN.to_owned(), BTreeMap::new())]));
        for default in root.all("default") {
            let name = default.text("class").unwrap_or(MAIN);
            let parent = classes.0.remove(name).unwrap_or_default();
            if name != MAIN {
                classes.0.insert(MAIN.to_owned(), parent.clone());
            }
            classes.add(default, name, parent)?;
        }
        Ok(classes)
    }

    fn add(
        &mut self,
        default: &Element,
        name: &str,
        mut class: BTreeMap<String, BTreeMap<String, String>>,
    ) -> Result<(), String> {
        for child in default.children.iter().filter(|child| child.tag != "default") {
            overlay(class.entry(slot(&child.tag).to_owned()).or_default(), &child.attributes);
        }
        for child in default.all("default") {
            let name = child.text("class").ok_or_else(|| child.refuse("it has no `class`"))?;
            self.add(child, name, class.clone())?;
        }
        self.0.insert(name.to_owned(), class);
        Ok(())
    }

    /// An element with the attributes of its class: its own `class`, else `childclass`, else the main class. It has no
    /// children.
    pub(super) fn resolve(
        &self,
        element: &Element,
        childclass: Option<&str>,
    ) -> Result<Element, String> {
        let name = element.text("class").or(childclass).unwrap_or(MAIN);
        let class = self.0.get(name);
        let class =
            class.ok_or_else(|| element.refuse(format!("no default has the class `{name}`")))?;
        let mut attributes = class.get(slot(&element.tag)).cloned().unwrap_or_default();
        overlay(&mut attributes, &element.attributes);
        Ok(element.with(attributes))
    }
}

fn slot(tag: &str) -> &str {
    if ACTUATORS.contains(&tag) { "actuator" } else { tag }
}

fn overlay(base: &mut BTreeMap<String, String>, top: &BTreeMap<String, String>) {
    if ORIENTATIONS.iter().any(|name| top.contains_key(*name)) {
        ORIENTATIONS.iter().for_each(|name| drop(base.remove(*name)));
    }
    base.extend(top.iter().map(|(name, value)| (name.clone(), value.clone())));
}

/// Refuses a second element with the same name.
pub(super) fn check_names<'a>(elements: impl Iterator<Item = &'a Element>) -> Result<(), String> {
    let mut names = BTreeSet::new();
    for element in elements {
        if let Some(name) = element.text("name")
            && !names.insert(name)
        {
            return Err(element.refuse("another element has the same name"));
        }
    }
    Ok(())
}
