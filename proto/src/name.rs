//! Names that can be shown on a terminal, and texts of peers made fit for it.

use std::fmt::Write as _;

/// Longest name of a peer or of a part of an environment, bytes.
pub const LONGEST: usize = 128;

/// First and last characters of ranges that are not visible, or change how the text around them is shown: Unicode's
/// property `Default_Ignorable_Code_Point`, the annotation characters, and the blank of Braille.
const INVISIBLE: [(char, char); 18] = [
    ('\u{ad}', '\u{ad}'),
    ('\u{34f}', '\u{34f}'),
    ('\u{61c}', '\u{61c}'),
    ('\u{115f}', '\u{1160}'),
    ('\u{17b4}', '\u{17b5}'),
    ('\u{180b}', '\u{180f}'),
    ('\u{200b}', '\u{200f}'),
    ('\u{202a}', '\u{202e}'),
    ('\u{2060}', '\u{206f}'),
    ('\u{2800}', '\u{2800}'),
    ('\u{3164}', '\u{3164}'),
    ('\u{fe00}', '\u{fe0f}'),
    ('\u{feff}', '\u{feff}'),
    ('\u{ffa0}', '\u{ffa0}'),
    ('\u{fff0}', '\u{fffb}'),
    ('\u{1bca0}', '\u{1bca3}'),
    ('\u{1d173}', '\u{1d17a}'),
    ('\u{e0000}', '\u{e0fff}'),
];

/// Checks that a name of at most `most` bytes is one line that shows all its characters and begins and ends with a
/// visible one.
///
/// # Errors
/// If it is not: words that continue a sentence about it.
pub fn check(name: &str, most: usize) -> Result<(), String> {
    let found = name.len();
    if name.is_empty() {
        return Err("is empty".to_owned());
    }
    if found > most {
        return Err(format!("has {found} bytes, at most {most} are allowed"));
    }
    if let Some(character) = name.chars().find(|c| is_invisible(*c)) {
        return Err(format!("has the invisible character U+{:04X}", u32::from(character)));
    }
    if name.starts_with(' ') || name.ends_with(' ') {
        return Err("begins or ends with a space".to_owned());
    }
    Ok(())
}

/// A text as one line that shows all its characters: spaces and line breaks become one space each, and an invisible
/// character becomes its number.
#[must_use]
pub fn printable(text: &str) -> String {
    let mut line = String::with_capacity(text.len());
    for word in text.split_whitespace() {
        let gap = if line.is_empty() { "" } else { " " };
        line.push_str(gap);
        for character in word.chars() {
            if is_invisible(character) {
                _ = write!(line, "<U+{:04X}>", u32::from(character))
            } else {
                line.push(character)
            }
        }
    }
    line
}

/// Whether a character is neither visible nor the space.
fn is_invisible(character: char) -> bool {
    let within = |(first, last): &(char, char)| (*first..=*last).contains(&character);
    let is_space = character.is_whitespace() && character != ' ';
    character.is_control() || is_space || INVISIBLE.iter().any(within)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_shows_all_its_characters() {
        for name in ["a", "front thigh", "host-7/2", "Fuß", "关节", "x".repeat(128).as_str()] {
            assert_eq!(check(name, LONGEST), Ok(()), "{name}");
        }
        let refused = |name: &str| check(name, LONGEST).unwrap_err();
        assert_eq!(refused(""), "is empty");
        assert_eq!(refused(&"x".repeat(129)), "has 129 bytes, at most 128 are allowed");
        for name in [" a", "a ", " "] {
            assert_eq!(refused(name), "begins or ends with a space");
        }
        for hidden in "\0\t\n\r\u{1b}\u{7f}\u{85}\u{9b}\u{a0}\u{ad}\u{61c}\u{200b}\u{200d}\u{200e}\u{200f}\u{2028}\u{2029}\
            \u{202a}\u{202e}\u{2060}\u{2066}\u{2069}\u{3000}\u{3164}\u{feff}\u{e0041}"
            .chars()
        {
            for name in [format!("a{hidden}b"), format!("{hidden}"), format!("a{hidden}")] {
                let number = format!("U+{:04X}", u32::from(hidden));
                assert!(refused(&name).ends_with(&number), "{name:?}");
            }
        }
        assert_eq!(refused("a\u{202e}b"), "has the invisible character U+202E");
    }

    #[test]
    fn a_text_becomes_one_line_without_invisible_characters() {
        assert_eq!(printable(" a \r\n\u{2028} b\tc\u{a0} "), "a b c");
        assert_eq!(printable("\u{1b}[2Ja\u{202e}b"), "<U+001B>[2Ja<U+202E>b");
        assert_eq!(printable("Fuß ± 1"), "Fuß ± 1");
    }
}
