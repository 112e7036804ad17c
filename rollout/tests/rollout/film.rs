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
fn a_game_has_no_film() {
    assert!(FilmRecorder::before(&*sim::environments(&cue(), 1).unwrap()).is_none());
}
