//! Reports an invalid command line in one line.

use std::process::ExitCode;

use clap::CommandFactory as _;
use clap::error::{ContextKind, ContextValue, ErrorKind};

use crate::commands::Arguments;
use crate::config::{keys, known};
use crate::process::{output, shell};
use crate::run::VALUE_NAME;

/// Prints help and version as clap does, and any other report as one line.
pub(crate) fn report(error: &clap::Error) -> ExitCode {
    let asked = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
    if asked {
        return match output::written(error.print()) {
            Ok(()) => ExitCode::SUCCESS,
            Err(why) => {
                output::error(format!("error: {why:#}"));
                ExitCode::FAILURE
            }
        };
    }
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        // It goes to stderr; a failure cannot be reported.
        let _unread = error.print();
    } else if error.kind() == ErrorKind::InvalidUtf8 {
        // Clap's report does not name the argument.
        let arguments = std::env::args_os().skip(1);
        let no_text = arguments.filter(|argument| argument.to_str().is_none());
        output::error(format!("error: {}", shell::not_text(&no_text.collect::<Vec<_>>())));
    } else {
        output::error(one_line(error));
    }
    ExitCode::from(2)
}

/// The message of clap's report, without its tips and its usage text, and what was probably meant.
fn one_line(error: &clap::Error) -> String {
    let report = error.render().to_string();
    let message = report.split("\n\n").filter(|text| text.trim_start().starts_with("error:"));
    let message = message.map(|text| text.split_whitespace().collect::<Vec<_>>().join(" "));
    let meant = command_meant(error, &report).or_else(|| meant(error));
    let meant = meant.or_else(|| setting_meant(error, &report));
    message.chain(meant).collect::<Vec<_>>().join("; ") + "; see --help"
}

/// The name that was probably meant, of those that clap suggests. Its measure of similarity accepts words that differ in
/// most of their letters.
fn meant(error: &clap::Error) -> Option<String> {
    let kinds = [
        (ContextKind::InvalidArg, ContextKind::SuggestedArg),
        (ContextKind::InvalidValue, ContextKind::SuggestedValue),
    ];
    kinds.into_iter().find_map(|(given, suggested)| {
        let Some(ContextValue::String(given)) = error.get(given) else { return None };
        let suggested = match error.get(suggested)? {
            ContextValue::String(one) => std::slice::from_ref(one),
            ContextValue::Strings(some) => some,
            _ => return None,
        };
        let plain = |word: &'_ str| word.trim_start_matches('-').to_owned();
        let names: Vec<String> = suggested.iter().map(|name| plain(name)).collect();
        let nearest = keys::nearest(&plain(given), names.iter().map(String::as_str))?;
        let index = names.iter().position(|name| name == nearest)?;
        Some(format!("did you mean `{}`?", suggested[index]))
    })
}

/// The command that was probably meant, of those where the unknown one is. The usage text in `report` says where that is.
fn command_meant(error: &clap::Error, report: &str) -> Option<String> {
    let Some(ContextValue::String(given)) = error.get(ContextKind::InvalidSubcommand) else {
        return None;
    };
    let mut command = Arguments::command();
    let (_, usage) = report.split_once("Usage: ")?;
    for word in usage.split_whitespace().skip(1) {
        let Some(inner) = command.find_subcommand(word) else { break };
        command = inner.clone();
    }
    let names: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
    let nearest = keys::nearest(given, names)?;
    Some(format!("did you mean `{nearest}`?"))
}

/// A tip for an unknown flag that is probably a setting, if the command takes settings.
fn setting_meant(error: &clap::Error, report: &str) -> Option<String> {
    let Some(ContextValue::String(flag)) = error.get(ContextKind::InvalidArg) else { return None };
    let takes_settings = error.kind() == ErrorKind::UnknownArgument && report.contains(VALUE_NAME);
    if !takes_settings {
        return None;
    }
    let meant = known::spelled(flag.trim_start_matches('-'));
    let meant: Vec<String> = meant.iter().map(|key| format!("{key}=VALUE")).collect();
    Some(if meant.is_empty() {
        "a setting is written key.path=value, such as run.seed=7".to_owned()
    } else {
        format!("a setting is written {}", meant.join(" or "))
    })
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;

    fn refusal(arguments: &[&str]) -> String {
        let arguments = [&["s2mia"], arguments].concat();
        one_line(&Arguments::try_parse_from(arguments).unwrap_err())
    }

    #[test]
    fn a_setting_that_is_written_as_a_flag_is_shown_as_a_setting() {
        for (arguments, meant) in [
            (["train", "--seed", "3"], "run.seed=VALUE"),
            (["learner", "--env-steps=3", "x"], "run.env_steps=VALUE"),
            (["config", "--update.clip", "3"], "update.clip=VALUE"),
            (["train", "--frobnicate", "3"], "key.path=value, such as run.seed=7"),
        ] {
            let line = refusal(&arguments);
            let flag = arguments[1].split('=').next().unwrap();
            let expected = format!(
                "error: unexpected argument '{flag}' found; a setting is written {meant}; see --help"
            );
            assert_eq!(line, expected);
        }
    }

    #[test]
    fn a_command_without_settings_speaks_of_none() {
        let line = refusal(&["eval", "runs/x", "--seed", "3"]);
        assert!(line.contains("'--seed'") && !line.contains("setting"), "{line}");
    }

    #[test]
    fn a_misspelt_word_is_one_line_with_the_word_that_was_meant() {
        let line = refusal(&["train", "--resum", "x"]);
        let found = "error: unexpected argument '--resum' found";
        assert_eq!(line, format!("{found}; did you mean `--resume`?; see --help"));
        for (line, meant) in [
            (&["recor", "runs/x"][..], "record"),
            (&["trian"], "train"),
            (&["lgo"], "log"),
            (&["task", "chekc"], "check"),
            (&["task", "nwe", "x"], "new"),
            (&["--log-format", "jsn", "tasks"], "json"),
        ] {
            assert!(refusal(line).contains(&format!("did you mean `{meant}`?")), "{line:?}");
        }
    }

    #[test]
    fn nothing_is_suggested_that_is_spelt_differently() {
        for arguments in [
            &["dance"][..],
            &["eval", "runs/x", "--seed", "3"],
            &["record", "runs/x", "--seeds", "3"],
            &["--log-format", "yaml", "tasks"],
        ] {
            let line = refusal(arguments);
            assert!(!line.contains("did you mean") && !line.contains("tip"), "{line}");
        }
    }

    #[test]
    fn a_missing_and_a_wrong_value_are_one_line_with_their_argument() {
        for (arguments, name) in [
            (&["plot"][..], "<RUN>"),
            (&["eval", "runs/x", "--episodes", "0"], "--episodes"),
            (&["film", "runs/x", "--frames", "0"], "--frames"),
        ] {
            let line = refusal(arguments);
            assert!(line.contains(name) && !line.contains('\n'), "{line}");
        }
    }
}
