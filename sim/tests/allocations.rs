//! Environments allocate nothing while stepping; only the physics engine does.

use std::sync::Arc;

use allocation_counter::measure;
use sim::{Outcome, Robot, World};

#[test]
fn stepping_a_slot_allocates_only_in_the_physics_engine() {
    for task in ["halfcheetah-2x3", "walker2d-2x3", "ant-2x4"] {
        let config = serde_json::from_value(serde_json::json!({
            "task": task,
            "observation": {
                "mode": "full_id", "norm": "feature_z", "nearest": 1, "globals": "hidden",
                "contact_forces": "zeros",
            },
        }))
        .unwrap();
        let mut slot = sim::environments(&config, 1).unwrap();
        let mut world = World::new(Arc::new(Robot::of_task(task).unwrap()));
        let actions = vec![0.3; world.robot().actuators().count()];
        let mut seen = vec![0.0; slot.description().agents[0].observation.len()];
        let mut outcome = [Outcome::default()];
        let physics = measure(|| (0..50).for_each(|_| assert!(world.step(&actions)))).count_total;
        let whole = measure(|| {
            for _ in 0..50 {
                slot.step(&actions, &mut outcome).unwrap();
                slot.observation(0, 0, &mut seen);
            }
        })
        .count_total;
        println!("{task}: {whole} allocations in 50 steps, {physics} of them in the engine");
        assert_eq!(whole, physics, "{task}");
    }
}
