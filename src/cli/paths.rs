//! The arguments of the process: paths in them, and whether existing files may be replaced.

use std::any::TypeId;
use std::ffi::OsString;
use std::path::PathBuf;

use clap::builder::{PathBufValueParser, TypedValueParser as _};
use clap::{Args, Command, CommandFactory as _, FromArgMatches as _};

use super::Arguments;
use crate::process::home;
use crate::process::target::Existing;

impl Arguments {
    /// The arguments of this process.
    pub(crate) fn of_process() -> Result<Self, clap::Error> {
        Self::of(std::env::args_os())
    }

    pub(super) fn of<T: Into<OsString> + Clone>(
        line: impl IntoIterator<Item = T>,
    ) -> Result<Self, clap::Error> {
        let mut command = with_home(Self::command());
        let mut matches = command.try_get_matches_from_mut(line)?;
        Self::from_arg_matches_mut(&mut matches).map_err(|error| error.format(&mut command))
    }
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

/// The command, in which a leading `~` of every path stands for the home folder.
fn with_home(command: Command) -> Command {
    let path = TypeId::of::<PathBuf>();
    let expanding = |arg: clap::Arg| match arg.get_value_parser().type_id() == path {
        true => {
            let parser = PathBufValueParser::new().try_map(|path| home::expanded(&path));
            arg.value_parser(parser)
        }
        false => arg,
    };
    command.mut_args(expanding).mut_subcommands(with_home)
}
