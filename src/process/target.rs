//! Files and folders that commands write. An existing file is replaced, and one with an unusual extension written, only on
//! request. A file appears complete or not at all.

use std::fs::File;
use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use learner::store::{durable, plain_file};

use crate::errors::Usage;

/// What happens to existing files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Existing {
    /// They stay, and the command is refused.
    Kept,
    /// They are replaced.
    Replaced,
}

/// Permission to replace files.
#[derive(Args, Clone, Copy, Debug, Default)]
pub(crate) struct ForceArguments {
    /// Replace existing files, and write a file with any extension.
    #[arg(long)]
    force: bool,
}

impl ForceArguments {
    /// What happens to existing files.
    pub(crate) fn existing(self) -> Existing {
        if self.force { Existing::Replaced } else { Existing::Kept }
    }
}

/// A file to write.
#[derive(Debug)]
pub(crate) struct Target {
    path: PathBuf,
    existing: Existing,
}

impl Target {
    /// The file that `option` names, for content that files with this `extension` have.
    ///
    /// # Errors
    /// It is a folder, is in no existing folder, exists, or has another extension.
    pub(crate) fn named(
        option: &str,
        path: &Path,
        extension: &str,
        existing: Existing,
    ) -> Result<Self, Usage> {
        let refused = |why: &str| Err(Usage::new(format!("{option} {}: {why}", path.display())));
        if path.is_dir() || path.as_os_str().as_encoded_bytes().ends_with(b"/") {
            return refused("is a folder; name a file");
        }
        check_parent(option, path)?;
        let other = path.extension().is_some_and(|found| !found.eq_ignore_ascii_case(extension));
        if other && existing == Existing::Kept {
            return refused(&format!(
                "the file has the format of .{extension}; name it so, or pass --force"
            ));
        }
        demand_free(option, [path.to_path_buf()], existing)?;
        Ok(Self { path: path.to_path_buf(), existing })
    }

    /// A file that the program keeps up to date under a fixed name.
    ///
    /// # Errors
    /// A link, a pipe or a device has this name.
    pub(crate) fn fixed(path: &Path) -> anyhow::Result<Self> {
        match plain_file::refusal(path) {
            None => Ok(Self { path: path.to_path_buf(), existing: Existing::Replaced }),
            Some(why) => anyhow::bail!("cannot write {}: {why}", path.display()),
        }
    }

    /// The file.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the file, and waits until the disk has it: some file systems report a full disk only then.
    pub(crate) fn write(&self, bytes: &[u8]) -> anyhow::Result<()> {
        let written = |draft: &Path| {
            let mut file = File::create_new(draft)?;
            file.write_all(bytes)?;
            file.sync_all()
        };
        let shown = self.path.display();
        self.fill(|draft| written(draft).with_context(|| format!("cannot write {shown}")))
    }

    /// Refuses a file that cannot be written, before the work whose results it is for. Changes nothing.
    ///
    /// # Errors
    /// Names the file.
    pub(crate) fn demand_writable(&self) -> anyhow::Result<()> {
        let shown = self.path.display();
        let draft = self.draft();
        File::create_new(&draft.0).map(drop).with_context(|| format!("cannot write {shown}"))
    }

    /// Lets `write` make the file at a temporary path, and gives it its name when it is complete.
    pub(crate) fn fill<T>(
        &self,
        write: impl FnOnce(&Path) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let draft = self.draft();
        let written = write(&draft.0)?;
        self.publish(&draft)?;
        Ok(written)
    }

    fn draft(&self) -> Draft {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        // Processes on several machines may write the same file at the same time.
        let random = RandomState::new().build_hasher().finish();
        Draft(self.path.with_file_name(format!(".tmp-{random:016x}-{name}")))
    }

    fn publish(&self, draft: &Draft) -> anyhow::Result<()> {
        let shown = self.path.display();
        if self.existing == Existing::Kept {
            match std::fs::hard_link(&draft.0, &self.path) {
                Ok(()) => return Ok(()),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                    return Err(taken("", &self.path).into());
                }
                // Not every file system supports links.
                Err(_) => {}
            }
        }
        std::fs::rename(&draft.0, &self.path).with_context(|| format!("cannot write {shown}"))
    }
}

/// A temporary file, removed if it still has its name when it is dropped.
struct Draft(PathBuf);

impl Drop for Draft {
    fn drop(&mut self) {
        let _renamed = std::fs::remove_file(&self.0);
    }
}

/// Refuses files that exist, unless they may be replaced. Pipes, devices and links to them are never replaced.
pub(crate) fn demand_free(
    option: &str,
    paths: impl IntoIterator<Item = PathBuf>,
    existing: Existing,
) -> Result<(), Usage> {
    for path in paths {
        let Ok(found) = path.symlink_metadata() else { continue };
        let leads_to_device = path.metadata().is_ok_and(|to| !to.is_file() && !to.is_dir());
        let refusal = match plain_file::refusal(&path).filter(|_| !found.is_symlink()) {
            None if leads_to_device => {
                Some("is a link to a pipe or device; name a file".to_owned())
            }
            why => why.map(|why| why.to_string()),
        };
        if let Some(why) = refusal {
            return Err(Usage::new(format!("{option} {}: {why}", path.display())));
        }
        if existing == Existing::Kept {
            return Err(taken(&format!("{option} "), &path));
        }
    }
    Ok(())
}

fn taken(option: &str, path: &Path) -> Usage {
    let advice = "name another place, or pass --force to replace it";
    Usage::new(format!("{option}{}: already exists; {advice}", path.display()))
}

/// Refuses a path in a folder that does not exist, which is probably misspelt.
pub(crate) fn check_parent(option: &str, path: &Path) -> Result<(), Usage> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    match parent.filter(|parent| !parent.is_dir()) {
        None => Ok(()),
        Some(parent) => Err(Usage::new(format!(
            "{option} {}: there is no folder {}; create it first",
            path.display(),
            parent.display()
        ))),
    }
}

/// Extensions of the files that commands write into folders.
const EXTENSIONS: [&str; 5] = ["csv", "onnx", "png", "svg", "xml"];

/// Writes or replaces a file with a fixed name in an existing folder.
pub(crate) fn file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    Target::fixed(path)?.write(bytes)
}

/// Creates the folder that `option` names, if necessary. Refuses it if the folder around it does not exist, which is
/// probably a misspelt path, or if it is a file or a new folder with the name of one.
pub(crate) fn option_folder(option: &str, path: &Path) -> anyhow::Result<()> {
    let refused = |why| Err(Usage::new(format!("{option} {}: {why}", path.display())).into());
    if path.is_file() {
        return refused("is a file; name a folder");
    }
    let is_named_file =
        path.extension().is_some_and(|found| EXTENSIONS.iter().any(|one| found == *one));
    if is_named_file && !path.exists() {
        return refused(
            "has the name of a file; name a folder, for the command writes several files",
        );
    }
    check_parent(option, path)?;
    Ok(durable::make_folder(path)?)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn an_existing_file_and_another_extension_need_permission() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let named = |name: &str, existing| Target::named("--out", &path(name), "png", existing);
        named("a.PNG", Existing::Kept).unwrap().write(b"new").unwrap();
        let taken = named("a.PNG", Existing::Kept).unwrap_err().to_string();
        assert!(taken.ends_with("pass --force to replace it"), "{taken}");
        let other = named("x.mp4", Existing::Kept).unwrap_err().to_string();
        assert!(other.contains("x.mp4: the file has the format of .png"), "{other}");
        named("a.PNG", Existing::Replaced).unwrap().write(b"newer").unwrap();
        assert_eq!(std::fs::read(path("a.PNG")).unwrap(), b"newer");
        assert_eq!(folder.path().read_dir().unwrap().count(), 1);
    }

    #[test]
    fn a_file_that_appears_meanwhile_is_kept_and_nothing_is_written_through_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link] = ["a.png", "b.png"].map(|name| folder.path().join(name));
        let target = Target::named("--out", &file, "png", Existing::Kept).unwrap();
        std::fs::write(&file, "mine").unwrap();
        target.write(b"new").unwrap_err();
        symlink(&file, &link).unwrap();
        Target::named("--out", &link, "png", Existing::Kept).unwrap_err();
        Target::fixed(&link).unwrap_err();
        Target::named("--out", &link, "png", Existing::Replaced).unwrap().write(b"new").unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"mine");
        assert_eq!(std::fs::read(&link).unwrap(), b"new");
    }

    #[test]
    fn a_link_to_a_device_and_the_path_of_a_folder_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("stdout");
        symlink("/dev/null", &link).unwrap();
        let named = |path: &Path| Target::named("--out", path, "png", Existing::Replaced);
        let refused = named(&link).unwrap_err().to_string();
        assert!(
            refused.ends_with("stdout: is a link to a pipe or device; name a file"),
            "{refused}"
        );
        assert!(link.is_symlink());
        let refused = named(&folder.path().join("new/")).unwrap_err().to_string();
        assert!(refused.ends_with("new/: is a folder; name a file"), "{refused}");
    }

    #[test]
    fn a_folder_with_the_name_of_a_file_is_used_only_if_it_exists() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curves.svg");
        let refused = option_folder("--out", &path).unwrap_err().to_string();
        assert!(
            refused.ends_with("name a folder, for the command writes several files"),
            "{refused}"
        );
        std::fs::create_dir(&path).unwrap();
        option_folder("--out", &path).unwrap();
        option_folder("--out", &folder.path().join("figures.new")).unwrap();
    }
}
