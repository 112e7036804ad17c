//! The arguments of every command.

mod control;
mod export;
mod figures;
mod log;
mod page;
mod refusal;
mod serve;
mod settings;
mod tls;

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

pub(crate) use control::{
    CheckpointArguments, LearnerArgument, LiveArguments, OrderArguments, StatusArguments,
    WatchArguments,
};
pub(crate) use export::ExportArguments;
pub(crate) use figures::{ExperimentArguments, PlotArguments};
pub(crate) use log::{ActorLogArguments, JoinArguments, LogCommand, LogFiles, RecoverArguments};
pub(crate) use page::{PageAddress, PageArguments};
pub(crate) use refusal::report;
pub(crate) use serve::ServeArguments;
pub(crate) use settings::SettingsArguments;
pub(crate) use tls::{ClientTlsArguments, ServerTlsArguments};

/// Trains cooperative robot controllers with HAPPO-S2MIA: rollout actors and a learner over gRPC.
#[derive(Debug, Parser)]
#[command(name = "s2mia", version, propagate_version = true, max_term_width = 100)]
pub(crate) struct Arguments {
    /// Form of the log lines on stderr.
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    pub(crate) log_format: LogFormat,
    /// What is logged, as in RUST_LOG: a level, or target=level pairs [default: info for learner and actor, else warn].
    #[arg(long, global = true, value_name = "FILTER")]
    pub(crate) log: Option<String>,
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Form of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// A role or a tool.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Train on this machine: a learner and actor processes, with progress and a return curve.
    #[command(after_help = TRAIN_EXAMPLES)]
    Train(TrainArguments),
    /// Serve one run to actors on this or other machines.
    Learner(LearnerArguments),
    /// Roll out for a learner until its run is done.
    Actor(ActorArguments),
    /// Ask a learner whether it serves; the exit status is the answer.
    Health(HealthArguments),
    /// Say where a run stands: iteration, slots, leases, actors, steps per second.
    Status(StatusArguments),
    /// Show a run folder live to Foxglove, or print a line for each iteration that a learner finishes.
    Watch(WatchArguments),
    /// Let a learner hand out no more work; what is leased is finished.
    Pause(OrderArguments),
    /// Let a paused learner go on. (`s2mia train --resume` takes up a run that has ended.)
    Resume(OrderArguments),
    /// Let a learner write a checkpoint, and say where it is.
    Checkpoint(CheckpointArguments),
    /// Let a learner end after a checkpoint, as SIGTERM does.
    Stop(OrderArguments),
    /// Act by a run's trained policies for whoever observes, over gRPC.
    Serve(ServeArguments),
    /// Measure a trained policy: whole episodes, mean action, extrinsic return.
    Eval(EvalArguments),
    /// Record episodes of a trained policy as MCAP, ready for Foxglove.
    Record(RecordArguments),
    /// Look at, check, repair, repeat and join trajectory logs.
    #[command(subcommand)]
    Log(LogCommand),
    /// Draw a moving robot as a strip of pictures, and say how far and how honestly it went.
    Film(FilmArguments),
    /// Draw the learning curves of runs as PNG and SVG.
    Plot(PlotArguments),
    /// Run tasks x variants x seeds, several at once, then make a table and figures of them; go on with it at will.
    Experiment(ExperimentArguments),
    /// Write a trained policy as ONNX files, one for each agent, for programs that know nothing of this one.
    Export(ExportArguments),
    /// Say what the newest good checkpoint of a run holds.
    Inspect(InspectArguments),
    /// List the tasks with their agents, joints and sizes.
    Tasks(TasksArguments),
    /// Print the resolved configuration with the origin of each value.
    #[command(after_help = CONFIG_LAYERS)]
    Config(SettingsArguments),
    /// Make certificates for a learner and for each role, signed by a new authority.
    Certs(CertsArguments),
}

const TRAIN_EXAMPLES: &str = "\
Examples:
  s2mia train                                    halfcheetah-2x3, happo-s2mia, 1,000,000 env steps
  s2mia train halfcheetah-6x1 algorithm=happo run.seed=7
  s2mia train --resume runs/NAME run.env_steps=2000000

`s2mia config` prints every key that can be set.";

const CONFIG_LAYERS: &str = "\
Later layers win:
  configs/base.toml             every default
  configs/tasks/TASK.toml       the first argument, or task=TASK
  configs/presets/PRESET.toml   preset=tuned (default), harl or paper: its sections, then task.TASK
  configs/algorithms/NAME.toml  algorithm=NAME
  configs/presets/PRESET.toml   algorithm.NAME.TASK, where a preset says so
  configs/outside.toml          with environment_service.url, where the above say observation.norm=feature_z
  --config FILE                 in the order given
  S2MIA__SECTION__KEY           environment variables
  section.key=value             arguments";

/// How an earlier run is taken up again.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ResumeArguments {
    /// Go on with this run folder from its newest good checkpoint.
    #[arg(long, value_name = "RUN")]
    pub(crate) resume: Option<PathBuf>,
    /// Die without a farewell at POINT@ITERATION, such as after-publish@3: for tests of what comes after.
    #[arg(long, value_name = "POINT@ITERATION", hide = true)]
    pub(crate) die_at: Option<learner::Fault>,
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
    /// Train only ITERATIONS, in a temporary folder, three times: undisturbed, with an actor killed, and stopped
    /// and resumed; the exit status says whether all end in the same state.
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
    /// Stop after a checkpoint as soon as standard input closes, so that no run outlives the process that started it.
    #[arg(long)]
    pub(crate) stop_with_stdin: bool,
    /// Page.
    #[command(flatten)]
    pub(crate) page: PageArguments,
    /// Live view.
    #[command(flatten)]
    pub(crate) live: LiveArguments,
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
    /// Address for actors.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:50051")]
    pub(crate) listen: SocketAddr,
    /// Listen beyond this machine although nothing is encrypted and nobody is asked who they are.
    #[arg(long, conflicts_with = "tls_certificate")]
    pub(crate) insecure_allow_remote: bool,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ServerTlsArguments,
    /// Page.
    #[command(flatten)]
    pub(crate) page: PageArguments,
}

/// `s2mia actor`
#[derive(Args, Debug)]
pub(crate) struct ActorArguments {
    /// Where the learner listens.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:50051")]
    pub(crate) learner: String,
    /// Step the environment that a program offers there, instead of building the run's own.
    #[arg(long, value_name = "URL", conflicts_with = "log_dir")]
    pub(crate) environment: Option<String>,
    /// Name in the learner's log [default: host name and process id].
    #[arg(long)]
    pub(crate) name: Option<String>,
    /// Give up when the learner cannot be reached for this long.
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0)]
    pub(crate) max_outage_secs: f64,
    /// End as soon as standard input closes, so that no actor outlives the process that started it.
    #[arg(long)]
    pub(crate) exit_with_stdin: bool,
    /// Talk to a learner on another machine although nothing is encrypted and it is not asked who it is.
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
    /// Where the learner listens.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:50051")]
    pub(crate) learner: String,
    /// How long to wait for its answer.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    pub(crate) timeout_secs: f64,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ClientTlsArguments,
}

/// `s2mia eval`
#[derive(Args, Debug)]
pub(crate) struct EvalArguments {
    /// Run folder.
    pub(crate) run: PathBuf,
    /// Whole episodes to play.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) episodes: u32,
    /// Draw actions as in training, episode I with the seed SEED + I, instead of taking the means or likeliest choices.
    #[arg(long, value_name = "SEED", num_args = 0..=1, default_missing_value = "0")]
    pub(crate) sampled: Option<u64>,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    pub(crate) json: bool,
}

/// `s2mia record`
#[derive(Args, Debug)]
pub(crate) struct RecordArguments {
    /// Run folder.
    pub(crate) run: PathBuf,
    /// Whole episodes to record.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) episodes: u32,
    /// MCAP file to write [default: RUN/logs/iter_ITERATION.mcap].
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
}

/// `s2mia film`
#[derive(Args, Debug)]
pub(crate) struct FilmArguments {
    /// Run folder.
    pub(crate) run: PathBuf,
    /// Which of the episodes that `s2mia eval` plays.
    #[arg(long, value_name = "INDEX", default_value_t = 0)]
    pub(crate) episode: u32,
    /// Pictures in the strip.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub(crate) frames: u32,
    /// Time of the first picture [default: 5, or the middle of a shorter episode].
    #[arg(long, value_name = "SECONDS")]
    pub(crate) from_secs: Option<f64>,
    /// Time from one picture to the next.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.05)]
    pub(crate) every_secs: f64,
    /// PNG file to write [default: RUN/film.png].
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
}

/// `s2mia inspect`
#[derive(Args, Debug)]
pub(crate) struct InspectArguments {
    /// Run folder.
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
    /// Draw every robot's partition into DIR/TASK.png: links in the colours of the agents, joints with numbers.
    #[arg(long, value_name = "DIR", conflicts_with = "json")]
    pub(crate) picture: Option<PathBuf>,
}

/// `s2mia certs`
#[derive(Args, Debug)]
pub(crate) struct CertsArguments {
    /// New or empty folder for the files.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,
    /// Host names and addresses under which actors reach the learner.
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
        let parsed = Arguments::try_parse_from(line.split_whitespace()).unwrap();
        let Command::Train(train) = parsed.command else { panic!("not train") };
        assert_eq!(train.settings.settings.len(), 6);
        assert_eq!(train.settings.settings[0], "halfcheetah-6x1");
        let parsed = Arguments::try_parse_from(["s2mia", "inspect", "DIR", "--json"]).unwrap();
        assert!(matches!(parsed.command, Command::Inspect(InspectArguments { json: true, .. })));
    }
}
