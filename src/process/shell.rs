//! Words of the commands that messages print, so that a shell reads them as they are meant.

use std::path::Path;

/// An argument as one word of a shell.
pub(crate) fn word(argument: &str) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "_-.,:/@%+=".contains(letter);
    match !argument.is_empty() && argument.chars().all(plain) {
        true => argument.to_owned(),
        false => format!("'{}'", argument.replace('\'', r"'\''")),
    }
}

/// A path as one word of a shell that no command takes for an option.
pub(crate) fn path(path: &Path) -> String {
    let shown = path.to_string_lossy();
    match shown.starts_with('-') {
        true => word(&format!("./{shown}")),
        false => word(&shown),
    }
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn a_shell_reads_every_word_as_it_is() {
        for name in ["runs/a", "my run", "it's", "$HOME;ls", "a\"b\\c", "*", "~", "!x", "é", "a=b"]
        {
            let echo = format!("printf %s {}", path(Path::new(name)));
            let read = Command::new("sh").args(["-c", &echo]).output().unwrap().stdout;
            assert_eq!(String::from_utf8(read).unwrap(), name);
        }
        assert_eq!(path(Path::new("runs/a-1")), "runs/a-1");
        assert_eq!(path(Path::new("-x y")), "'./-x y'");
    }
}
