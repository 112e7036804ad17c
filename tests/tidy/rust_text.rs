//! Just enough of Rust's surface, read line by line: code without comments, and the items that doc
//! comments stand above. It does not parse; strings that hold `//` are cut short, which no rule minds.

/// An item with the doc comment directly above it.
pub(crate) struct RustItem {
    /// Name after `fn`, `struct`, `enum`, `trait`, `type` or `const`.
    pub(crate) name: String,
    /// Doc lines without their slashes, joined by newlines.
    pub(crate) doc: String,
    /// Whether `#[test]` stands above it.
    pub(crate) is_test: bool,
}

/// The lines that hold code, numbered from 1, comments cut off.
pub(crate) fn code_lines(body: &str) -> impl Iterator<Item = (usize, &str)> {
    let cut = body.lines().map(|line| line.split("//").next().unwrap_or(line));
    cut.enumerate()
        .map(|(index, line)| (index + 1, line))
        .filter(|(_, line)| !line.trim().is_empty())
}

/// Every named item of a file with what stands above it.
pub(crate) fn items(body: &str) -> Vec<RustItem> {
    let mut found = Vec::new();
    let (mut doc, mut attributes) = (Vec::new(), String::new());
    for line in body.lines().map(str::trim) {
        if let Some(text) = line.strip_prefix("///") {
            doc.push(text.trim().to_owned());
        } else if line.starts_with("#[") {
            attributes.push_str(line);
        } else {
            if let Some(name) = item_name(line) {
                let is_test = attributes.contains("#[test]");
                found.push(RustItem { name, doc: doc.join("\n"), is_test });
            }
            doc.clear();
            attributes.clear();
        }
    }
    found
}

fn item_name(line: &str) -> Option<String> {
    const KINDS: [&str; 6] = ["fn", "struct", "enum", "trait", "type", "const"];
    let mut words = line.split_whitespace().skip_while(|word| {
        word.starts_with("pub")
            || ["async", "unsafe", "extern"].contains(word)
            || *word == "default"
    });
    let kind = words.next()?;
    let mut next = words.next()?;
    if kind == "const" && next == "fn" {
        next = words.next()?;
    }
    let end =
        next.find(|letter: char| !letter.is_alphanumeric() && letter != '_').unwrap_or(next.len());
    (KINDS.contains(&kind) && end > 0).then(|| next[..end].to_owned())
}

#[test]
fn an_item_is_found_under_its_doc_and_attributes() {
    let text = "/// Eq. (4): x.\n#[test]\npub(crate) const fn name<T>(x: T) {}\n\nstruct Other;\n";
    let found = items(text);
    assert_eq!(found.iter().map(|item| item.name.as_str()).collect::<Vec<_>>(), ["name", "Other"]);
    assert_eq!((found[0].doc.as_str(), found[0].is_test), ("Eq. (4): x.", true));
    assert_eq!((found[1].doc.as_str(), found[1].is_test), ("", false));
}
