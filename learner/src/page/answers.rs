//! What the page's script asks for, as JSON.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use super::Board;
use crate::exchange::status_json;

/// What does not change while the learner works.
pub(super) fn run(board: &Board) -> Value {
    let facts = &board.facts;
    json!({
        "manifest": facts.manifest,
        "iterations": facts.iterations,
        "env_steps": facts.env_steps,
    })
}

/// Where the run stands.
pub(super) fn status(board: &Board) -> Value {
    let told = board.told();
    json!({
        "status": status_json(&board.exchange.status()),
        "stage": told.stage.name(),
        "waiting": told.waiting,
        "secs": told.secs().map(BTreeMap::from),
        "checkpoint": told.checkpoint.map(|written| written.iteration),
        "checkpoint_failures": told.checkpoint_failures,
        "lines": board.lines(),
        "film": board.exchange.film().map(|episode| episode.version.0),
    })
}

/// Every curve from the start of the run: environment steps, and as many figures.
pub(super) fn curves(board: &Board) -> Value {
    let curves = board.curves();
    let all = curves.iter().map(|(name, curve)| {
        // Nobody sees more digits than single precision has, and they are half of the text.
        let (steps, figures): (Vec<u64>, Vec<f32>) =
            curve.points().map(|(steps, figure)| (steps, figure as f32)).unzip();
        (name.to_owned(), json!([steps, figures]))
    });
    json!({"lines": curves.lines(), "curves": all.collect::<Map<_, _>>()})
}

/// The newest film of an evaluated episode, or null. Ends are told in millimetres.
pub(super) fn film(board: &Board) -> Value {
    let Some(episode) = board.exchange.film() else { return Value::Null };
    let film = &episode.film;
    let millimetres = film.ends.iter().map(|metres| (metres * 1e3).round() as i64);
    json!({
        "iteration": episode.version.0,
        "return": episode.result.extrinsic_return,
        "steps": episode.result.steps,
        "frame_secs": film.frame_secs,
        "radii": film.radii,
        "drivers": film.drivers,
        "ends": millimetres.collect::<Vec<_>>(),
    })
}
