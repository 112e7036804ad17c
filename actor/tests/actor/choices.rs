//! Tests with discrete actions: chunks in the protocol, log-probabilities, episodes and recordings.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use actor::{EvaluationEpisode, RecordedRun};
use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{
    ActorNetwork, CoreKind, Head, InputNorm, PolicyConfig, PolicySnapshot, RefreshHidden, Scratch,
};
use proto::{
    Digest, EnvironmentStart, PolicyVersion, RolloutOrigin, RolloutWork, RunDescription, Start,
    TrajectoryChunk, WeightsName,
};
use sim::{EnvironmentBatch, ObservationConfig, ObservationNorm, TaskConfig};

use crate::fixture;

const OUT: usize = 3;

fn task() -> TaskConfig {
    let observation =
        ObservationConfig { norm: ObservationNorm::None, ..fixture::task().observation };
    TaskConfig { task: "cue-2x1".to_owned(), observation, ..fixture::task() }
}

fn world() -> Box<dyn EnvironmentBatch> {
    sim::environments(&task(), fixture::ENVIRONMENTS).unwrap()
}

fn policy() -> PolicySnapshot {
    let config = PolicyConfig {
        core: CoreKind::Gru,
        input_norm: InputNorm::LayerNorm,
        encoder: 8,
        hidden: fixture::HIDDEN,
        width: 8,
        layers: 1,
        backpropagation_steps: fixture::HIDDEN_EVERY as usize,
        burn_in: 0,
        refresh_hidden: RefreshHidden::Never,
        initial_sigma: 0.365_529_29,
        sigma_scale: 0.5,
        sigma_floor: 0.05,
        head_gain: 1.0,
    };
    let agent = |index: u32| {
        let mut rng = generator(RunSeed(5), Draw::of(Purpose::Initialisation).agent(index));
        let head = Head::Categorical { choices: OUT };
        let dtype = candle_core::DType::F32;
        ActorNetwork::with_head(&config, 9, 1, head, dtype, &mut rng).unwrap().policy().unwrap()
    };
    PolicySnapshot { agents: vec![agent(0), agent(1)] }
}

fn run() -> RunDescription {
    RunDescription { environment: actor::environment_spec(world().description()), ..fixture::run() }
}

fn roll(world: &mut dyn EnvironmentBatch) -> Vec<TrajectoryChunk> {
    let start = |environment| EnvironmentStart {
        environment,
        start: Start::Fresh { episode: 0, limit: 30 },
    };
    let work = RolloutWork { iteration: 4, slot: 3, environments: vec![start(6), start(7)] };
    let mut chunks = Vec::new();
    let emit = |chunk| {
        chunks.push(chunk);
        ControlFlow::Continue(())
    };
    actor::roll_out(&run(), &work, &policy(), world, |_, _| {}, emit).unwrap();
    chunks
}

#[test]
fn a_slot_with_choices_is_repeatable_and_survives_the_protocol() {
    let mut used = world();
    let first = roll(&mut *used);
    assert_eq!(roll(&mut *used), first);
    assert_eq!(run().validate(), Ok(()));
    let origin = RolloutOrigin { iteration: 4, slot: 3, environments: vec![6, 7] };
    for chunk in &first {
        let (message, digest) = chunk.to_wire(&run(), &origin);
        assert_eq!(&TrajectoryChunk::from_wire(&message, &run(), &origin, digest).unwrap(), chunk);
    }
    let actions: Vec<f32> = first.iter().flat_map(|chunk| chunk.agents[1].action.clone()).collect();
    for choice in [0.0, 1.0, 2.0] {
        assert!(actions.contains(&choice), "{choice} was never chosen");
    }
}

#[test]
fn stored_hidden_states_reproduce_the_log_probabilities_of_choices() {
    let (chunks, policy) = (roll(&mut *world()), policy());
    let rows = fixture::ENVIRONMENTS;
    for (own, agent) in policy.agents.iter().zip(&chunks[0].agents) {
        let mut hidden = agent.hidden[..rows * fixture::HIDDEN].to_vec();
        for step in 0..fixture::HIDDEN_EVERY as usize {
            let mut output = vec![0.0; rows * OUT];
            let observation = &agent.observation[step * rows * 9..(step + 1) * rows * 9];
            own.forward(rows, observation, &mut hidden, &mut output, &mut Scratch::default());
            for (position, output) in output.chunks_exact(OUT).enumerate() {
                let row = step * rows + position;
                assert_eq!(own.log_prob(output, &agent.action[row..=row]), agent.log_prob[row]);
            }
        }
    }
}

#[test]
fn a_recorded_game_has_states_and_choices_but_no_links() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("game.mcap");
    let mut world = sim::environments(&task(), 1).unwrap();
    let policy = policy();
    let run = RecordedRun {
        policy: &policy,
        weights: WeightsName { version: PolicyVersion(4), digest: Digest([7; 32]) },
        metadata: BTreeMap::from([("run_id".to_owned(), "test".to_owned())]),
        settings_toml: String::new(),
        task_settings: serde_json::to_string(&task()).unwrap(),
    };
    let episodes = [0, 1].map(|index| EvaluationEpisode { seed: RunSeed(1), iteration: 4, index });
    let summary = actor::record(&mut *world, &run, &episodes, &path, |_, _| {}).unwrap();
    assert_eq!(summary.episodes[0].steps, 50);
    let bytes = std::fs::read(&path).unwrap();
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        *counts.entry(message.unwrap().channel.topic.clone()).or_default() += 1;
    }
    let expected =
        [("/agents/0", 100), ("/agents/1", 100), ("/share", 2), ("/share_end", 2), ("/step", 100)];
    let expected = expected.map(|(topic, count)| (topic.to_owned(), count));
    assert_eq!(counts, BTreeMap::from(expected));
}
