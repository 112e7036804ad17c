//! Parses documents: included files are inlined, and lines are kept.

use std::collections::BTreeMap;
use std::rc::Rc;

use roxmltree::{Document, Error, Node, ParsingOptions};

use super::super::folder::Folder;
use super::super::nesting::first_deeper;
use super::{Element, Place, start};

/// Most elements inside each other, those of included files counted where they are included.
const DEEPEST_ELEMENT: usize = 200;
/// Nesting depth of included files.
const DEEPEST_INCLUDE: usize = 8;
/// Attributes that, as in MuJoCo, count as absent if they are empty.
const EMPTY_IS_NONE: [&str; 14] = [
    "name",
    "body1",
    "body2",
    "joint",
    "joint1",
    "joint2",
    "mesh",
    "site1",
    "site2",
    "axisangle",
    "euler",
    "quat",
    "xyaxes",
    "zaxis",
];
const ROOT_END: &str = "</mujoco>";
/// Most nodes of a file: elements, comments and texts between them.
const MOST_NODES: u32 = 200_000;

impl Element {
    /// Parses a document and all files that it includes.
    pub(in crate::robot) fn parse(text: &str, folder: &mut Folder<'_>) -> Result<Self, String> {
        let document = parsed(text)?;
        let root = document.root_element();
        if root.tag_name().name() != "mujoco" {
            return Err(format!(
                "the document is <{}>, not <mujoco>; name an MJCF file",
                root.tag_name().name()
            ));
        }
        read(root, &Source::of(text, None, None), folder, 1)
    }
}

/// A file of a document.
struct Source<'a> {
    /// `None` for the document itself.
    file: Option<Rc<str>>,
    /// The file that includes it.
    outer: Option<&'a Source<'a>>,
    /// Bytes before the end of each line.
    line_ends: Vec<usize>,
}

impl<'a> Source<'a> {
    fn of(text: &str, file: Option<Rc<str>>, outer: Option<&'a Self>) -> Self {
        let line_ends = text.match_indices('\n').map(|(at, _)| at).collect();
        Self { file, outer, line_ends }
    }

    /// Number of the line with this byte.
    fn line(&self, byte: usize) -> u32 {
        self.line_ends.partition_point(|end| *end < byte) as u32 + 1
    }
}

/// Reads an element that is inside `depth` elements, with itself.
fn read(
    node: Node<'_, '_>,
    source: &Source<'_>,
    folder: &mut Folder<'_>,
    depth: usize,
) -> Result<Element, String> {
    let mut element = Element {
        tag: node.tag_name().name().to_owned(),
        place: Some(Place { file: source.file.clone(), line: source.line(node.range().start) }),
        stated: BTreeMap::new(),
        attributes: node
            .attributes()
            .filter(|a| !a.value().is_empty() || !EMPTY_IS_NONE.contains(&a.name()))
            .map(|a| (a.name().to_owned(), a.value().to_owned()))
            .collect(),
        children: Vec::new(),
    };
    if depth > DEEPEST_ELEMENT {
        return Err(element.refuse(too_deep()));
    }
    folder.count_element().map_err(|reason| element.refuse(reason))?;
    check_plain(node, &element)?;
    for child in node.children().filter(Node::is_element) {
        let child_element = read(child, source, folder, depth + 1)?;
        if child_element.tag == "include" {
            element.children.extend(included(&child_element, source, folder, depth)?);
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

/// Parses XML that is not nested so deeply that the parser's stack would overflow.
fn parsed(text: &str) -> Result<Document<'_>, String> {
    if let Some(at) = first_deeper(text, DEEPEST_ELEMENT) {
        return Err(format!("line {}: {}", text[..at].matches('\n').count() + 1, too_deep()));
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
    parsed.map_err(|error| match error {
        Error::DtdDetected => {
            let before = text.find("<!DOCTYPE").map_or(text, |at| &text[..at]);
            format!("line {}: a DTD is not supported; remove it", before.matches('\n').count() + 1)
        }
        Error::UnexpectedEndOfStream | Error::UnclosedRootNode => {
            let last = text.matches('\n').count() + 1;
            format!(
                "it must be valid XML: it ends in line {last}, before all elements do; add the rest"
            )
        }
        error => format!("it must be valid XML: {error}"),
    })
}

fn too_deep() -> String {
    format!("elements are nested more than {DEEPEST_ELEMENT} deep; nest fewer")
}

/// Children of the root of a file that an element of `source` includes, in the place of this root.
fn included(
    include: &Element,
    source: &Source<'_>,
    folder: &mut Folder<'_>,
    depth: usize,
) -> Result<Vec<Element>, String> {
    include.only(&[&["file"]])?;
    let name = include.text("file").ok_or_else(|| include.refuse("it has no `file`; add one"))?;
    let files = || std::iter::successors(Some(source), |file| file.outer);
    if files().count() > DEEPEST_INCLUDE {
        return Err(include.refuse(format!("files are included more than {DEEPEST_INCLUDE} deep")));
    }
    let (path, text) =
        folder.read_document(name, include.file()).map_err(|error| include.refuse(error))?;
    if files().any(|file| file.file.as_deref().unwrap_or(&folder.path) == path) {
        return Err(include.refuse(format!("{path} includes itself; remove one <include>")));
    }
    let document = parsed(&text).map_err(|error| include.refuse(format!("{path}: {error}")))?;
    let source = Source::of(&text, Some(Rc::from(path)), Some(source));
    Ok(read(document.root_element(), &source, folder, depth)?.children)
}
