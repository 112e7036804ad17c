//! Observations that are copies of other numbers of their chunk: of the global state, or of the first agent's observation.
//! Actors leave them out, and the learner restores them before it checks the chunk. `trajectory.proto` has the rule.

use std::borrow::Cow;

use crate::sizes::Sizes;
use crate::tensor;
use crate::{FeatureRole, FeatureSpec, Reason, Refusal, wire};

/// Leaves out the observations that [`restored`] gives back bit for bit.
pub(crate) fn leave_out(chunk: &mut wire::TrajectoryChunk, sizes: &Sizes<'_>) {
    let rows = [sizes.steps, sizes.environments];
    let tensors = chunk.agents.iter_mut().map(|agent| agent.observation.get_or_insert_default());
    Observations { sizes, rows: &rows, tensors: tensors.collect() }.leave_out(chunk.state.as_ref());
    if let Some(finals) = &mut chunk.finals {
        let rows = [finals.steps.len()];
        let tensors = finals.observations.iter_mut().collect();
        Observations { sizes, rows: &rows, tensors }.leave_out(finals.state.as_ref());
    }
}

/// The chunk with all observations. Restored ones have the shapes of a valid chunk, all others are unchecked.
///
/// # Errors
/// If an observation is left out that the rule does not give, or its source has another type, shape or length.
pub(crate) fn restored<'a>(
    wire: &'a wire::TrajectoryChunk,
    sizes: &Sizes<'_>,
) -> Result<Cow<'a, wire::TrajectoryChunk>, Refusal> {
    let sent = wire.agents.iter().map(|agent| agent.observation.as_ref());
    let finals = wire.finals.iter().flat_map(|finals| finals.observations.iter().map(Some));
    if !sent.chain(finals).any(|tensor| tensor.is_none_or(is_left_out)) {
        return Ok(Cow::Borrowed(wire));
    }
    let mut chunk = wire.clone();
    let rows = [sizes.steps, sizes.environments];
    let tensors = chunk.agents.iter_mut().map(|agent| agent.observation.get_or_insert_default());
    let field = |i: usize| format!("chunk.agents[{i}].observation");
    let state = (chunk.state.as_ref(), "chunk.state");
    Observations { sizes, rows: &rows, tensors: tensors.collect() }.restore(state, field)?;
    // More final steps than steps are refused by name later.
    let possible = 1..=sizes.steps * sizes.environments;
    if let Some(finals) = chunk.finals.as_mut().filter(|it| possible.contains(&it.steps.len())) {
        let rows = [finals.steps.len()];
        let tensors = finals.observations.iter_mut().collect();
        let field = |i: usize| format!("chunk.finals.observations[{i}]");
        let state = (finals.state.as_ref(), "chunk.finals.state");
        Observations { sizes, rows: &rows, tensors }.restore(state, field)?;
    }
    Ok(Cow::Owned(chunk))
}

/// No valid observation is empty.
fn is_left_out(tensor: &wire::Tensor) -> bool {
    tensor.data.is_empty()
}

/// All agents' observations of the same rows.
struct Observations<'a> {
    sizes: &'a Sizes<'a>,
    /// Axes before the features.
    rows: &'a [usize],
    tensors: Vec<&'a mut wire::Tensor>,
}

impl Observations<'_> {
    fn leave_out(mut self, state: Option<&wire::Tensor>) {
        let mut first = None;
        for (i, tensor) in self.tensors.iter_mut().enumerate() {
            let source = first.as_ref().or(state).map(|source| &source.data[..]);
            let copies = Copies::of(self.sizes, i, first.as_ref());
            let equal = copies
                .zip(source)
                .is_some_and(|(copies, source)| copies.tensor(self.rows, source) == **tensor);
            if equal {
                **tensor = wire::Tensor::default();
            } else if i == 0 {
                first = Some(tensor.clone());
            }
        }
    }

    fn restore(
        mut self,
        (state, state_field): (Option<&wire::Tensor>, &str),
        field: impl Fn(usize) -> String,
    ) -> Result<(), Refusal> {
        let first = self.tensors.first().filter(|first| !is_left_out(first));
        let first = first.map(|first| (**first).clone());
        let source_field = if first.is_some() { field(0) } else { state_field.to_owned() };
        for (i, tensor) in self.tensors.iter_mut().enumerate().take(self.sizes.agents) {
            if !is_left_out(tensor) {
                continue;
            }
            let copies = Copies::of(self.sizes, i, first.as_ref()).ok_or_else(|| {
                let detail = "must be set, because it is no copy of other numbers of the chunk";
                Refusal::new(Reason::MissingField, field(i), detail)
            })?;
            let shape = [self.rows, &[copies.width]].concat();
            let source = first.as_ref().or(state);
            let source = tensor::bytes(source, wire::DataType::F32, &shape, &source_field)?;
            **tensor = copies.tensor(self.rows, source);
        }
        Ok(())
    }
}

/// How an observation consists of copied features, followed by constants.
struct Copies<'a> {
    /// Features of the source.
    width: usize,
    /// Features of the source that are copied.
    places: Cow<'a, [usize]>,
    constants: Vec<[u8; 4]>,
}

impl<'a> Copies<'a> {
    /// The observation of `agent` as a copy of the `first` agent's, if that is sent, or else of the global state.
    fn of(sizes: &Sizes<'a>, agent: usize, first: Option<&wire::Tensor>) -> Option<Self> {
        match first {
            Some(_) => Self::of_first(sizes, agent),
            None => Self::of_state(sizes, agent),
        }
    }

    fn of_state(sizes: &Sizes<'a>, agent: usize) -> Option<Self> {
        let own = sizes.run.environment.agents.get(agent)?;
        let rest = own.observation.get(own.seen.len()..).filter(|_| !own.seen.is_empty())?;
        let mut identities = 0..;
        let constant = |feature: &FeatureSpec| match feature.role {
            FeatureRole::Identity => Some(f32::from(identities.next() == Some(agent))),
            FeatureRole::Constant => Some(0.0),
            FeatureRole::Signal | FeatureRole::Duplicate => None,
        };
        let constants = rest.iter().map(constant).map(|value| value.map(f32::to_le_bytes));
        let constants = constants.collect::<Option<_>>()?;
        Some(Self { width: sizes.state, places: Cow::Borrowed(&own.seen), constants })
    }

    fn of_first(sizes: &Sizes<'a>, agent: usize) -> Option<Self> {
        let agents = &sizes.run.environment.agents;
        let first = &agents.first()?.observation;
        let own = &agents.get(agent)?.observation;
        let roles = |features: &'a [FeatureSpec]| features.iter().map(|feature| feature.role);
        if first.is_empty() || !roles(first).eq(roles(own)) {
            return None;
        }
        let identities = roles(own).enumerate().filter(|(_, role)| *role == FeatureRole::Identity);
        let identities = identities.map(|(place, _)| place).collect::<Vec<_>>();
        let mut places = (0..own.len()).collect::<Vec<_>>();
        if let (Some(one), Some(other)) = (identities.first(), identities.get(agent)) {
            places.swap(*one, *other);
        }
        Some(Self { width: first.len(), places: Cow::Owned(places), constants: Vec::new() })
    }

    /// The observations `[rows, obs]` of the encoded source `[rows, width]`.
    fn tensor(&self, rows: &[usize], source: &[u8]) -> wire::Tensor {
        let size = self.places.len() + self.constants.len();
        let mut data = Vec::with_capacity(source.len() / self.width * size);
        for row in source.as_chunks::<4>().0.chunks_exact(self.width) {
            data.extend(self.places.iter().map(|place| row[*place]));
            data.extend_from_slice(&self.constants);
        }
        tensor::encoded(&[rows, &[size]].concat(), data.into_flattened())
    }
}
