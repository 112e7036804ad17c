//! Tokens of runs: from the environment, from a run folder, or new.

use std::path::Path;

use anyhow::Context as _;
use learner::run_folder::RunFolder;
use security::Token;

/// The token in `S2MIA_TOKEN`, if the variable is set.
///
/// # Errors
/// The variable contains no token.
pub(crate) fn of_environment() -> anyhow::Result<Option<Token>> {
    let Some(text) = std::env::var_os(Token::VARIABLE) else { return Ok(None) };
    let token = Token::parse(&text.to_string_lossy());
    Ok(Some(token.with_context(|| format!("cannot use {}", Token::VARIABLE))?))
}

/// The token of the run in `folder`, else that in `S2MIA_TOKEN`, if either exists.
///
/// # Errors
/// A token cannot be read.
pub(crate) fn for_run(folder: &Path) -> anyhow::Result<Option<Token>> {
    match RunFolder::token(folder)? {
        Some(token) => Ok(Some(token)),
        None => of_environment(),
    }
}
