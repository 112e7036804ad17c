//! A run shown live to Foxglove: the newest policy's evaluation episodes and the learning curves, from nothing but the
//! run's folder, so that the run knows nothing of it. `train --watch` and `watch RUN` start it.

mod curves;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use policy::RunSeed;
use recording::{LiveError, LiveScene, LiveServer};
use rollout::EvaluationEpisode;

use crate::commands::live::curves::Curves;
use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::listening::demand_loopback;
use crate::process::output;
use crate::run::checkpointed::{self, Trained};
use crate::run::offered::Stage;

/// Poll interval for viewers.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// The address of the live view, and its flags.
pub(super) struct Place {
    /// Address that viewers connect to.
    pub(super) address: SocketAddr,
    /// The flag that names the address.
    pub(super) flag: &'static str,
    /// The flag that permits other machines.
    pub(super) permission: &'static str,
    /// Whether it was given.
    pub(super) permitted: bool,
}

impl Place {
    /// Listens there; refuses an address that other machines can reach unless that is allowed, and a port that is taken.
    pub(super) fn open(&self, run: &str) -> anyhow::Result<LiveServer> {
        let Self { address, flag, permission, permitted } = self;
        if !permitted {
            demand_loopback(flag, *address, &format!("pass {permission} to allow that"))?;
        }
        LiveServer::open(*address, run).map_err(|error| match error {
            LiveError::Listen(why) => {
                let advice = "choose another port, or 0 for any free one";
                Usage::new(format!("{flag} {address}: {why}; {advice}")).into()
            }
            other => anyhow::Error::new(other).context("cannot show the run"),
        })
    }
}

/// What is shown.
pub(super) struct Show {
    /// Run folder; it may have no checkpoint yet, or not be there.
    pub(super) folder: PathBuf,
    /// Settings of the run.
    pub(super) config: RunConfig,
}

impl Show {
    /// Shows it on a thread of its own as long as the process lives, and says where.
    pub(super) fn start(self, server: LiveServer) -> anyhow::Result<()> {
        output::line(format!("live view: {}, in Foxglove: {}", server.url(), server.link()));
        if let Some(told) = self.missing() {
            output::line(format!("live view: {told}"));
        }
        let go_on = move || {
            if let Err(error) = self.go_on(&server) {
                tracing::error!("the live view has ended: {error:#}");
            }
        };
        // It ends with the process; nobody waits for it.
        let thread = std::thread::Builder::new().name("live-view".to_owned()).spawn(go_on);
        thread.map(drop).context("cannot start the live view")
    }

    /// What the live view cannot show (yet).
    fn missing(&self) -> Option<&'static str> {
        if !self.config.environment.url.is_empty() {
            return Some("only the learning curves; the environment is another program's");
        }
        let waits = newest_iteration(self).is_none();
        waits.then_some("the robot stands still until the first checkpoint is written")
    }

    fn go_on(self, server: &LiveServer) -> anyhow::Result<()> {
        let mut curves = Curves::of(&self.folder, server)?;
        let mut robot = match self.config.environment.url.as_str() {
            "" => Some(Robot::of(self, server)?),
            _ => None,
        };
        loop {
            curves.follow();
            match &mut robot {
                Some(robot) if robot.is_watched() => robot.play(&mut curves),
                _ => std::thread::sleep(LOOK_AGAIN),
            }
        }
    }
}

/// The run's environment with its newest policy.
struct Robot {
    show: Show,
    stage: Stage,
    scene: LiveScene,
    /// Of the newest checkpoint that could be used.
    trained: Option<Trained>,
    /// Of the newest checkpoint that was looked at.
    seen: Option<u64>,
    /// Episodes by that policy so far.
    episodes: u32,
}

impl Robot {
    /// At the start of an episode.
    fn of(show: Show, server: &LiveServer) -> anyhow::Result<Self> {
        let mut stage = Stage::of(&show.config)?;
        let world = stage.environment.as_mut();
        let mut scene = server.scene(world).context("cannot show the environment")?;
        let seed = RunSeed(show.config.run.seed);
        let first = EvaluationEpisode { seed, iteration: 0, index: 0 };
        world.reset(0, 0, world.description().episode_steps, first.key().0)?;
        scene.stand(world)?;
        scene.describe(&BTreeMap::from([(
            "waits_for".to_owned(),
            "the first checkpoint of the run".to_owned(),
        )]))?;
        let mut robot = Self { show, stage, scene, trained: None, seen: None, episodes: 0 };
        if let Err(error) = robot.take_up_newest() {
            robot.stand_still(&error);
        }
        Ok(robot)
    }

    fn is_watched(&self) -> bool {
        self.scene.is_watched()
    }

    /// Plays the next episode by the newest policy, as long as anybody looks.
    fn play(&mut self, curves: &mut Curves) {
        let played = self.take_up_newest().and_then(|()| self.episode(curves));
        if let Err(error) = played {
            self.stand_still(&error);
        }
        if self.trained.is_none() {
            std::thread::sleep(LOOK_AGAIN);
        }
    }

    fn stand_still(&mut self, error: &anyhow::Error) {
        self.trained = None;
        tracing::warn!("the robot stands still until the next checkpoint: {error:#}");
    }

    /// The policy of a checkpoint that has been written since.
    fn take_up_newest(&mut self) -> anyhow::Result<()> {
        let newest = newest_iteration(&self.show);
        if newest <= self.seen {
            return Ok(());
        }
        self.seen = newest;
        let trained = checkpointed::trained(&self.show.folder)?;
        let task = &self.stage.environment.description().task;
        self.scene.describe(&checkpointed::metadata(&trained, task))?;
        self.trained = Some(trained);
        self.episodes = 0;
        Ok(())
    }

    /// Episodes begin as those of the run's own evaluation of this policy do, one after the other.
    fn episode(&mut self, curves: &mut Curves) -> anyhow::Result<()> {
        let Some(trained) = &self.trained else { return Ok(()) };
        let (world, acting) = (self.stage.environment.as_mut(), (&trained.policy, trained.weights));
        let played =
            self.scene.play(world, acting, trained.episode(self.episodes), || curves.follow());
        played.context("the episode broke off")?;
        self.episodes += 1;
        Ok(())
    }
}

/// Iteration of the newest checkpoint; none if it cannot be determined.
fn newest_iteration(show: &Show) -> Option<u64> {
    learner::checkpoint::newest_iteration(&show.folder).ok().flatten()
}
