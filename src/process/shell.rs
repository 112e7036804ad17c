//! Words of a shell: a leading `~` in arguments, which a shell replaces only at the beginning of a word, so that
//! `run.dir=~/x` and `--out=~/x` keep it; and paths in the commands that messages print.

use std::ffi::OsString;
use std::os::unix::ffi::OsStrExt as _;
use std::path::{Component, Path, PathBuf};

use crate::errors::Usage;

/// An argument as one word of a shell.
pub(crate) fn word(argument: &str) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "_-.,:/@%+=".contains(letter);
    if !argument.is_empty() && argument.chars().all(plain) {
        argument.to_owned()
    } else {
        format!("'{}'", argument.replace('\'', r"'\''"))
    }
}

/// A path as one word of a shell that no command takes for an option.
pub(crate) fn path(path: &Path) -> String {
    let bytes = path.as_os_str().as_bytes();
    let place = if bytes.starts_with(b"-") { "./" } else { "" };
    match path.to_str() {
        Some(shown) => word(&format!("{place}{shown}")),
        None => {
            let octal = |byte: &u8| match byte {
                b'/' | b'.' | b'_' | b'-' => char::from(*byte).to_string(),
                _ if byte.is_ascii_alphanumeric() => char::from(*byte).to_string(),
                _ => format!("\\{byte:03o}"),
            };
            let escaped: String = bytes.iter().map(octal).collect();
            format!("\"$(printf '{place}{escaped}')\"")
        }
    }
}

/// Why arguments that are no text are refused, where settings or task files would contain one of them.
pub(crate) fn not_text(arguments: &[OsString]) -> String {
    let shown: Vec<String> = arguments.iter().map(|argument| format!("{argument:?}")).collect();
    let shown = shown.join(" or ");
    format!(
        "{shown} is not UTF-8, which this argument must be; rename the file or folder, or make a link to it"
    )
}

/// The path, with the home folder in the place of a leading `~`.
///
/// # Errors
/// The path begins with the name of a user's home, as in `~name/x`, or there is no home folder.
pub(crate) fn expanded(path: &Path) -> Result<PathBuf, Usage> {
    expanded_for(path, std::env::var_os("HOME"))
}

/// As [`expanded`], for text that may also be something else than a path.
pub(crate) fn expanded_text(text: &str) -> Result<String, Usage> {
    if text.starts_with('~') {
        expanded(Path::new(text)).map(|path| path.to_string_lossy().into_owned())
    } else {
        Ok(text.to_owned())
    }
}

fn expanded_for(path: &Path, home: Option<OsString>) -> Result<PathBuf, Usage> {
    let Some(Component::Normal(first)) = path.components().next() else {
        return Ok(path.to_path_buf());
    };
    let shown = path.display();
    if first != "~" {
        return if first.as_bytes().starts_with(b"~") {
            Err(Usage::new(format!(
                "{shown}: write the whole path of the home folder, or ./{shown} for a folder of this name"
            )))
        } else {
            Ok(path.to_path_buf())
        };
    }
    match home.map(PathBuf::from).filter(|home| home.is_absolute()) {
        Some(home) => Ok(path.strip_prefix("~").map_or(home.clone(), |rest| home.join(rest))),
        None => Err(Usage::new(format!("{shown}: HOME is not set; write the whole path"))),
    }
}

#[cfg(test)]
mod tests {
    use std::ffi::OsStr;
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
        let name = OsStr::from_bytes(b"-a\xff'b$/%s c");
        let echo = format!("printf %s {}", path(Path::new(name)));
        let read = Command::new("sh").args(["-c", &echo]).output().unwrap().stdout;
        assert_eq!(read, [b"./", name.as_bytes()].concat());
        assert_eq!(path(Path::new("runs/a-1")), "runs/a-1");
        assert_eq!(path(Path::new("-x y")), "'./-x y'");
    }

    #[test]
    fn only_a_leading_tilde_stands_for_the_home_folder() {
        let expand = |path: &str, home: Option<&str>| {
            let found = expanded_for(Path::new(path), home.map(OsString::from));
            found.map(|path| path.display().to_string()).map_err(|error| error.to_string())
        };
        for (path, whole) in [
            ("~/a b", "/h/me/a b"),
            ("a/~/b", "a/~/b"),
            ("./~x", "./~x"),
            ("/~/a", "/~/a"),
            ("", ""),
        ] {
            assert_eq!(expand(path, Some("/h/me")).as_deref(), Ok(whole));
        }
        assert!(expand("~you/a", Some("/h/me")).unwrap_err().contains("or ./~you/a for a folder"));
        assert!(expand("~/a", None).unwrap_err().contains("HOME is not set"));
    }
}
