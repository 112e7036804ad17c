//! Reports an invalid command line in one line.

use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue, ErrorKind};

use super::settings::VALUE_NAME;
use crate::config::{keys, layers};

/// Prints help and version as clap does, and any other report as one line.
pub(crate) fn report(error: &clap::Error) -> ExitCode {
    let asked = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
    if asked || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        let printed = error.print();
        return if asked && printed.is_ok() { ExitCode::SUCCESS } else { ExitCode::from(2) };
    }
    eprintln!("{}", one_line(error));
    ExitCode::from(2)
}

/// The message and the tip of clap's report, without its usage text.
fn one_line(error: &clap::Error) -> String {
    let report = error.render().to_string();
    let setting = setting_meant(error, &report);
    let tips = if setting.is_some() { "error:" } else { "tip:" };
    let paragraphs = report.split("\n\n").filter(|text| {
        let text = text.trim_start();
        text.starts_with("error:") || text.starts_with(tips)
    });
    let words = paragraphs.map(|text| text.split_whitespace().collect::<Vec<_>>().join(" "));
    words.chain(setting).collect::<Vec<_>>().join("; ") + "; see --help"
}

/// A tip for an unknown flag that is probably a setting, if the command takes settings and has no similar flag.
/// Clap's tip would be to pass the flag as a task.
fn setting_meant(error: &clap::Error, report: &str) -> Option<String> {
    let Some(ContextValue::String(flag)) = error.get(ContextKind::InvalidArg) else { return None };
    let takes_settings = error.kind() == ErrorKind::UnknownArgument && report.contains(VALUE_NAME);
    if !takes_settings || error.get(ContextKind::SuggestedArg).is_some() {
        return None;
    }
    let defaults = layers::defaults();
    let known = defaults.entries.keys().map(String::as_str);
    let meant = keys::spelled(flag.trim_start_matches('-'), known);
    let meant: Vec<String> = meant.iter().map(|key| format!("{key}=VALUE")).collect();
    Some(match meant.is_empty() {
        true => "a setting is written key.path=value, such as run.seed=7".to_owned(),
        false => format!("a setting is written {}", meant.join(" or ")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Arguments;
    use clap::Parser as _;

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
    fn a_wrong_flag_is_one_line_with_the_flag_that_was_meant() {
        let line = refusal(&["train", "--resum", "x"]);
        assert!(line.starts_with("error: unexpected argument '--resum' found"), "{line}");
        assert!(line.contains("--resume"), "{line}");
        assert!(!line.contains('\n'), "{line}");
    }

    #[test]
    fn a_missing_run_folder_is_one_line() {
        let line = refusal(&["plot"]);
        assert!(line.contains("<RUN>"), "{line}");
        assert!(!line.contains('\n'), "{line}");
    }

    #[test]
    fn episodes_start_at_one() {
        assert!(refusal(&["eval", "runs/x", "--episodes", "0"]).contains("--episodes"));
    }

    #[test]
    fn a_strip_without_frames_is_refused() {
        let line = refusal(&["film", "runs/x", "--frames", "0"]);
        assert!(line.contains("--frames") && !line.contains('\n'), "{line}");
    }
}
