//! Paths that begin with `~`. A shell replaces it only at the beginning of a word, so `run.dir=~/x` and `--out=~/x` keep it.

use std::ffi::OsString;
use std::os::unix::ffi::OsStrExt as _;
use std::path::{Component, Path, PathBuf};

use crate::errors::Usage;

/// The path, with the home folder in the place of a leading `~`.
///
/// # Errors
/// The path begins with the name of a user's home, as in `~name/x`, or there is no home folder.
pub(crate) fn expanded(path: &Path) -> Result<PathBuf, Usage> {
    expanded_for(path, std::env::var_os("HOME"))
}

/// As [`expanded`], for text that may also be something else than a path.
pub(crate) fn expanded_text(text: &str) -> Result<String, Usage> {
    match text.starts_with('~') {
        true => expanded(Path::new(text)).map(|path| path.to_string_lossy().into_owned()),
        false => Ok(text.to_owned()),
    }
}

fn expanded_for(path: &Path, home: Option<OsString>) -> Result<PathBuf, Usage> {
    let Some(Component::Normal(first)) = path.components().next() else {
        return Ok(path.to_path_buf());
    };
    let shown = path.display();
    if first != "~" {
        return match first.as_bytes().starts_with(b"~") {
            true => Err(Usage::new(format!(
                "{shown}: write the whole path of the home folder, or ./{shown} for a folder of this name"
            ))),
            false => Ok(path.to_path_buf()),
        };
    }
    match home.map(PathBuf::from).filter(|home| home.is_absolute()) {
        Some(home) => Ok(path.strip_prefix("~").map_or(home.clone(), |rest| home.join(rest))),
        None => Err(Usage::new(format!("{shown}: HOME is not set; write the whole path"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_leading_tilde_stands_for_the_home_folder() {
        let told = |path: &str, home: Option<&str>| {
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
            assert_eq!(told(path, Some("/h/me")).as_deref(), Ok(whole));
        }
        assert!(told("~you/a", Some("/h/me")).unwrap_err().contains("or ./~you/a for a folder"));
        assert!(told("~/a", None).unwrap_err().contains("HOME is not set"));
    }
}
