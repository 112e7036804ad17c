//! The JSON responses of the page.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use super::{OverlaidRun, Overlay, RunView};
use crate::lease::exchange::status_json;
use crate::observe::metrics::Curves;

/// Constants of the run.
pub(super) fn run(view: &RunView) -> Value {
    let facts = &view.facts;
    json!({
        "manifest": facts.manifest,
        "iterations": facts.iterations,
        "env_steps": facts.env_steps,
    })
}

/// The current status of the run.
pub(super) fn status(view: &RunView) -> Value {
    let run = view.exchange.run_snapshot();
    json!({
        "status": status_json(&run.status),
        "stage": run.stage.name(),
        "waiting": run.waiting,
        "secs": run.phase_secs().map(BTreeMap::from),
        "checkpoint": run.checkpoint.map(|written| written.iteration),
        "checkpoint_failures": run.checkpoint_failures,
        "lines": view.curves().lines(),
        "film": run.film.as_ref().map(|episode| episode.version.0),
    })
}

/// All curves since the start of the run: environment steps and figures, as arrays of equal length.
pub(super) fn curves(view: &RunView) -> Value {
    let curves = view.curves().clone();
    json!({"lines": curves.lines(), "curves": arrays(&curves)})
}

/// The names of several runs.
pub(super) fn runs(overlay: &Overlay) -> Value {
    let names: Vec<_> = overlay.runs.iter().map(|run| &run.name).collect();
    json!({"version": overlay.version, "runs": names})
}

/// All curves of several runs, with each run's group of seeds and what cannot be read of it, or null.
pub(super) fn curves_of_runs(overlay: &Overlay) -> Value {
    let of_run = |run: &OverlaidRun| {
        let OverlaidRun { name, group, trouble, curves } = run;
        json!({"name": name, "group": group, "trouble": trouble, "curves": arrays(curves)})
    };
    let runs: Vec<_> = overlay.runs.iter().map(of_run).collect();
    json!({"version": overlay.version, "runs": runs})
}

fn arrays(curves: &Curves) -> Map<String, Value> {
    let all = curves.iter().map(|(name, curve)| {
        let (steps, figures): (Vec<u64>, Vec<f64>) =
            curve.points().map(|(steps, figure)| (steps, short(figure))).unzip();
        (name.to_owned(), json!([steps, figures]))
    });
    all.collect()
}

/// The figure in single precision. More digits would not be visible and would double the size of the response.
fn short(figure: f64) -> f64 {
    (figure as f32).to_string().parse().unwrap_or(f64::NAN)
}

/// The newest film of an evaluated episode, or null. Ends are in millimetres.
pub(super) fn film(view: &RunView) -> Value {
    let run = view.exchange.run_snapshot();
    let Some(episode) = &run.film else { return Value::Null };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_the_digits_of_single_precision() {
        assert_eq!(json!([short(0.1), short(1.0 / 3.0)]).to_string(), "[0.1,0.33333334]");
        assert_eq!(json!(short(f64::NAN)), Value::Null);
    }
}
