//! `docs/PAPER.md` and the code name the same equations, both ways. In the code an item that is an
//! equation opens its doc comment with `Eq. (N)`; any other doc may mention one in passing.

use std::collections::{BTreeMap, BTreeSet};

use crate::assert_none;
use crate::markdown::table_rows;
use crate::repository::{read, rust_files};
use crate::rust_text::{RustItem, items};

/// The paper numbers its equations from 1 to 10.
const EQUATIONS: std::ops::RangeInclusive<u32> = 1..=10;

/// One row of the map: an equation, the item that is it, and the tests that hold it to it.
struct Row {
    equation: u32,
    item: (String, String),
    tests: Vec<(String, String)>,
}

/// `Eq. (4)` at the start of a text.
fn equation_at_start(text: &str) -> Option<u32> {
    text.strip_prefix("Eq. (")?.split(')').next()?.parse().ok()
}

/// `path` and `name` pairs from a cell such as "`a/b.rs`: `f`, `g`; `c.rs`: `h`".
fn named_items(cell: &str) -> Vec<(String, String)> {
    let mut path = String::new();
    let mut found = Vec::new();
    for code in cell.split('`').skip(1).step_by(2) {
        if code.ends_with(".rs") {
            path = code.to_owned();
        } else {
            found.push((path.clone(), code.to_owned()));
        }
    }
    found
}

fn rows() -> Vec<Row> {
    let mut found = Vec::new();
    for cells in table_rows(&read("docs/PAPER.md")).into_iter().filter(|cells| cells.len() == 4) {
        let Some(equation) = equation_at_start(&cells[0]) else { continue };
        for item in named_items(&cells[2]) {
            found.push(Row { equation, item, tests: named_items(&cells[3]) });
        }
    }
    found
}

/// Equations, or forms of them, that have no code, each with its reason.
fn not_built() -> Vec<(u32, String)> {
    let cells = table_rows(&read("docs/PAPER.md")).into_iter().filter(|cells| cells.len() == 2);
    cells.filter_map(|cells| Some((equation_at_start(&cells[0])?, cells[1].clone()))).collect()
}

fn items_by_file() -> BTreeMap<String, Vec<RustItem>> {
    rust_files().into_iter().map(|file| (file.path, items(&file.body))).collect()
}

fn find<'a>(
    all: &'a BTreeMap<String, Vec<RustItem>>,
    place: &(String, String),
) -> Vec<&'a RustItem> {
    let (path, name) = place;
    let name = name.rsplit("::").next().unwrap_or(name);
    all.get(path).into_iter().flatten().filter(|item| item.name == name).collect()
}

#[test]
fn every_equation_of_the_paper_is_built_or_has_a_reason_why_not() {
    let built: BTreeSet<u32> = rows().iter().map(|row| row.equation).collect();
    let excused = not_built();
    let mut offenders = Vec::new();
    for number in EQUATIONS {
        if !built.contains(&number) && !excused.iter().any(|(other, _)| *other == number) {
            offenders.push(format!("Eq. ({number}) is in neither table of docs/PAPER.md"));
        }
    }
    let mute = excused.iter().filter(|(_, reason)| reason.len() < 30);
    offenders
        .extend(mute.map(|(number, _)| format!("Eq. ({number}): give the reason in a sentence")));
    assert_none("the map of the paper has holes:", &offenders);
}

#[test]
fn every_row_of_the_map_leads_to_an_item_that_opens_with_its_equation() {
    let all = items_by_file();
    let mut offenders = Vec::new();
    for Row { equation, item, .. } in rows() {
        let found = find(&all, &item);
        let (path, name) = &item;
        if found.is_empty() {
            offenders.push(format!("Eq. ({equation}): no `{name}` in {path}"));
        } else if !found.iter().any(|item| equation_at_start(&item.doc) == Some(equation)) {
            offenders
                .push(format!("{path}: the doc of `{name}` must open with `Eq. ({equation})`"));
        }
    }
    assert_none("docs/PAPER.md names what the code does not have:", &offenders);
}

#[test]
fn every_row_of_the_map_names_tests_that_exist() {
    let all = items_by_file();
    let mut offenders = Vec::new();
    for Row { equation, tests, .. } in rows() {
        if tests.is_empty() {
            offenders.push(format!("Eq. ({equation}): no test"));
        }
        let wrong = tests.iter().filter(|place| !find(&all, place).iter().any(|item| item.is_test));
        offenders.extend(
            wrong.map(|(path, name)| format!("Eq. ({equation}): no test `{name}` in {path}")),
        );
    }
    assert_none("docs/PAPER.md names tests that do not exist:", &offenders);
}

#[test]
fn every_equation_in_the_code_stands_in_the_map() {
    let rows = rows();
    let mut offenders = Vec::new();
    for (path, items) in items_by_file() {
        for item in items {
            let Some(equation) = equation_at_start(&item.doc) else { continue };
            let named = |row: &&Row| row.equation == equation && row.item.0 == path;
            let last = |row: &Row| row.item.1.rsplit("::").next() == Some(item.name.as_str());
            if !rows.iter().filter(named).any(last) {
                offenders.push(format!("{path}: `{}` is Eq. ({equation})", item.name));
            }
        }
    }
    assert_none("an equation in the code is missing from docs/PAPER.md:", &offenders);
}
