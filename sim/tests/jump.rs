//! Tests of the jump game: its reward, observations and restored states.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use serde_json::json;
use sim::{EnvironmentBatch, Outcome};

fn game() -> Box<dyn EnvironmentBatch> {
    let observation = json!({
        "mode": "full_id", "norm": "none", "nearest": 1, "globals": "hidden", "contact_forces": "absent",
    });
    let task = json!({"task": "jump-4x1", "observation": observation});
    let mut game = sim::environments(&serde_json::from_value(task).unwrap(), 1).unwrap();
    game.reset(0, 3, 50, [1; 32]).unwrap();
    game
}

fn reward(game: &mut dyn EnvironmentBatch, actions: [f32; 4]) -> f32 {
    let mut outcome = [Outcome::default()];
    game.step(&actions, &mut outcome).unwrap();
    outcome[0].reward
}

#[test]
fn only_a_step_in_which_all_four_agents_jump_is_rewarded() {
    let mut game = game();
    for (actions, rewarded) in [
        ([0.8; 4], 1.0),
        ([0.8, 0.8, 0.8, 0.75], 0.0),
        ([2.0, 1.0, 0.76, 9.0], 1.0),
        ([0.0; 4], 0.0),
    ] {
        assert_eq!(reward(&mut *game, actions), rewarded, "{actions:?}");
    }
}

#[test]
fn every_agent_observes_the_state_and_a_restored_game_shows_the_same() {
    let (mut played, mut restored) = (game(), game());
    reward(&mut *played, [1.0; 4]);
    restored.restore(0, &played.encode(0).unwrap()).unwrap();
    for game in [played, restored] {
        let mut state = [0.0; 2];
        game.state(0, &mut state);
        assert_eq!(state, [0.02, 1.0]);
        for agent in 0..4 {
            let mut seen = [0.0; 2];
            game.observation(0, agent, &mut seen);
            assert_eq!(seen, state);
        }
    }
}
