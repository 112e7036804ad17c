//! Films of evaluation episodes in the exchange.

use learner::observe::snapshot::FilmedEpisode;
use policy::CoreKind;
use proto::{
    Digest, EvaluationResult, Film, Incarnation, LeaseId, PolicyVersion, PushHeader, WeightsName,
};

use crate::one_slot::{exchange, rolled_out};

#[test]
fn a_late_film_of_older_policies_does_not_replace_a_newer_one() {
    let (run, policy, _) = rolled_out(CoreKind::Mlp);
    let exchange = exchange(run, &policy);
    assert_eq!(exchange.run_snapshot().film, None);
    let film = Film { frame_secs: 0.05, radii: vec![0.1], drivers: vec![None], ends: vec![0.0; 6] };
    let result = EvaluationResult { episode: 0, extrinsic_return: 1.0, steps: 5 };
    for (version, shown) in [(2, 2), (1, 2), (2, 2), (4, 4)] {
        let weights = WeightsName { version: PolicyVersion(version), digest: Digest([0; 32]) };
        let (incarnation, digest) = (Incarnation(1), result.digest(1));
        let header = PushHeader { lease: LeaseId(1), incarnation, weights, digest };
        exchange.keep_film(&header, result, film.clone());
        let found = exchange.run_snapshot().film.as_deref().cloned();
        let version = PolicyVersion(shown);
        assert_eq!(found, Some(FilmedEpisode { version, result, film: film.clone() }));
    }
}
