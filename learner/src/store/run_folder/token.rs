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
    pub(crate) fn token_file(folder: &Path) -> PathBuf {
        let file = folder.join(TOKEN);
        std::path::absolute(&file).unwrap_or(file)
    }

    /// Writes the token that this start of the learner requires, or removes that of an earlier start.
    ///
    /// # Errors
    /// Names the file if it cannot be written or removed.
    pub(crate) fn note_token(&self, token: Option<&Token>) -> Result<(), RunFolderError> {
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
