//! Tests of films: what a recorder captures, and of which tasks.

use proto::MAX_FRAMES;
use rollout::FilmRecorder;

use crate::{cue, fixture};

#[test]
fn a_film_has_every_capsule_at_its_link_and_is_limited_in_length() {
    let world = fixture::world();
    let mut recorder = FilmRecorder::before(&*world).unwrap();
    (0..MAX_FRAMES).for_each(|_| recorder.capture(&*world));
    let film = recorder.film();
    // The torso, its head, and two legs of three links.
    assert_eq!((film.radii.len(), film.ends.len()), (8, MAX_FRAMES * 8 * 6));
    let of = |agent| film.drivers.iter().filter(|driver| **driver == agent).count();
    assert_eq!((of(None), of(Some(0)), of(Some(1))), (2, 3, 3));
    let torso = &world.pose(0).links[0];
    let middle = [0, 1, 2].map(|i| (film.ends[i] + film.ends[i + 3]) / 2.0);
    let off = middle.iter().zip(torso.position).map(|(a, b)| (a - b).abs()).sum::<f32>();
    assert!(off < 1e-5, "{middle:?} and {torso:?}");
}

#[test]
fn what_is_fixed_follows_the_robot_in_every_frame() {
    let mut definition = sim::TaskDefinition::example();
    let wall =
        "<worldbody><geom type=\"box\" conaffinity=\"1\" size=\"0.1 2 0.5\" pos=\"3 0 0.5\"/>";
    definition.model = definition.model.replacen("<worldbody>", wall, 1);
    let task = "hopper-2x1".to_owned();
    let config = sim::TaskConfig { task, definition: Some(definition), ..fixture::task() };
    let world = sim::environments(&config, 1).unwrap();
    let mut recorder = FilmRecorder::before(&*world).unwrap();
    recorder.capture(&*world);
    let film = recorder.film();
    assert_eq!((film.radii.last(), film.drivers.last()), (Some(&0.1), Some(&None)));
    let frames: Vec<_> = film.ends.chunks(6 * film.radii.len()).collect();
    assert_eq!(frames.len(), 2);
    for frame in frames {
        let bar = &frame[frame.len() - 6..];
        let off = bar.iter().zip([3.0, 0.0, 0.1, 3.0, 0.0, 0.9]).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f32::max) < 1e-6, "{bar:?}");
    }
}

#[test]
fn a_game_has_no_film() {
    assert!(FilmRecorder::before(&*sim::environments(&cue(), 1).unwrap()).is_none());
}
