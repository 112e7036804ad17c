//! One whole episode with mean actions or the likeliest choices, or with drawn ones: what evaluation, `eval` and recordings
//! play.

use std::ops::ControlFlow;

use policy::{Key, PolicySnapshot};
use proto::ActionChoice;
use sim::{EnvironmentBatch, Outcome, SimError};

use crate::acting::Agents;

/// What an episode came to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Episode {
    /// Sum of extrinsic rewards.
    pub extrinsic_return: f64,
    /// Steps until it ended.
    pub steps: u32,
}

/// A step of an episode that is being played.
pub struct PlayedStep<'a> {
    /// The world after the step.
    pub world: &'a dyn EnvironmentBatch,
    /// Every agent's action, agents side by side, `[A]`.
    pub action: &'a [f32],
    /// What each agent saw before it, `[obs]`.
    pub observation: &'a [Vec<f32>],
    /// What each agent remembers from it, `[H]`.
    pub hidden: &'a [Vec<f32>],
    /// Each agent's own action, `[act]`.
    pub actions: &'a [Vec<f32>],
    /// What came of it.
    pub outcome: Outcome,
    /// Steps done, this one included.
    pub step: u32,
}

/// Plays environment 0 from a start drawn with `key` to the end of its episode, every agent acting as `choice` says, and
/// shows each step to `on_step`. `world` has one environment.
///
/// # Errors
/// If a policy's action is not finite, or whoever steps the environment fails.
pub fn play_episode(
    world: &mut dyn EnvironmentBatch,
    policy: &PolicySnapshot,
    (key, choice): (Key, ActionChoice),
    mut on_step: impl FnMut(&PlayedStep<'_>),
) -> Result<Episode, SimError> {
    world.reset(0, 0, world.description().episode_steps, key.0)?;
    play_on(world, (policy, choice), &mut on_step)
}

/// As [`play_episode`], from where environment 0 stands.
pub(crate) fn play_on(
    world: &mut dyn EnvironmentBatch,
    acting: (&PolicySnapshot, ActionChoice),
    on_step: &mut impl FnMut(&PlayedStep<'_>),
) -> Result<Episode, SimError> {
    play_while(world, acting, &mut |step| {
        on_step(step);
        ControlFlow::Continue(())
    })
}

/// As [`play_on`], but `on_step` may break the episode off.
pub(crate) fn play_while(
    world: &mut dyn EnvironmentBatch,
    (policy, choice): (&PolicySnapshot, ActionChoice),
    on_step: &mut impl FnMut(&PlayedStep<'_>) -> ControlFlow<()>,
) -> Result<Episode, SimError> {
    let mut agents = Agents::new(world, policy);
    let mut outcomes = vec![Outcome::default(); world.count()];
    let mut episode = Episode::default();
    loop {
        agents.observe(world);
        agents.think(policy);
        agents.choose(policy, choice, episode.steps);
        world.step(agents.join(), &mut outcomes)?;
        let outcome = outcomes[0];
        episode.extrinsic_return += f64::from(outcome.reward);
        episode.steps += 1;
        let wanted = on_step(&PlayedStep {
            world,
            action: &agents.joint,
            observation: &agents.observation,
            hidden: &agents.hidden,
            actions: &agents.action,
            outcome,
            step: episode.steps,
        });
        if outcome.terminated || outcome.truncated || wanted.is_break() {
            return Ok(episode);
        }
    }
}
