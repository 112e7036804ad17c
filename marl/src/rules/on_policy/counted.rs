//! Influence by counting (Eq. 7): a table of `D_k` replaces a learnt posterior, for discrete actions.

use super::experience::{Experience, Influence, mean};
use crate::data::batch::ActionKind;
use crate::data::sequence::Sequences;
use crate::distribution::HeadRows;
use crate::influence::count::{JointSample, counted_conditional, counted_information, numbered};

/// Ids of one agent's rows for counting, `[L, C]`, with its observation as the state; `others` is `[L, C, others]`.
pub(super) fn samples(sequences: &Sequences, others: &[f32]) -> Vec<JointSample> {
    let rows = sequences.layout.rows();
    let states = numbered(&sequences.observation, rows);
    let rows = states.into_iter().zip(numbered(others, rows)).zip(&sequences.action);
    rows.map(|((state, others), &own)| JointSample { state, own: own as u32, others }).collect()
}

/// Influence from the counts of the same rows: no row is held out.
pub(super) fn influence(
    samples: &[JointSample],
    kind: ActionKind,
    experience: &Experience,
) -> Influence {
    let ActionKind::Discrete { choices } = kind else {
        unreachable!("the configuration rejects counting of continuous actions")
    };
    let conditional = HeadRows::categorical(counted_conditional(samples, choices), choices);
    let all: Vec<usize> = (0..samples.len()).collect();
    Influence {
        log_likelihood: mean(&conditional.log_prob(&experience.sequences.action, &all)),
        mi_estimate: counted_information(samples),
        divergence: mean(&conditional.kl_divergences(&experience.behaviour)),
        conditional: Some(conditional),
        ..Influence::default()
    }
}

#[cfg(test)]
mod tests {
    use policy::randomness::{Draw, Purpose, RunSeed, generator};
    use policy::{CoreKind, PolicyConfig};
    use rand::RngCore;

    use super::*;
    use crate::config::{Estimator, TrainingConfig};
    use crate::data::batch::{AgentBatch, AgentShape, Batch, Final, Problem};
    use crate::rules::algorithm::Report;
    use crate::rules::build;
    use crate::rules::tests::{named, plain};
    use crate::sample;

    const STEPS: usize = 20;
    const ENVIRONMENTS: usize = 300;
    const ROWS: usize = STEPS * ENVIRONMENTS;
    const CHOICES: usize = 3;
    const PLACES: usize = 2;

    /// Whether agents observe the cue.
    #[derive(Clone, Copy, PartialEq)]
    enum Cue {
        Seen,
        Hidden,
    }

    impl Cue {
        fn features(self) -> usize {
            if self == Self::Seen { PLACES + CHOICES } else { PLACES }
        }
    }

    /// Agents observe a place and perhaps a cue, one-hot.
    fn problem(cue: Cue) -> Problem {
        let shape = AgentShape {
            observation: cue.features(),
            action: 1,
            action_range: (0.0, 2.0),
            surprise_features: (0..cue.features()).collect(),
            kind: ActionKind::Discrete { choices: CHOICES },
        };
        Problem { agents: vec![shape.clone(), shape], state: PLACES }
    }

    /// A rollout of both agents. `act` chooses both actions from the cue and the second agent's previous action.
    fn play(
        shown: Cue,
        episode: usize,
        mut act: impl FnMut(usize, usize, &mut dyn RngCore) -> [usize; 2],
    ) -> Batch {
        let mut rng = generator(RunSeed(4), Draw::of(Purpose::Probe));
        let one_hot = |k: usize, of: usize| (0..of).map(move |j| if j == k { 1.0 } else { 0.0 });
        let mut batch = Batch {
            steps: STEPS,
            environments: ENVIRONMENTS,
            agents: vec![AgentBatch { log_prob: vec![0.0; ROWS], ..AgentBatch::default() }; 2],
            reward: (0..ROWS).map(|row| (row % 7) as f32).collect(),
            terminated: vec![false; ROWS],
            ..Batch::default()
        };
        let mut last = [0; ENVIRONMENTS];
        for step in 0..STEPS {
            for (environment, last) in last.iter_mut().enumerate() {
                let (place, cue) = (below(PLACES, &mut rng), below(CHOICES, &mut rng));
                let chosen = act(cue, *last, &mut rng);
                *last = chosen[1];
                batch.state.extend(one_hot(place, PLACES));
                for (agent, choice) in batch.agents.iter_mut().zip(chosen) {
                    agent.observation.extend(one_hot(place, PLACES));
                    agent.observation.extend(one_hot(cue, CHOICES).filter(|_| shown == Cue::Seen));
                    agent.action.push(choice as f32);
                }
                let done = (step + 1) % episode == 0;
                batch.truncated.push(done);
                if done || step + 1 == STEPS {
                    let observation = vec![vec![0.0; shown.features()]; 2];
                    let state = vec![0.0; PLACES];
                    batch.finals.push(Final { step, environment, state, observation });
                }
            }
        }
        batch
    }

    fn below(bound: usize, rng: &mut (impl RngCore + ?Sized)) -> usize {
        rng.next_u32() as usize % bound
    }

    /// Follows the cue, but takes each of the other choices with probability 1/5.
    fn follow(cue: usize, rng: &mut dyn RngCore) -> usize {
        (cue + [0, 0, 0, 1, 2][below(5, rng)]) % CHOICES
    }

    fn counting() -> TrainingConfig {
        let mut config = sample::config();
        config.influence.estimator = Estimator::Count;
        config
    }

    fn update(config: &TrainingConfig, cue: Cue, batch: &Batch) -> Report {
        let policy = PolicyConfig {
            core: CoreKind::Mlp,
            backpropagation_steps: 1,
            width: 8,
            ..sample::policy()
        };
        let mut algorithm = build(config, &policy, &problem(cue), RunSeed(0)).unwrap();
        algorithm.update(batch, &plain(batch), 0).unwrap()
    }

    #[test]
    fn the_information_of_agents_that_follow_a_cue_matches_the_closed_form_and_is_zero_given_the_cue()
     {
        // Equal actions have probability 3/5 3/5 + 2 1/5 1/5 = 11/25 over three cells, unequal ones 14/25 over six.
        let (alike, unlike) = (11.0 / 75.0, 7.0 / 75.0);
        let closed = 3.0 * alike * libm::log(9.0 * alike) + 6.0 * unlike * libm::log(9.0 * unlike);
        let found = |shown| {
            let batch = play(shown, STEPS, |cue, _, rng| [follow(cue, rng), follow(cue, rng)]);
            named(&update(&counting(), shown, &batch), "agent0/mi_estimate")
        };
        let (without, with) = (found(Cue::Hidden), found(Cue::Seen));
        // The bias of counting is 2 x 4 / (2 x 6000) and 6 x 4 / (2 x 6000) on average.
        assert!((without - closed).abs() < 0.01 && closed > 0.02, "{without} {closed}");
        assert!((0.0..0.005).contains(&with), "{with}");
    }

    #[test]
    fn with_a_lag_the_previous_action_is_informative_except_across_episodes() {
        // The first agent copies the second one's previous action. Episodes last two steps.
        let batch = play(Cue::Hidden, 2, |_, last, rng| [last, below(CHOICES, rng)]);
        let found = |lag| {
            let mut config = counting();
            config.influence.lag = lag;
            named(&update(&config, Cue::Hidden, &batch), "agent0/mi_estimate")
        };
        assert!((0.0..0.005).contains(&found(0)), "{}", found(0));
        // Every second row has an information of log 3; an episode's first step has no previous one. In the very first
        // step all copy the same action, 0, so the actions are 1/30 from uniform.
        let half = 0.5 * libm::log(3.0);
        assert!((found(1) - half).abs() < 0.02, "{} {half}", found(1));
    }

    #[test]
    fn the_counted_term_is_capped() {
        let batch = play(Cue::Hidden, STEPS, |cue, _, _| [cue, cue]);
        let mut config = counting();
        config.influence.kappa = 0.5;
        // All actions agree, so q determines the choice: log 3 from a uniform policy, and capped.
        let report = update(&config, Cue::Hidden, &batch);
        assert!((named(&report, "agent0/posterior_kl") - libm::log(3.0)).abs() < 0.05);
        assert!((named(&report, "agent0/influence_kl") - 0.5).abs() < 1e-9);
        assert!((named(&report, "agent0/influence_capped") - 1.0).abs() < 1e-9);
        config.influence.kappa = 1000.0;
        let report = update(&config, Cue::Hidden, &batch);
        assert_eq!(named(&report, "agent0/influence_capped"), 0.0);
    }
}
