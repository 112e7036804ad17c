//! The command line: the commands, each with its arguments above the function that runs it.

mod actor;
mod certs;
mod control;
mod eval;
mod experiment;
mod export;
mod film;
mod inspect;
mod learner;
mod log;
mod pack;
mod page;
mod plot;
mod record;
mod refusal;
mod serve;
mod task;
mod train;
mod verify;
mod watch;

use std::any::TypeId;
use std::ffi::OsString;
use std::path::PathBuf;

use clap::builder::{PathBufValueParser, TypedValueParser as _};
use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use tracing_subscriber::filter::LevelFilter;

use crate::process::output::{self, CommandKind, LogFormat};
use crate::process::shell;
use crate::run::{BUILD, SettingsArguments};

pub(crate) use refusal::report;

/// Heading of the options that every command has, below its own ones.
const EVERY_COMMAND: &str = "Options of every command";

/// Trains cooperative robot controllers with HAPPO-S2MIA: a learner and rollout actors communicate over gRPC.
#[derive(Debug, Parser)]
#[command(name = "s2mia", version = BUILD, propagate_version = true, max_term_width = 100)]
pub(crate) struct Arguments {
    /// Log format on stderr.
    #[arg(long, global = true, help_heading = EVERY_COMMAND, value_enum, default_value_t = LogFormat::Text)]
    pub(crate) log_format: LogFormat,
    /// Log filter as in RUST_LOG: a level, or target=level pairs [default: info for learner and actor, else warn].
    #[arg(long, global = true, help_heading = EVERY_COMMAND, value_name = "FILTER")]
    pub(crate) log: Option<String>,
    /// Command.
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// A command: a role in training, or a tool.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Train on this machine with a learner and actor processes; print progress and draw a return curve.
    #[command(after_help = TRAIN_EXAMPLES)]
    Train(train::TrainArguments),
    /// Serve one run to actors on this or other machines.
    Learner(learner::LearnerArguments),
    /// Compute rollouts for a learner until its run is finished.
    Actor(actor::ActorArguments),
    /// Check whether a learner is serving; the exit status is the result.
    Health(control::HealthArguments),
    /// Print a run's iteration, slots, leases, actors and steps per second.
    Status(control::StatusArguments),
    /// Print one line per finished iteration of a run; continues when its learner restarts.
    Watch(watch::WatchArguments),
    /// Make a learner write a checkpoint and exit, as SIGTERM does, and its actors exit.
    Stop(control::LearnerArgument),
    /// Serve a run's trained policies over gRPC: clients send observations and receive actions.
    Serve(serve::ServeArguments),
    /// Evaluate a trained policy: extrinsic return of whole episodes, with the mean action by default.
    Eval(eval::EvalArguments),
    /// Record episodes of a trained policy as MCAP for Foxglove.
    Record(record::RecordArguments),
    /// Verify trajectory logs: checksums, schemas and that every share is complete. Exit status 3: shares are missing.
    Log(log::LogArguments),
    /// Show a robot's motion as GIF, video or strip of pictures; print its distance and signs of unphysical motion.
    Film(film::FilmArguments),
    /// Draw the learning curves of runs as PNG and SVG.
    Plot(plot::PlotArguments),
    /// Serve the web page of one run or several from their folders: curves, episodes, settings; follows runs that still grow.
    Page(page::RunsPageArguments),
    /// Train tasks x variants x seeds in parallel, then make a table and figures; repeat the command to resume.
    Experiment(experiment::ExperimentArguments),
    /// Write a trained policy as ONNX files, one per agent, for use in other programs.
    Export(export::ExportArguments),
    /// Print the contents of a run's newest valid checkpoint.
    Inspect(inspect::InspectArguments),
    /// Compute random parts of a run again, from its seed and its checkpoints, and compare them with what it recorded.
    /// Exit status 0: all are equal.
    Verify(verify::VerifyArguments),
    /// Copy what others need to verify and use a run into a new folder, without paths and addresses of this machine.
    Pack(pack::PackArguments),
    /// List the tasks with their agents, joints and sizes.
    Tasks(task::TasksArguments),
    /// Check a task file, or write an example of one.
    #[command(subcommand)]
    Task(task::TaskCommand),
    /// Print the resolved configuration with the origin of each value, or what a named KEY means.
    #[command(after_help = CONFIG_LAYERS)]
    Config(SettingsArguments),
    /// Print a script that lets a shell complete commands and options.
    #[command(after_help = COMPLETIONS)]
    Completions(CompletionsArguments),
    /// Create certificates for a learner and for each role, signed by a new certificate authority.
    Certs(certs::CertsArguments),
}

const TRAIN_EXAMPLES: &str = "\
Examples:
  s2mia train                                    halfcheetah-2x3, happo-s2mia, 1,000,000 env steps
  s2mia train halfcheetah-6x1 algorithm=happo run.seed=7
  s2mia train my-robot.toml                      a robot of your own (docs/ADDING_A_TASK.md)
  s2mia train ant-pushed-4x2 policy.start=ant-4x2    begins with a trained team, or with the policies of a run
  s2mia train --resume runs/NAME run.env_steps=2000000

`s2mia config` prints all settings.";

const CONFIG_LAYERS: &str = "\
Later layers override earlier ones:
  configs/base.toml             every default
  configs/tasks/TASK.toml       the first argument, or task=TASK; with environment_service.url only if given;
                                with a task file as TASK, the file's [settings]
  configs/presets/PRESET.toml   preset=tuned (default), local, harl or paper: its sections, then
                                task.TASK
  configs/algorithms/NAME.toml  algorithm=NAME
  configs/presets/PRESET.toml   algorithm.NAME.TASK, if the preset has this table
  --config FILE                 in the order given
  S2MIA__SECTION__KEY           environment variables
  section.key=value             arguments

  s2mia config ant-4x2 surprise.alpha            what a key means, its value here and who set it";

const COMPLETIONS: &str = "\
Examples:
  s2mia completions bash > ~/.local/share/bash-completion/completions/s2mia
  s2mia completions zsh > ~/.zfunc/_s2mia            with `fpath+=~/.zfunc` before `compinit`
  s2mia completions fish > ~/.config/fish/completions/s2mia.fish";

/// `s2mia completions`
#[derive(Args, Debug)]
pub(crate) struct CompletionsArguments {
    /// Shell.
    shell: clap_complete::Shell,
}

/// Prints the script.
fn completions(arguments: &CompletionsArguments) {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut Arguments::command(), "s2mia", &mut script);
    output::line(String::from_utf8_lossy(&script).trim_end());
}

impl Arguments {
    /// The arguments in a command line, which begins with the name of the program.
    pub(crate) fn of<T: Into<OsString> + Clone>(
        line: impl IntoIterator<Item = T>,
    ) -> Result<Self, clap::Error> {
        let mut command = completed(Self::command());
        let mut matches = command.try_get_matches_from_mut(line)?;
        Self::from_arg_matches_mut(&mut matches).map_err(|error| error.format(&mut command))
    }
}

impl Command {
    /// The log filter of a process whose user gives none.
    pub(crate) fn log_filter(&self) -> LevelFilter {
        match self {
            Self::Learner(_) | Self::Actor(_) => LevelFilter::INFO,
            _ => LevelFilter::WARN,
        }
    }

    /// Whether the command only prints or does more.
    pub(crate) fn kind(&self) -> CommandKind {
        match self {
            Self::Status(_)
            | Self::Watch(_)
            | Self::Eval(_)
            | Self::Inspect(_)
            | Self::Tasks(_)
            | Self::Config(_)
            | Self::Completions(_) => CommandKind::Lines,
            _ => CommandKind::Work,
        }
    }
}

/// The command, in which a leading `~` of every path stands for the home folder, and a negative number is the value of an option,
/// whose range refuses it.
fn completed(command: clap::Command) -> clap::Command {
    let path = TypeId::of::<PathBuf>();
    let completing = |arg: clap::Arg| {
        let takes_value = arg.get_long().is_some() && arg.get_action().takes_values();
        let arg = arg.allow_negative_numbers(takes_value);
        if arg.get_value_parser().type_id() != path {
            return arg;
        }
        arg.value_parser(PathBufValueParser::new().try_map(|path| shell::expanded(&path)))
    };
    command.mut_args(completing).mut_subcommands(completed)
}

/// Runs one command to its end.
pub(crate) fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Train(arguments) => train::run(&arguments),
        Command::Learner(arguments) => learner::run(&arguments),
        Command::Actor(arguments) => actor::run(arguments),
        Command::Serve(arguments) => serve::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Record(arguments) => record::run(&arguments),
        Command::Log(arguments) => log::run(&arguments),
        Command::Film(arguments) => film::run(&arguments),
        Command::Plot(arguments) => plot::run(&arguments),
        Command::Page(arguments) => page::run(&arguments),
        Command::Experiment(arguments) => experiment::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::Health(arguments) => control::health(&arguments),
        Command::Status(arguments) => control::status(&arguments),
        Command::Watch(arguments) => watch::run(&arguments),
        Command::Stop(learner) => control::stop(&learner),
        Command::Inspect(arguments) => inspect::inspect(&arguments),
        Command::Verify(arguments) => verify::run(&arguments),
        Command::Pack(arguments) => pack::run(&arguments),
        Command::Tasks(arguments) => task::list(&arguments),
        Command::Task(command) => task::run(&command),
        Command::Config(arguments) => inspect::config(&arguments),
        Command::Completions(arguments) => {
            completions(&arguments);
            Ok(())
        }
        Command::Certs(arguments) => certs::run(&arguments),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_command_line_is_consistent_in_itself() {
        Arguments::command().debug_assert();
    }
}
