//! Whether a run folder is still the folder that this process locked: it may have been renamed, deleted or replaced.

use super::{LOCK, MANIFEST, RunFolder, RunFolderError};
use crate::durable;

impl RunFolder {
    /// Refuses to write if the path no longer leads to the locked folder, or if the folder was emptied.
    ///
    /// # Errors
    /// Names the folder.
    pub(crate) fn demand_in_place(&self) -> Result<(), RunFolderError> {
        let (lock, folder) = &self.locks;
        let same = folder.as_ref().is_none_or(|open| durable::leads_to(&self.path, open));
        // A deleted lock file alone is harmless: the folder's own lock holds.
        let emptied =
            || !durable::leads_to(&self.file(LOCK), lock) && !durable::exists(&self.file(MANIFEST));
        if same && !emptied() {
            return Ok(());
        }
        Err(RunFolderError::Lost { path: self.path.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::path::Path;

    fn run(path: &Path) -> RunFolder {
        let run = RunFolder::claim_new(path).unwrap();
        run.begin("", &json!({"config_sha256": "aa"})).unwrap();
        run.demand_in_place().unwrap();
        run
    }

    #[test]
    fn a_renamed_a_replaced_and_a_deleted_folder_are_lost() {
        let folder = tempfile::tempdir().unwrap();
        let (path, moved) = (folder.path().join("run"), folder.path().join("moved"));
        let first = run(&path);
        std::fs::rename(&path, &moved).unwrap();
        let message = first.demand_in_place().unwrap_err().to_string();
        assert!(message.starts_with(&format!("{} was renamed", path.display())), "{message}");
        let second = run(&path);
        first.demand_in_place().unwrap_err();
        std::fs::remove_dir_all(&path).unwrap();
        second.demand_in_place().unwrap_err();
        std::fs::rename(&moved, &path).unwrap();
        first.demand_in_place().unwrap();
    }

    #[test]
    fn an_emptied_folder_is_lost_and_one_without_its_lock_file_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let run = run(folder.path());
        std::fs::remove_file(folder.path().join(LOCK)).unwrap();
        run.demand_in_place().unwrap();
        std::fs::remove_file(folder.path().join(MANIFEST)).unwrap();
        run.demand_in_place().unwrap_err();
    }
}
