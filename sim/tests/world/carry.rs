//! The carts and their load: what one and two of them move.

use crate::{coordinates, environments, key, seeded, step};

const TASKS: [&str; 2] = ["carry-light-2x2", "carry-heavy-2x2"];

/// How far the load is along x after an episode in which each cart drives at this speed, m.
fn carried(task: &str, [left, right]: [f32; 2]) -> f32 {
    let mut world = environments(task, 1);
    world.reset(0, 0, u32::MAX, key(&mut seeded(5))).unwrap();
    while !step(&mut *world, &[left, left, right, right]).is_end() {}
    let world = world.world(0).unwrap();
    let names = world.robot().coordinate_names();
    coordinates(world)[names.iter().position(|name| name == "load.x").unwrap()]
}

#[test]
fn one_cart_moves_the_load_by_less_than_its_first_push_and_two_to_the_goal() {
    for task in TASKS {
        for speeds in [[1.0, 0.0], [0.0, 1.0]] {
            let alone = carried(task, speeds);
            assert!(alone < 0.1, "{task} {speeds:?}: {alone}");
        }
        let both = carried(task, [1.0; 2]);
        assert!(both > 1.2, "{task}: {both}");
    }
}

#[test]
fn the_heavy_task_is_the_light_one_with_another_mass() {
    let asset = |kind: &str, end: &str| {
        let path = format!("{}/assets/carry-{kind}.{end}", env!("CARGO_MANIFEST_DIR"));
        std::fs::read_to_string(path).unwrap().replace(kind, "")
    };
    assert_eq!(asset("light", "toml"), asset("heavy", "toml"));
    let (light, heavy) = (asset("light", "xml"), asset("heavy", "xml"));
    let differing: Vec<&str> = light
        .lines()
        .zip(heavy.lines())
        .filter(|(one, other)| one != other && one.trim_start().starts_with('<'))
        .map(|(one, _)| one.trim())
        .collect();
    assert_eq!(
        differing,
        ["<geom type=\"box\" size=\"0.3 0.4 0.1\" mass=\"3.6\" friction=\"0.5\"/>"]
    );
}
