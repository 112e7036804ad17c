//! An MJCF document as a tree of elements with their lines. Included files are inlined and default classes applied.

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use roxmltree::{Document, Node, ParsingOptions};

use super::folder::Folder;
use super::nesting::deepest;

/// Most elements inside each other, those of included files counted where they are included.
const DEEPEST_ELEMENT: usize = 200;
/// Nesting depth of included files.
const DEEPEST_INCLUDE: usize = 8;
/// Most nodes of a file: elements, comments and texts between them.
const MOST_NODES: u32 = 200_000;

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
        read(root, &Source::of(text, None), folder, Depth { elements: 1, includes: 0 })
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

    /// `true` or `false`; `None` without the attribute, or if it is `auto`.
    pub(super) fn flag(&self, name: &str) -> Result<Option<bool>, String> {
        match self.text(name) {
            None | Some("auto") => Ok(None),
            Some("true" | "1" | "enable") => Ok(Some(true)),
            Some("false" | "0" | "disable") => Ok(Some(false)),
            Some(word) => Err(self.refuse(format!("{name}=\"{word}\" must be true or false"))),
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
        file: source.file.clone(),
        line: source.line(node.range().start),
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

/// Refuses prefixes, which could give an element two attributes of one name, and text, such as a tag without its `<`.
fn check_plain(node: Node<'_, '_>, element: &Element) -> Result<(), String> {
    let root = node.document().root_element().tag_name();
    let prefixed = node.attributes().find(|attribute| attribute.namespace().is_some());
    if prefixed.is_some() || node.tag_name().namespace() != root.namespace() {
        return Err(element.refuse("names with a prefix are not supported"));
    }
    let texts = node.children().filter_map(|child| child.text().filter(|_| child.is_text()));
    match texts.map(str::trim).find(|text| !text.is_empty()) {
        None => Ok(()),
        Some(text) => {
            let start: String = text.chars().take(40).collect();
            Err(element.refuse(format!("text between elements has no meaning: {start}")))
        }
    }
}

/// Parses XML that is not nested so deeply that the parser's stack would overflow.
fn parsed(text: &str) -> Result<Document<'_>, String> {
    if deepest(text) > DEEPEST_ELEMENT {
        return Err(too_deep());
    }
    let options = ParsingOptions { nodes_limit: MOST_NODES, ..ParsingOptions::default() };
    Document::parse_with_options(text, options).map_err(|error| error.to_string())
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
    let name = include.text("file").ok_or_else(|| include.refuse("it has no `file`"))?;
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
/// Actuators share one default, whatever their tag.
const ACTUATORS: [&str; 5] = ["general", "motor", "position", "velocity", "damper"];
const MAIN: &str = "main";
/// Elements with defaults.
const DEFAULTS: [&str; 18] = [
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
];

/// Default classes: attributes by tag, with those of the parent classes.
#[derive(Debug)]
pub(super) struct Classes(BTreeMap<String, BTreeMap<String, BTreeMap<String, String>>>);

impl Classes {
    /// Reads all `default` elements of a document.
    pub(super) fn new(root: &Element) -> Result<Self, String> {
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
                return Err(format!("two defaults have the class `{name}`"));
            }
        }
        Ok(classes)
    }

    fn add(
        &mut self,
        default: &Element,
        name: &str,
        mut class: BTreeMap<String, BTreeMap<String, String>>,
    ) -> Result<(), String> {
        default.only(&[&["class"]])?;
        for child in default.children.iter().filter(|child| child.tag != "default") {
            if !DEFAULTS.contains(&child.tag.as_str()) {
                return Err(child.refuse("this element is not supported"));
            }
            overlay(class.entry(slot(&child.tag).to_owned()).or_default(), &child.attributes);
        }
        for child in default.all("default") {
            let name = child.text("class").ok_or_else(|| child.refuse("it has no `class`"))?;
            self.add(child, name, class.clone())?;
        }
        match self.0.insert(name.to_owned(), class) {
            None => Ok(()),
            Some(_) => Err(format!("two defaults have the class `{name}`")),
        }
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
        if let Some(child) = element.children.first() {
            return Err(child.refuse("this element is not supported"));
        }
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
