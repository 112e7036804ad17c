//! The token file of a run folder, which only its owner can read.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use security::Token;

use super::{RunFolder, RunFolderError};
use crate::store::durable::{self, FileError};
use crate::store::plain_file;

/// The token that the learner of the latest start requires.
pub(super) const TOKEN: &str = "token";

impl RunFolder {
    /// Path of the token file of the run in `folder`; absolute if the working directory is known.
    #[must_use]
    pub fn token_file(folder: &Path) -> PathBuf {
        let file = folder.join(TOKEN);
        std::path::absolute(&file).unwrap_or(file)
    }

    /// Writes the token that this start of the learner requires, or removes that of an earlier start.
    ///
    /// # Errors
    /// Names the file if it cannot be written or removed.
    pub fn note_token(&self, token: Option<&Token>) -> Result<(), RunFolderError> {
        let path = self.file(TOKEN);
        match token {
            Some(token) => {
                durable::replace_private(&path, format!("{}\n", token.text()).as_bytes())?
            }
            None => durable::remove_file(&path).and_then(|()| durable::sync_name(&path))?,
        }
        Ok(())
    }

    /// The token that the learner of the run in `folder` requires; `None` if it requires none, or if another user owns
    /// it. The learner then refuses the calls that need it, and its refusal names the file.
    ///
    /// # Errors
    /// The file cannot be read for another reason, or it contains no token.
    pub fn token(folder: &Path) -> Result<Option<Token>, RunFolderError> {
        let path = folder.join(TOKEN);
        let text = match plain_file::read_to_string(&path) {
            Err(error)
                if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::PermissionDenied) =>
            {
                return Ok(None);
            }
            text => text.map_err(FileError::of("read", &path))?,
        };
        let token = Token::parse(&text);
        token.map(Some).map_err(|why| RunFolderError::Damaged { path, detail: why.to_string() })
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn the_token_file_is_its_owners_only_and_goes_with_the_next_start_without_one() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::claim_new(folder.path()).unwrap();
        assert!(RunFolder::token(folder.path()).unwrap().is_none());
        for _start in 0..2 {
            let token = Token::random().unwrap();
            // What a crash may leave.
            std::fs::write(folder.path().join(".tmp-token"), "").unwrap();
            run.note_token(Some(&token)).unwrap();
            let file = RunFolder::token_file(folder.path());
            let mode = std::fs::metadata(&file).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
            let read = RunFolder::token(folder.path()).unwrap().unwrap();
            assert_eq!(read.text(), token.text());
        }
        run.note_token(None).unwrap();
        assert!(RunFolder::token(folder.path()).unwrap().is_none());
    }

    #[test]
    fn a_token_file_with_other_contents_is_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(TOKEN), "abc").unwrap();
        let message = RunFolder::token(folder.path()).unwrap_err().to_string();
        assert!(message.contains("token is damaged: a token has 64"), "{message}");
    }
}
