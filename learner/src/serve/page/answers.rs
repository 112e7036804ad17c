//! The JSON responses of the page.

use std::sync::Arc;

use serde_json::{Map, Value, json};

use super::{RunFacts, ShownRun};
use crate::observe::metrics::Curves;
use crate::observe::snapshot::FilmedEpisode;

/// What changes of the runs, without their curves.
pub(super) fn runs(shown: &[ShownRun]) -> Value {
    let of_run = |run: &ShownRun| {
        let ShownRun { name, group, trouble, live, policies, episodes, version, .. } = run;
        let policies = policies.iter().map(|(iteration, mean)| json!([iteration, mean]));
        json!({
            "name": name,
            "group": group,
            "trouble": trouble,
            "live": live,
            "policies": policies.collect::<Vec<_>>(),
            "episodes": episodes,
            "version": version,
        })
    };
    json!({"runs": shown.iter().map(of_run).collect::<Vec<_>>()})
}

/// All curves of a run since its start: environment steps and figures, as arrays of equal length.
pub(super) fn curves(shown: &ShownRun) -> Value {
    json!({"version": shown.version, "curves": arrays(&shown.curves)})
}

fn arrays(curves: &Curves) -> Map<String, Value> {
    let all = curves.iter().map(|(name, curve)| {
        let (steps, figures): (Vec<u64>, Vec<f64>) =
            curve.points().filter_map(|(steps, figure)| Some((steps, short(figure)?))).unzip();
        (name.to_owned(), json!([steps, figures]))
    });
    all.collect()
}

/// The figure in single precision, if that can hold it. More digits would not be visible and would double the size of the response.
fn short(figure: f64) -> Option<f64> {
    (figure as f32).to_string().parse().ok().filter(|short: &f64| short.is_finite())
}

/// Constants of a run, or why they cannot be read.
pub(super) fn facts(facts: Result<RunFacts, String>) -> Value {
    facts.map_or_else(error, |facts| json!(facts))
}

/// A film, or null if it must be requested again, or why it cannot be shown. Ends are in millimetres.
pub(super) fn film(filmed: Result<Option<Arc<FilmedEpisode>>, String>) -> Value {
    filmed.map_or_else(error, |filmed| filmed.map_or(Value::Null, |filmed| frames(&filmed)))
}

fn frames(filmed: &FilmedEpisode) -> Value {
    let film = &filmed.film;
    let millimetres = film.ends.iter().map(|metres| (metres * 1e3).round() as i64);
    json!({
        "return": filmed.result.extrinsic_return,
        "steps": filmed.result.steps,
        "frame_secs": film.frame_secs,
        "radii": film.radii,
        "drivers": film.drivers,
        "ends": millimetres.collect::<Vec<_>>(),
    })
}

fn error(why: String) -> Value {
    json!({"error": why})
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
