//! TensorBoard tags of the figures. They follow CleanRL and HARL: `charts/`, `losses/`, `agentI/`, `stats/`. The
//! paper's own terms are grouped under `s2mia/`, with the agents of one figure next to each other.

use serde_json::Value;

/// Name prefixes of the figures of surprise and influence.
const PAPER_PREFIXES: [&str; 5] = ["surprise_", "influence_", "mi_", "posterior_", "policy_nll"];

/// The finite figures of one line of `metrics.jsonl`, with their tags.
pub(super) fn scalars(line: &Value) -> Vec<(String, f64)> {
    let tag = if line["kind"] == "evaluation" { evaluation_tag } else { iteration_tag };
    let figures = line.as_object().into_iter().flatten();
    figures.filter_map(|(name, value)| Some((tag(name)?, value.as_f64()?))).collect()
}

/// The tag of an evaluation's figure. Its `mean` is the return shown in learning curves.
fn evaluation_tag(name: &str) -> Option<String> {
    match name {
        "kind" | "env_steps" | "iteration" => None,
        "mean" => Some("charts/evaluation_return".to_owned()),
        _ => Some(format!("evaluation/{name}")),
    }
}

fn iteration_tag(name: &str) -> Option<String> {
    let tag = match name {
        "kind" | "env_steps" => return None,
        "episode_return" => "charts/episodic_return".to_owned(),
        "env_steps_per_sec" => "charts/SPS".to_owned(),
        "iteration_secs" => "stats/iteration_time".to_owned(),
        "rollout_secs" => "stats/rollout_time".to_owned(),
        "update_secs" => "stats/update_time".to_owned(),
        "density_secs" => "stats/density_time".to_owned(),
        _ => match name.split_once('/') {
            None => format!("stats/{name}"),
            Some((agent, figure))
                if PAPER_PREFIXES.iter().any(|prefix| figure.starts_with(prefix)) =>
            {
                format!("s2mia/{figure}/{agent}")
            }
            Some(_) => name.to_owned(),
        },
    };
    Some(tag)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn figures_of_an_iteration_have_the_usual_tags() {
        let line = json!({
            "kind": "iteration", "iteration": 2, "env_steps": 80, "episode_return": 5.0,
            "env_steps_per_sec": 20.0, "rollout_secs": 1.5, "update_secs": 0.5, "losses/value_loss": 0.25,
            "agent1/surprise_share": 0.125, "agent1/entropy": null, "actors": 2,
        });
        let expected = [
            ("stats/actors", 2.0),
            ("s2mia/surprise_share/agent1", 0.125),
            ("charts/SPS", 20.0),
            ("charts/episodic_return", 5.0),
            ("stats/iteration", 2.0),
            ("losses/value_loss", 0.25),
            ("stats/rollout_time", 1.5),
            ("stats/update_time", 0.5),
        ];
        assert_eq!(scalars(&line), expected.map(|(tag, value)| (tag.to_owned(), value)));
    }

    #[test]
    fn an_evaluation_has_a_return_and_its_statistics() {
        let line = json!({"kind": "evaluation", "iteration": 2, "env_steps": 80, "mean": 3.0, "minimum": 1.0});
        let expected = [("charts/evaluation_return", 3.0), ("evaluation/minimum", 1.0)];
        assert_eq!(scalars(&line), expected.map(|(tag, value)| (tag.to_owned(), value)));
    }
}
