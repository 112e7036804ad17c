//! Every message survives the round trip, and an invalid one is rejected with the name of the field.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "wire/acting.rs"]
mod acting;
#[path = "wire/choices.rs"]
mod choices;
#[path = "wire/film.rs"]
mod film;
#[path = "wire/hostile.rs"]
mod hostile;
#[path = "wire/left_out.rs"]
mod left_out;
#[path = "wire/lies.rs"]
mod lies;
#[path = "wire/play.rs"]
mod play;
#[path = "wire/registration.rs"]
mod registration;
#[path = "wire/round_trips.rs"]
mod round_trips;
#[path = "wire/sample.rs"]
mod sample;
