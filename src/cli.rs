//! The command-line arguments of all commands.

mod control;
mod experiment;
mod export;
mod figures;
mod log;
mod page;
mod paths;
mod refusal;
mod serve;
mod settings;
mod task;
mod tls;

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::run::fingerprints::BUILD;

pub(crate) use control::{
    LearnerArgument, StatusArguments, StopArguments, WatchArguments, patience, seconds,
};
pub(crate) use experiment::{Engine, ExperimentArguments};
pub(crate) use export::ExportArguments;
pub(crate) use figures::PlotArguments;
pub(crate) use log::{ActorLogArguments, LogCommand, LogFiles};
pub(crate) use page::{PageAddress, PageArguments, RunsPageArguments};
pub(crate) use paths::ForceArguments;
pub(crate) use refusal::report;
pub(crate) use serve::ServeArguments;
pub(crate) use settings::SettingsArguments;
pub(crate) use task::{TaskCheckArguments, TaskCommand, TaskNewArguments};
pub(crate) use tls::{ClientTlsArguments, ServerTlsArguments, credentials};

/// Trains cooperative robot controllers with HAPPO-S2MIA: a learner and rollout actors communicate over gRPC.
#[derive(Debug, Parser)]
#[command(name = "s2mia", version = BUILD, propagate_version = true, max_term_width = 100)]
pub(crate) struct Arguments {
    /// Log format on stderr.
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    pub(crate) log_format: LogFormat,
    /// Log filter as in RUST_LOG: a level, or target=level pairs [default: info for learner and actor, else warn].
    #[arg(long, global = true, value_name = "FILTER")]
    pub(crate) log: Option<String>,
    /// Command.
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Log format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LogFormat {
    /// Human-readable lines.
    Text,
    /// One JSON object per line.
    Json,
}

/// A command: a role in training, or a tool.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Train on this machine with a learner and actor processes; print progress and draw a return curve.
    #[command(after_help = TRAIN_EXAMPLES)]
    Train(TrainArguments),
    /// Serve one run to actors on this or other machines.
    Learner(LearnerArguments),
    /// Compute rollouts for a learner until its run is finished.
    Actor(ActorArguments),
    /// Check whether a learner is serving; the exit status is the result.
    Health(HealthArguments),
    /// Print a run's iteration, slots, leases, actors and steps per second.
    Status(StatusArguments),
    /// Print one line per finished iteration of a run; continues when its learner restarts.
    Watch(WatchArguments),
    /// Make a learner write a checkpoint and exit, as SIGTERM does.
    Stop(StopArguments),
    /// Serve a run's trained policies over gRPC: clients send observations and receive actions.
    Serve(ServeArguments),
    /// Evaluate a trained policy: extrinsic return of whole episodes, with the mean action by default.
    Eval(EvalArguments),
    /// Record episodes of a trained policy as MCAP for Foxglove.
    Record(RecordArguments),
    /// Verify and replay trajectory logs.
    #[command(subcommand)]
    Log(LogCommand),
    /// Draw a robot's motion as a strip of pictures; print its distance and signs of unphysical motion.
    Film(FilmArguments),
    /// Draw the learning curves of runs as PNG and SVG.
    Plot(PlotArguments),
    /// Serve a web page with the curves of several runs in the same charts; follows runs that still grow.
    Page(RunsPageArguments),
    /// Train tasks x variants x seeds in parallel, then make a table and figures; repeat the command to resume.
    Experiment(ExperimentArguments),
    /// Write a trained policy as ONNX files, one per agent, for use in other programs.
    Export(ExportArguments),
    /// Print the contents of a run's newest valid checkpoint.
    Inspect(InspectArguments),
    /// List the tasks with their agents, joints and sizes.
    Tasks(TasksArguments),
    /// Check a task file, or write an example of one.
    #[command(subcommand)]
    Task(TaskCommand),
    /// Print the resolved configuration with the origin of each value.
    #[command(after_help = CONFIG_LAYERS)]
    Config(SettingsArguments),
    /// Create certificates for a learner and for each role, signed by a new certificate authority.
    Certs(CertsArguments),
}

const TRAIN_EXAMPLES: &str = "\
Examples:
  s2mia train                                    halfcheetah-2x3, happo-s2mia, 1,000,000 env steps
  s2mia train halfcheetah-6x1 algorithm=happo run.seed=7
  s2mia train my-robot.toml                      a robot of your own (docs/ADDING_A_TASK.md)
  s2mia train --resume runs/NAME run.env_steps=2000000

`s2mia config` prints all settings.";

const CONFIG_LAYERS: &str = "\
Later layers override earlier ones:
  configs/base.toml             every default
  configs/tasks/TASK.toml       the first argument, or task=TASK; with environment_service.url only if given
  configs/own-task.toml         with a task file as TASK, then the file's [settings]
  configs/presets/PRESET.toml   preset=tuned (default), harl or paper: its sections, then task.TASK
  configs/algorithms/NAME.toml  algorithm=NAME
  configs/presets/PRESET.toml   algorithm.NAME.TASK, if the preset has this table
  --config FILE                 in the order given
  S2MIA__SECTION__KEY           environment variables
  section.key=value             arguments";

/// Resume of an earlier run.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ResumeArguments {
    /// Resume the run in this folder from its newest valid checkpoint.
    #[arg(long, value_name = "RUN")]
    pub(crate) resume: Option<PathBuf>,
    /// Exit without cleanup at POINT@ITERATION, such as after-publish@3. Tests of crash recovery use it.
    #[arg(long, value_name = "POINT@ITERATION", hide = true)]
    pub(crate) die_at: Option<learner::Fault>,
    /// Start a new run in run.dir although the folder contains other files.
    #[arg(long, conflicts_with = "resume")]
    pub(crate) force: bool,
}

/// `s2mia train`
#[derive(Args, Debug)]
pub(crate) struct TrainArguments {
    /// Settings.
    #[command(flatten)]
    pub(crate) settings: SettingsArguments,
    /// Resume.
    #[command(flatten)]
    pub(crate) resume: ResumeArguments,
    /// Train ITERATIONS three times in a temporary folder: undisturbed, with an actor killed, and stopped and
    /// resumed. The exit status is 0 only if all three end in the same state.
    #[arg(
        long,
        value_name = "ITERATIONS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "3",
        conflicts_with = "resume",
        value_parser = clap::value_parser!(u64).range(2..)
    )]
    pub(crate) verify_determinism: Option<u64>,
    /// Write a checkpoint and stop when standard input closes, so that the run does not outlive its parent process.
    #[arg(long)]
    pub(crate) stop_with_stdin: bool,
    /// Web page.
    #[command(flatten)]
    pub(crate) page: PageArguments,
}

/// `s2mia learner`
#[derive(Args, Debug)]
pub(crate) struct LearnerArguments {
    /// Settings.
    #[command(flatten)]
    pub(crate) settings: SettingsArguments,
    /// Resume.
    #[command(flatten)]
    pub(crate) resume: ResumeArguments,
    /// Address on which the learner listens for actors.
    #[arg(
        long,
        value_name = "ADDRESS",
        default_value = "127.0.0.1:50051",
        value_parser = crate::listening::address
    )]
    pub(crate) listen: SocketAddr,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ServerTlsArguments,
    /// Web page.
    #[command(flatten)]
    pub(crate) page: PageArguments,
    /// Serve the page and /metrics over TLS with the files of --tls-certificate, to certificates with the role viewer or
    /// admin.
    #[arg(long, requires = "tls_certificate", conflicts_with = "insecure_allow_remote_page")]
    pub(crate) page_tls: bool,
}

/// `s2mia actor`
#[derive(Args, Debug)]
pub(crate) struct ActorArguments {
    /// URL of the learner.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:50051")]
    pub(crate) learner: String,
    /// Use the environment that an external program offers at this URL, instead of the run's own.
    #[arg(long, value_name = "URL", conflicts_with = "log_dir")]
    pub(crate) environment: Option<String>,
    /// Name in the learner's log [default: host name and process id].
    #[arg(long)]
    pub(crate) name: Option<String>,
    /// Number of threads; each steps its own slots, as a separate actor would, but they share connections and weights.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = clap::value_parser!(u16).range(1..=1024)
    )]
    pub(crate) threads: u16,
    /// Exit when the learner cannot be reached for this long.
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0)]
    pub(crate) max_outage_secs: f64,
    /// Exit when standard input closes, so that the actor does not outlive its parent process.
    #[arg(long)]
    pub(crate) exit_with_stdin: bool,
    /// Allow a learner on another machine without encryption and authentication.
    #[arg(long, conflicts_with = "tls_ca")]
    pub(crate) insecure_allow_remote: bool,
    /// Log.
    #[command(flatten)]
    pub(crate) log: ActorLogArguments,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ClientTlsArguments,
}

/// `s2mia health`
#[derive(Args, Debug)]
pub(crate) struct HealthArguments {
    /// URL of the learner.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:50051")]
    pub(crate) learner: String,
    /// Timeout for the learner's response.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    pub(crate) timeout_secs: f64,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ClientTlsArguments,
}

/// `s2mia eval`
#[derive(Args, Debug)]
pub(crate) struct EvalArguments {
    /// Run folder, or one of its checkpoints.
    pub(crate) run: PathBuf,
    /// Number of whole episodes.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) episodes: u32,
    /// Sample actions as in training (seed of episode I: SEED + I) instead of using the mean or most probable action.
    #[arg(long, value_name = "SEED", num_args = 0..=1, default_missing_value = "0")]
    pub(crate) sampled: Option<u64>,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    pub(crate) json: bool,
}

/// `s2mia record`
#[derive(Args, Debug)]
pub(crate) struct RecordArguments {
    /// Run folder, or one of its checkpoints.
    pub(crate) run: PathBuf,
    /// Number of whole episodes to record, from episode 0 on.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) episodes: u32,
    /// Record only the episode with this index, counted as in `s2mia eval`.
    #[arg(long, value_name = "INDEX", conflicts_with = "episodes")]
    pub(crate) episode: Option<u32>,
    /// MCAP file to write [default: RUN/logs/iter_ITERATION.mcap].
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// `s2mia film`
#[derive(Args, Debug)]
pub(crate) struct FilmArguments {
    /// Run folder, or one of its checkpoints.
    pub(crate) run: PathBuf,
    /// Index of the episode, counted as in `s2mia eval`.
    #[arg(long, value_name = "INDEX", default_value_t = 0)]
    pub(crate) episode: u32,
    /// Number of pictures in the strip.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub(crate) frames: u32,
    /// Time of the first picture [default: 5, or the middle of a shorter episode].
    #[arg(long, value_name = "SECONDS")]
    pub(crate) from_secs: Option<f64>,
    /// Time between two pictures.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.05)]
    pub(crate) every_secs: f64,
    /// PNG file to write [default: RUN/film.png].
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// `s2mia inspect`
#[derive(Args, Debug)]
pub(crate) struct InspectArguments {
    /// Run folder, or one of its checkpoints.
    pub(crate) run: PathBuf,
    /// Print one JSON object.
    #[arg(long)]
    pub(crate) json: bool,
}

/// `s2mia tasks`
#[derive(Args, Debug)]
pub(crate) struct TasksArguments {
    /// Print one JSON array.
    #[arg(long)]
    pub(crate) json: bool,
    /// Draw every robot's partition into DIR/TASK.png, with links in the agents' colours and numbered joints.
    #[arg(long, value_name = "DIR", conflicts_with = "json")]
    pub(crate) picture: Option<PathBuf>,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// `s2mia certs`
#[derive(Args, Debug)]
pub(crate) struct CertsArguments {
    /// New or empty folder for the certificates and keys.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,
    /// Host names and addresses that actors use to reach the learner.
    #[arg(
        long,
        value_name = "HOST,...",
        value_delimiter = ',',
        default_value = "localhost,127.0.0.1,::1"
    )]
    pub(crate) names: Vec<String>,
    /// Days until the certificates expire.
    #[arg(long, default_value_t = 90, value_parser = clap::value_parser!(u32).range(1..=3650))]
    pub(crate) days: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_is_consistent_in_itself() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn the_contract_of_outside_scripts_parses() {
        let line = "s2mia train halfcheetah-6x1 algorithm=happo-s2mia run.seed=7 run.iterations=5 \
                    run.actors=2 run.dir=DIR";
        let parsed = Arguments::of(line.split_whitespace()).unwrap();
        let Command::Train(train) = parsed.command else { panic!("not train") };
        assert_eq!(train.settings.settings.len(), 6);
        assert_eq!(train.settings.settings[0], "halfcheetah-6x1");
        let parsed = Arguments::of(["s2mia", "inspect", "DIR", "--json"]).unwrap();
        assert!(matches!(parsed.command, Command::Inspect(InspectArguments { json: true, .. })));
    }
}
