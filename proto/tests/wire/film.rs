//! Films of episodes survive the round trip, and invalid ones are rejected.

use proto::Reason::{BadShape, BadValue, NotFinite};
use proto::{Film, MAX_FRAMES, Reason, wire};

use crate::{assert_refused, sample};

/// Two frames of a ball and of a leg that agent 1 controls.
fn film() -> Film {
    let ends = (0..2 * 2 * 6).map(|i| i as f32 * 0.125).collect();
    Film { frame_secs: 0.05, radii: vec![0.1, 0.05], drivers: vec![None, Some(1)], ends }
}

fn with_ends(ends: Vec<f32>) -> wire::Film {
    Film { ends, ..film() }.to_wire()
}

#[test]
fn a_film_survives_the_wire() {
    assert_eq!(Film::from_wire(&film().to_wire(), &sample::run()), Ok(film()));
}

#[test]
fn a_film_that_is_too_long_or_has_no_form_is_refused_by_name() {
    type Change = fn(&mut wire::Film);
    let changes: [(Reason, &str, Change); 10] = [
        (BadValue, "ends.shape", |film| *film = with_ends(vec![0.0; (MAX_FRAMES + 1) * 12])),
        (BadValue, "ends.shape", |film| film.ends = None),
        (BadValue, "radii", |film| film.radii.clear()),
        (BadValue, "radii", |film| film.radii[0] = -1.0),
        (BadShape, "drivers", |film| film.drivers.truncate(1)),
        (BadValue, "drivers", |film| film.drivers[0] = 99),
        (BadValue, "frame_secs", |film| film.frame_secs = f64::NAN),
        (BadValue, "frame_secs", |film| film.frame_secs = 0.0),
        (BadValue, "ends", |film| *film = with_ends(vec![1e6; 24])),
        (NotFinite, "ends", |film| {
            *film = with_ends([vec![0.0; 23], vec![f32::INFINITY]].concat())
        }),
    ];
    for (reason, field, change) in changes {
        let mut film = film().to_wire();
        change(&mut film);
        assert_refused(Film::from_wire(&film, &sample::run()), reason, &format!("film.{field}"));
    }
}
