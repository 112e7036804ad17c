//! The only validation of pushed results, in a fixed order: counters; observations that were left out, which are restored;
//! digest; types, shapes, lengths and values of every tensor. Values are finite, choices exist, flags are consistent, and
//! final steps and end states are exactly where required. Later code does not repeat these checks.

use crate::read::{bad_value, equal, from_1_to, length, required};
use crate::sizes::Sizes;
use crate::tensor::{MAX_MAGNITUDE, read_flags, read_floats, unusable};
use crate::work::state_size;
use crate::{
    AgentChunk, Digest, EvaluationResult, FinalStep, Reason, Refusal, RolloutOrigin,
    RunDescription, SlotEnd, TrajectoryChunk, digest, left_out, wire,
};

impl TrajectoryChunk {
    /// Reads a pushed chunk of the slot `origin` of `run` that came with the digest `claimed`. The run's description
    /// has been validated.
    ///
    /// # Errors
    /// Names the first invalid field, in the order above.
    pub fn from_wire(
        wire: &wire::TrajectoryChunk,
        run: &RunDescription,
        origin: &RolloutOrigin,
        claimed: Digest,
    ) -> Result<Self, Refusal> {
        let sizes = Sizes::of(run, origin);
        let last = check_counters(wire, run)?;
        let whole = left_out::restored(wire, &sizes)?;
        same_digest(digest::of_chunk(&whole, origin), claimed)?;
        let chunk = read_chunk(&whole, &sizes, last)?;
        check_choices(&chunk, run)?;
        check_flags(&chunk, sizes.environments)?;
        check_finals(&chunk, &sizes, last)?;
        Ok(chunk)
    }
}

impl EvaluationResult {
    /// Reads a pushed result of an episode of the policies after `iteration` of `run` that came with the digest
    /// `claimed`.
    ///
    /// # Errors
    /// If the digest is wrong, the return or a sum of reward terms is not finite or too large, or the number of steps or terms is
    /// impossible.
    pub fn from_wire(
        wire: &wire::EvaluationResult,
        run: &RunDescription,
        iteration: u64,
        claimed: Digest,
    ) -> Result<Self, Refusal> {
        same_digest(digest::of_evaluation(wire, iteration), claimed)?;
        let total = wire.extrinsic_return;
        let most = f64::from(MAX_MAGNITUDE) * f64::from(run.environment.episode_steps);
        if !(-most..=most).contains(&total) {
            let field = "evaluation.extrinsic_return";
            return Err(unusable(field, "is", total, most));
        }
        let most = run.environment.episode_steps;
        from_1_to(most as usize, wire.steps as usize, "steps", "evaluation.steps")?;
        let (sums, field) = (&wire.reward_terms, "evaluation.reward_terms");
        Ok(Self {
            episode: wire.episode,
            extrinsic_return: total,
            steps: wire.steps,
            reward_terms: read_terms(sums, run, [most as usize, 1], field)?,
        })
    }
}

/// Whether the chunk is the slot's last one.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Last {
    Yes,
    No,
}

fn check_counters(wire: &wire::TrajectoryChunk, run: &RunDescription) -> Result<Last, Refusal> {
    let chunks = run.chunks_per_slot();
    if wire.sequence >= chunks {
        let detail = format!("{}, a slot has {chunks} chunks", wire.sequence);
        return Err(bad_value("chunk.sequence", detail));
    }
    let first = u64::from(wire.sequence) * u64::from(run.chunk_steps);
    equal(Reason::Inconsistent, wire.first_step.into(), first, "chunk.first_step")?;
    equal(Reason::BadValue, wire.steps.into(), run.chunk_steps.into(), "chunk.steps")?;
    Ok(if wire.sequence + 1 == chunks { Last::Yes } else { Last::No })
}

fn same_digest(found: Digest, claimed: Digest) -> Result<(), Refusal> {
    if found == claimed {
        return Ok(());
    }
    let detail = format!("the content has {found}, the message says {claimed}");
    Err(Refusal::new(Reason::DigestMismatch, "digest", detail))
}

fn read_chunk(
    wire: &wire::TrajectoryChunk,
    sizes: &Sizes<'_>,
    last: Last,
) -> Result<TrajectoryChunk, Refusal> {
    let rows = [sizes.steps, sizes.environments];
    length(wire.agents.len(), sizes.agents, "chunk.agents")?;
    let agents = wire.agents.iter().enumerate().map(|(i, agent)| read_agent(agent, sizes, i));
    let states = [rows[0], rows[1], sizes.state];
    Ok(TrajectoryChunk {
        sequence: wire.sequence,
        first_step: wire.first_step,
        steps: wire.steps,
        agents: agents.collect::<Result<_, _>>()?,
        state: read_floats(wire.state.as_ref(), &states, "chunk.state")?,
        reward: read_floats(wire.reward.as_ref(), &rows, "chunk.reward")?,
        terminated: read_flags(wire.terminated.as_ref(), &rows, "chunk.terminated")?,
        truncated: read_flags(wire.truncated.as_ref(), &rows, "chunk.truncated")?,
        finals: read_finals(wire.finals.as_ref(), sizes)?,
        end: read_end(wire.end.as_ref(), sizes, last)?,
        reward_terms: read_terms(&wire.reward_terms, sizes.run, rows, "chunk.reward_terms")?,
    })
}

/// Sums over at most `steps` steps of the reward's terms, `[rows, K]`; empty if they were left out.
fn read_terms(
    sums: &[f64],
    run: &RunDescription,
    [steps, rows]: [usize; 2],
    field: &str,
) -> Result<Vec<f64>, Refusal> {
    if !sums.is_empty() {
        length(sums.len(), rows * run.environment.reward_terms.len(), field)?;
    }
    let most = f64::from(MAX_MAGNITUDE) * steps as f64;
    match sums.iter().position(|sum| !(-most..=most).contains(sum)) {
        None => Ok(sums.to_vec()),
        Some(at) => Err(unusable(field, &format!("element {at} is"), sums[at], most)),
    }
}

fn read_agent(
    wire: &wire::AgentChunk,
    sizes: &Sizes<'_>,
    agent: usize,
) -> Result<AgentChunk, Refusal> {
    let (t, e) = (sizes.steps, sizes.environments);
    let field = |name: &str| format!("chunk.agents[{agent}].{name}");
    let observation = [t, e, sizes.observation(agent)];
    let action = [t, e, sizes.action(agent)];
    let hidden = [sizes.stored(), e, sizes.hidden(agent)];
    Ok(AgentChunk {
        observation: read_floats(wire.observation.as_ref(), &observation, &field("observation"))?,
        action: read_floats(wire.action.as_ref(), &action, &field("action"))?,
        log_prob: read_floats(wire.log_prob.as_ref(), &[t, e], &field("log_prob"))?,
        hidden: read_floats(wire.hidden.as_ref(), &hidden, &field("hidden"))?,
    })
}

/// Final steps. Without any, their tensors are not checked.
fn read_finals(
    wire: Option<&wire::FinalSteps>,
    sizes: &Sizes<'_>,
) -> Result<Vec<FinalStep>, Refusal> {
    let Some(wire) = wire.filter(|wire| !wire.steps.is_empty()) else { return Ok(Vec::new()) };
    let count = wire.steps.len();
    let most = sizes.steps * sizes.environments;
    from_1_to(most, count, "entries", "chunk.finals.steps")?;
    length(wire.environments.len(), count, "chunk.finals.environments")?;
    let state = read_floats(wire.state.as_ref(), &[count, sizes.state], "chunk.finals.state")?;
    length(wire.observations.len(), sizes.agents, "chunk.finals.observations")?;
    let observations = wire.observations.iter().enumerate().map(|(i, tensor)| {
        let field = format!("chunk.finals.observations[{i}]");
        read_floats(Some(tensor), &[count, sizes.observation(i)], &field)
    });
    let observations = observations.collect::<Result<Vec<_>, _>>()?;
    let row =
        |all: &[f32], i: usize| all[i * all.len() / count..(i + 1) * all.len() / count].to_vec();
    let last = |(i, (step, environment)): (usize, (&u32, &u32))| FinalStep {
        step: *step,
        environment: *environment,
        state: row(&state, i),
        observation: observations.iter().map(|all| row(all, i)).collect(),
    };
    Ok(wire.steps.iter().zip(&wire.environments).enumerate().map(last).collect())
}

fn read_end(
    wire: Option<&wire::SlotEnd>,
    sizes: &Sizes<'_>,
    last: Last,
) -> Result<Option<SlotEnd>, Refusal> {
    if last == Last::No {
        let detail = "must be absent except in the slot's last chunk";
        let refusal = || Refusal::new(Reason::Inconsistent, "chunk.end", detail);
        return wire.map_or(Ok(None), |_| Err(refusal()));
    }
    let wire = required(wire, "chunk.end")?;
    length(wire.environments.len(), sizes.environments, "chunk.end.environments")?;
    for (i, state) in wire.environments.iter().enumerate() {
        state_size(state.len(), sizes.run, &format!("chunk.end.environments[{i}]"))?;
    }
    length(wire.recurrent.len(), sizes.agents, "chunk.end.recurrent")?;
    let recurrent = wire.recurrent.iter().enumerate().map(|(i, tensor)| {
        let shape = [sizes.environments, sizes.hidden(i)];
        read_floats(Some(tensor), &shape, &format!("chunk.end.recurrent[{i}]"))
    });
    Ok(Some(SlotEnd {
        environments: wire.environments.iter().map(|state| state.to_vec()).collect(),
        recurrent: recurrent.collect::<Result<_, _>>()?,
    }))
}

/// Checks that every discrete action is the index of a choice.
fn check_choices(chunk: &TrajectoryChunk, run: &RunDescription) -> Result<(), Refusal> {
    for (i, (rows, agent)) in chunk.agents.iter().zip(&run.environment.agents).enumerate() {
        let Some(choices) = agent.action.choices else { continue };
        let is_choice = |a: &f32| *a >= 0.0 && *a < choices as f32 && a.fract() == 0.0;
        if let Some(at) = rows.action.iter().position(|a| !is_choice(a)) {
            let detail =
                format!("element {at} is {}, a choice is 0 to {}", rows.action[at], choices - 1);
            return Err(bad_value(&format!("chunk.agents[{i}].action"), detail));
        }
    }
    Ok(())
}

fn check_flags(chunk: &TrajectoryChunk, environments: usize) -> Result<(), Refusal> {
    let both = chunk.terminated.iter().zip(&chunk.truncated).position(|(a, b)| *a && *b);
    let Some(row) = both else {
        return Ok(());
    };
    let t = row / environments;
    let e = row % environments;
    let detail = format!("step {t} of environment {e} is also terminated");
    Err(Refusal::new(Reason::Inconsistent, "chunk.truncated", detail))
}

/// Requires final steps for every step that ends an episode and, in the slot's last chunk, for each environment's last step.
fn check_finals(chunk: &TrajectoryChunk, sizes: &Sizes<'_>, last: Last) -> Result<(), Refusal> {
    let e = sizes.environments;
    let slot_end = |row: usize| last == Last::Yes && row / e + 1 == sizes.steps;
    let needed = (0..sizes.steps * e)
        .filter(|row| chunk.terminated[*row] || chunk.truncated[*row] || slot_end(*row))
        .map(|row| (chunk.first_step + (row / e) as u32, (row % e) as u32));
    let mut found = chunk.finals.iter().map(|last| (last.step, last.environment));
    for (i, (step, environment)) in needed.enumerate() {
        let got = found.next();
        if got != Some((step, environment)) {
            let got =
                got.map_or("nothing".to_owned(), |(s, e)| format!("step {s} of environment {e}"));
            let detail =
                format!("entry {i} is {got}, expected step {step} of environment {environment}");
            return Err(Refusal::new(Reason::Inconsistent, "chunk.finals", detail));
        }
    }
    found.next().map_or(Ok(()), |(step, environment)| {
        let detail = format!(
            "step {step} of environment {environment} ends neither an episode nor the slot"
        );
        Err(Refusal::new(Reason::Inconsistent, "chunk.finals", detail))
    })
}
