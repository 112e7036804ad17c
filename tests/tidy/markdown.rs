//! The pieces of Markdown that the other rules look at.

/// What stands between single back quotes outside fenced blocks, with its line number from 1.
pub(crate) fn inline_code(body: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (number, line) in outside_fences(body) {
        let quoted = line.split('`').skip(1).step_by(2);
        found.extend(quoted.map(|code| (number, code.to_owned())));
    }
    found
}

/// The lines inside fenced blocks.
pub(crate) fn fenced_lines(body: &str) -> Vec<String> {
    let (mut inside, mut found) = (false, Vec::new());
    for line in body.lines() {
        if line.starts_with("```") {
            inside = !inside;
        } else if inside {
            found.push(line.to_owned());
        }
    }
    found
}

/// The cells of every table row outside fenced blocks, trimmed; separator rows are left out.
pub(crate) fn table_rows(body: &str) -> Vec<Vec<String>> {
    let rows = outside_fences(body).into_iter().map(|(_, line)| line.trim().to_owned());
    let rows = rows.filter(|line| line.starts_with('|') && !line.starts_with("| ---"));
    rows.map(|line| cells(line.trim_matches('|'))).collect()
}

/// Targets of links that lead to files of the project, with their line numbers.
pub(crate) fn local_links(body: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (number, line) in outside_fences(body) {
        let targets = line.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        let local = targets.filter(|target| !target.contains("://") && !target.starts_with('#'));
        found.extend(
            local.map(|target| (number, target.split('#').next().unwrap_or("").to_owned())),
        );
    }
    found
}

fn cells(row: &str) -> Vec<String> {
    row.split('|').map(|cell| cell.trim().to_owned()).collect()
}

fn outside_fences(body: &str) -> Vec<(usize, &str)> {
    let (mut inside, mut found) = (false, Vec::new());
    for (index, line) in body.lines().enumerate() {
        if line.starts_with("```") {
            inside = !inside;
        } else if !inside {
            found.push((index + 1, line));
        }
    }
    found
}

#[test]
fn code_links_and_tables_are_told_from_fenced_text() {
    let text = "a `b.rs` [c](d.md#e)\n```\n`f.rs`\n```\n| g | `h` |\n| --- | --- |\n";
    assert_eq!(inline_code(text), [(1, "b.rs".to_owned()), (5, "h".to_owned())]);
    assert_eq!(local_links(text), [(1, "d.md".to_owned())]);
    assert_eq!(fenced_lines(text), ["`f.rs`"]);
    assert_eq!(table_rows(text), [["g", "`h`"]]);
}
