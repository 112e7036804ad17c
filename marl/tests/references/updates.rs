//! Whole updates from PyTorch's initial weights to its final ones, with optimisers, normalisers and metrics.

use marl::config::{CriticCore, Rule, Sharing};
use marl::{Algorithm, Relabelled, Report, build};
use policy::{Array, CoreKind, NamedArrays, RunSeed};

use crate::file::{ReferenceValues, agree, numbers};
use crate::settings::{AGENTS, batch, config, policy, problem};

/// With this seed the first sweep has the order of the references.
const SWEEPING: RunSeed = RunSeed(0);
/// With this seed the replay first samples the rows of the references.
const DRAWING: RunSeed = RunSeed(1);

/// A file of PyTorch's results, and the settings with which it was made.
#[derive(Clone, Copy)]
struct Case {
    name: &'static str,
    file: &'static [u8],
    core: CoreKind,
    critic: CriticCore,
    rule: (Rule, Sharing),
    seed: RunSeed,
}

const HAPPO_GRU: Case = Case {
    name: "HAPPO with a recurrent core",
    file: include_bytes!("happo_gru.safetensors"),
    core: CoreKind::Gru,
    critic: CriticCore::Mlp,
    rule: (Rule::Happo, Sharing::Separate),
    seed: SWEEPING,
};
const CASES: [Case; 6] = [
    HAPPO_GRU,
    Case {
        name: "HAPPO with a recurrent critic",
        file: include_bytes!("happo_gru_critic.safetensors"),
        critic: CriticCore::Gru,
        ..HAPPO_GRU
    },
    Case {
        name: "HAPPO with a feed-forward core",
        file: include_bytes!("happo_mlp.safetensors"),
        core: CoreKind::Mlp,
        ..HAPPO_GRU
    },
    Case {
        name: "MAPPO with shared parameters",
        file: include_bytes!("mappo_shared.safetensors"),
        rule: (Rule::Mappo, Sharing::Shared),
        ..HAPPO_GRU
    },
    Case {
        name: "a step of MADDPG",
        file: include_bytes!("maddpg.safetensors"),
        core: CoreKind::Mlp,
        rule: (Rule::Maddpg, Sharing::Separate),
        seed: DRAWING,
        ..HAPPO_GRU
    },
    Case {
        name: "two steps of HASAC",
        file: include_bytes!("hasac.safetensors"),
        core: CoreKind::Mlp,
        rule: (Rule::Hasac, Sharing::Separate),
        seed: DRAWING,
        ..HAPPO_GRU
    },
];

/// The file's initial arrays in the algorithm's types. Arrays that the file does not contain are the algorithm's.
fn start(reference: &ReferenceValues, algorithm: &mut dyn Algorithm) -> NamedArrays {
    let mut arrays = algorithm.arrays().unwrap();
    for (name, array) in reference.under("start/") {
        if name.starts_with("memory/") {
            // Empty in a new algorithm.
            let data = reference.single(&format!("start/{name}"));
            let shape = array.shape().to_vec();
            arrays.insert(name.to_owned(), Array::F32 { shape, data });
            continue;
        }
        let own = arrays.get_mut(name).unwrap_or_else(|| panic!("the algorithm has no {name}"));
        assert_eq!(own.shape(), array.shape(), "{name}");
        match own {
            Array::F32 { data, .. } => *data = reference.single(&format!("start/{name}")),
            Array::F64 { data, .. } => *data = numbers(array),
            other => panic!("{name} has an unexpected type: {other:?}"),
        }
    }
    arrays
}

fn updated(reference: &ReferenceValues, case: Case) -> (NamedArrays, Report) {
    let (problem, policy) = (problem(reference), policy(reference, case.core));
    let mut config = config(reference, case.rule.0, case.rule.1);
    config.critic.core = case.critic;
    let mut algorithm = build(&config, &policy, &problem, case.seed).unwrap();
    let start = start(reference, algorithm.as_mut());
    algorithm.restore(&start).unwrap();
    let own = |agent| reference.single(&format!("batch/rewards_{agent}"));
    let rewards = Relabelled { rewards: (0..AGENTS).map(own).collect(), surprise: None };
    let report = algorithm.update(&batch(reference), &rewards, 0).unwrap();
    (algorithm.arrays().unwrap(), report)
}

/// Relative to the largest change of an array's weights. PyTorch computed in double precision, the update in single
/// precision: rounding errors of a gradient, some 1e-6 of its largest element, are a larger part of a small element's
/// step, because Adam's steps hardly depend on the gradient's size. The largest error found is 3.3e-5.
const WEIGHTS: f64 = 1e-4;
/// Relative to an array's largest element, for moments, memories and figures. The largest error found is 1.6e-5.
const OTHERS: f64 = 5e-5;

#[test]
fn whole_updates_agree_with_pytorch_in_every_array() {
    for case in CASES {
        let reference = ReferenceValues::of(case.file);
        let (arrays, report) = updated(&reference, case);
        let expected = reference.under("expected/");
        for (name, expected) in &expected {
            let label = format!("{}: {name}", case.name);
            let expected = numbers(expected);
            if let Some(figure) = name.strip_prefix("report/") {
                let found = report.iter().find(|(own, _)| own == figure).unwrap().1;
                agree(&label, &[found], &expected, OTHERS);
            } else if name.starts_with("weights/") && !name.ends_with(".log") {
                let start = reference.numbers(&format!("start/{name}"));
                let change = |to: &[f64]| -> Vec<f64> {
                    to.iter().zip(&start).map(|(after, before)| after - before).collect()
                };
                agree(&label, &change(&numbers(&arrays[*name])), &change(&expected), WEIGHTS);
            } else {
                agree(&label, &numbers(&arrays[*name]), &expected, OTHERS);
            }
        }
        // Skipped steps are no result, the replay is tested by the update that uses it, and no learning rate is
        // adapted.
        let is_result = |name: &str| {
            !name.starts_with("replay/") && !name.ends_with("skipped") && !name.ends_with("adapted")
        };
        for name in arrays.keys().filter(|name| is_result(name)) {
            let known = expected.iter().any(|(own, _)| own == name);
            assert!(known, "{}: the reference has no {name}", case.name);
        }
    }
}
