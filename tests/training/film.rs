//! Films of evaluation episodes in the exchange.

use policy::CoreKind;
use proto::{
    Digest, EvaluationResult, Film, Incarnation, LeaseId, PolicyVersion, PushHeader, WeightsName,
};

use crate::one_slot::{exchange, rolled_out};

#[test]
fn of_all_films_those_of_the_sixteen_newest_policies_stay_one_for_each() {
    let (run, policy, _) = rolled_out(CoreKind::Mlp);
    let exchange = exchange(run, &policy);
    assert!(exchange.run_snapshot().films.is_empty());
    let film = Film { frame_secs: 0.05, radii: vec![0.1], drivers: vec![None], ends: vec![0.0; 6] };
    let show = |version, steps| {
        let result = EvaluationResult { episode: 0, extrinsic_return: 1.0, steps };
        let weights = WeightsName { version: PolicyVersion(version), digest: Digest([0; 32]) };
        let (incarnation, digest) = (Incarnation(1), result.digest(1));
        let header = PushHeader { lease: LeaseId(1), incarnation, weights, digest };
        exchange.keep_film(&header, result, film.clone());
    };
    (1..=20).for_each(|version| show(version, 5));
    // A film that comes again, and a late one of older policies.
    show(18, 6);
    show(3, 5);
    let films = &exchange.run_snapshot().films;
    let versions: Vec<_> = films.iter().map(|kept| kept.version.0).collect();
    assert_eq!(versions, (5..=20).collect::<Vec<_>>());
    assert_eq!((films[13].result.steps, &films[13].film), (6, &film));
}
