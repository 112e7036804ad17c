//! Films of episodes survive the round trip, and invalid ones are rejected.

use proto::{Film, MAX_FRAMES, Reason, wire};

use crate::sample;

/// Two frames of a ball and of a leg that agent 1 controls.
fn film() -> Film {
    let ends = (0..2 * 2 * 6).map(|i| i as f32 * 0.125).collect();
    Film { frame_secs: 0.05, radii: vec![0.1, 0.05], drivers: vec![None, Some(1)], ends }
}

#[test]
fn a_film_survives_the_wire() {
    assert_eq!(Film::from_wire(&film().to_wire(), &sample::run()), Ok(film()));
}

#[test]
fn a_film_that_is_too_long_or_has_no_form_is_refused_by_name() {
    let verdict = |change: &dyn Fn(&mut wire::Film)| {
        let mut wire = film().to_wire();
        change(&mut wire);
        let refusal = Film::from_wire(&wire, &sample::run()).unwrap_err();
        (refusal.reason, refusal.field)
    };
    let long = Film { ends: vec![0.0; (MAX_FRAMES + 1) * 12], ..film() }.to_wire();
    assert_eq!(
        verdict(&|wire| *wire = long.clone()),
        (Reason::BadValue, "film.ends.shape".to_owned())
    );
    assert_eq!(verdict(&|wire| wire.ends = None), (Reason::BadValue, "film.ends.shape".to_owned()));
    assert_eq!(verdict(&|wire| wire.radii.clear()), (Reason::BadValue, "film.radii".to_owned()));
    assert_eq!(verdict(&|wire| wire.radii[0] = -1.0), (Reason::BadValue, "film.radii".to_owned()));
    let other = (Reason::BadShape, "film.drivers".to_owned());
    assert_eq!(verdict(&|wire| wire.drivers.truncate(1)), other);
    let unknown = (Reason::BadValue, "film.drivers".to_owned());
    assert_eq!(verdict(&|wire| wire.drivers[0] = 99), unknown);
    let slow = (Reason::BadValue, "film.frame_secs".to_owned());
    assert_eq!(verdict(&|wire| wire.frame_secs = f64::NAN), slow);
    assert_eq!(verdict(&|wire| wire.frame_secs = 0.0), slow);
    let far = Film { ends: vec![1e6; 24], ..film() }.to_wire();
    let ends = (Reason::BadValue, "film.ends".to_owned());
    assert_eq!(verdict(&|wire| *wire = far.clone()), ends);
    let mut broken = film();
    broken.ends[7] = f32::INFINITY;
    let broken = broken.to_wire();
    assert_eq!(
        verdict(&|wire| *wire = broken.clone()),
        (Reason::NotFinite, "film.ends".to_owned())
    );
}
