//! The terms of the reward that environments report.

use super::*;

#[test]
fn the_terms_of_every_robots_task_sum_to_its_reward() {
    for &task in task_names().iter().filter(|name| !game::NAMES.contains(*name)) {
        let (task, definition) = (task.to_owned(), None);
        let named = TaskConfig { task, definition, ..config(HOPPER, ObservationMode::FullId) };
        let mut world = environments(&named, 2).unwrap();
        let size = world.description().agents.iter().map(|agent| agent.action.size).sum::<usize>();
        (0..2).for_each(|environment| world.reset(environment, 0, 30, [3; 32]).unwrap());
        let mut outcomes = [Outcome::default(); 2];
        for step in 0..10 {
            // Beyond the range, so that the controls of actions and of motors differ.
            let action = |index: usize| ((step + index) % 5) as f32 * 0.6 - 1.2;
            let actions: Vec<f32> = (0..2 * size).map(action).collect();
            world.step(&actions, &mut outcomes).unwrap();
            for (environment, outcome) in outcomes.iter().enumerate() {
                let terms = world.reward_terms(environment);
                assert_eq!(terms.len(), world.description().reward_terms.len());
                let sum = terms.iter().copied().map(f64::from).sum::<f64>();
                let largest = terms.iter().map(|term| term.abs()).fold(0.0, f32::max);
                let off = (sum - f64::from(outcome.reward)).abs();
                let most = 1e-6 * f64::from(largest);
                assert!(off <= most, "{}: {terms:?}, {outcome:?}", named.task);
            }
        }
    }
}

#[test]
fn terms_are_named_in_the_order_of_the_file_and_costs_are_negative() {
    let repeated = "[[cost]]\nterm = \"alive\"\nweight = 0.25\n\n[[cost]]\nterm";
    let mut world = hopper(&changed("[[cost]]\nterm", repeated));
    let names = ["forward_speed", "alive", "alive_2", "control"];
    assert_eq!(world.description().reward_terms, names);
    let mut outcome = [Outcome::default()];
    world.reset(0, 0, 9, [1; 32]).unwrap();
    assert_eq!(world.reward_terms(0), [0.0; 4]);
    world.step(&[0.5, -1.0], &mut outcome).unwrap();
    // The weight of the squared controls is 1e-3.
    assert_eq!(world.reward_terms(0)[1..], [1.0, -0.25, -1e-3 * 1.25]);
    world.reset(0, 1, 9, [1; 32]).unwrap();
    assert_eq!(world.reward_terms(0), [0.0; 4]);
}

#[test]
fn forward_speed_without_a_coordinate_needs_a_root_that_first_moves_along_x() {
    let built = |joint: &str| {
        let mut config = config(HOPPER, ObservationMode::FullId);
        let model = &mut config.definition.as_mut().unwrap().model;
        let own = "name=\"rootx\" type=\"slide\" axis=\"1 0 0\" armature=\"0\" damping=\"0\"";
        assert!(model.contains(own));
        *model = model.replace(own, &format!("name=\"rootx\" type=\"slide\" {joint}"));
        environments(&config, 1).map(drop).map_err(|error| error.to_string())
    };
    built("axis=\"1 0 0\" damping=\"1\"").unwrap();
    let mut turned = config(HOPPER, ObservationMode::FullId);
    let model = &mut turned.definition.as_mut().unwrap().model;
    let body = "<body name=\"torso\"";
    assert!(model.contains(body));
    *model = model.replacen(body, &format!("{body} euler=\"0 0 1.5\""), 1);
    assert!(environments(&turned, 1).err().unwrap().to_string().contains("is not its x"));
    for axis in ["0 1 0", "0 0 1", "-1 0 0"] {
        let refused = built(&format!("axis=\"{axis}\" damping=\"1\"")).unwrap_err();
        let why =
            "forward_speed: the first coordinate of the root is not its x; name a `coordinate`";
        assert!(refused.contains(why), "{axis}: {refused}");
    }
}

#[test]
fn the_weight_of_a_second_term_of_a_kind_has_its_number() {
    let second = "\n[[reward]]\nterm = \"alive\"\nweight = 7.0\n\n[[healthy]]";
    let config = config(&changed("\n[[healthy]]", second), ObservationMode::FullId);
    assert_eq!(config.weight_in_file("alive_2").unwrap(), 7.0);
    assert_ne!(config.weight_in_file("alive").unwrap(), 7.0);
    assert!(config.weight_in_file("alive_3").is_err());
}
