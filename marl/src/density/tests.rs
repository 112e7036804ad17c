//! Properties of all densities, and the bound of Eq. (2) where the true density is known.

use policy::NamedArrays;
use policy::randomness::{Draw, Purpose, generator, standard_normal};
use rand::RngCore;

use super::*;
use crate::density::random_encoder::OUTPUTS;
use crate::distribution::gaussian::entropy;
use crate::state::{restored, saved};
use crate::surprise::entropy_bound;

const KINDS: [DensityKind; 4] = [
    DensityKind::DiagonalGaussian,
    DensityKind::Categorical,
    DensityKind::RandomEncoder,
    DensityKind::Vae,
];
const ROWS: usize = 4000;

fn at(iteration: u64) -> DensityContext {
    DensityContext { seed: RunSeed(4), iteration, agent: 1, query: 0 }
}

fn density(kind: DensityKind, features: usize) -> Box<dyn Density> {
    let signal: Vec<usize> = (0..features).collect();
    build(kind, &signal, (RunSeed(4), 1)).unwrap()
}

fn fit(density: &mut dyn Density, data: &[f32], width: usize, iteration: u64) -> Vec<f64> {
    let observations = Observations { data, width };
    density.fit(observations, at(iteration)).unwrap();
    density.log_prob(observations, at(iteration)).unwrap()
}

/// The entropy bound of a density on the rows it is fitted on, nats.
fn found_entropy(kind: DensityKind, data: &[f32], width: usize) -> f64 {
    entropy_bound(&fit(density(kind, width).as_mut(), data, width, 0))
}

fn normals(count: usize) -> Vec<f32> {
    let mut rng = generator(RunSeed(6), Draw::of(Purpose::Probe));
    (0..count).map(|_| standard_normal(&mut rng)).collect()
}

/// Pairs of independent normal numbers with standard deviations 2 and 1/2; entropy `2.8379`.
fn normal_pairs() -> Vec<f32> {
    normals(2 * ROWS).chunks_exact(2).flat_map(|z| [3.0 + 2.0 * z[0], 0.5 * z[1]]).collect()
}

/// Half of the rows around -4, half around 4, each with standard deviation 1/2.
fn two_modes() -> Vec<f32> {
    let side = |row: usize| if row.is_multiple_of(2) { 4.0 } else { -4.0 };
    normals(ROWS).into_iter().enumerate().map(|(row, z)| side(row) + 0.5 * z).collect()
}

/// 0, 1 and 2 with probabilities 1/2, 1/4 and 1/4.
fn symbols() -> Vec<f32> {
    let mut rng = generator(RunSeed(7), Draw::of(Purpose::Probe));
    (0..ROWS).map(|_| [0.0, 0.0, 1.0, 2.0][rng.next_u32() as usize % 4]).collect()
}

#[test]
fn the_bound_of_the_true_model_is_the_entropy() {
    let pairs = entropy(&[2.0, 0.5]);
    let found = found_entropy(DensityKind::DiagonalGaussian, &normal_pairs(), 2);
    assert!((found - pairs).abs() < 0.04, "{found} {pairs}");
    let letters = 1.5 * libm::log(2.0);
    let found = found_entropy(DensityKind::Categorical, &symbols(), 1);
    assert!((found - letters).abs() < 0.02, "{found} {letters}");
}

#[test]
fn the_bound_of_a_wrong_model_exceeds_the_entropy() {
    let hills = entropy(&[0.5]) + libm::log(2.0);
    let gaussian = found_entropy(DensityKind::DiagonalGaussian, &two_modes(), 1);
    assert!(gaussian > hills + 0.5, "{gaussian} {hills}");
    // The lower bound of a log-density remains one after training.
    let (pairs, data) = (entropy(&[2.0, 0.5]), normal_pairs());
    let mut vae = density(DensityKind::Vae, 2);
    let bounds = (0..20).map(|iteration| entropy_bound(&fit(vae.as_mut(), &data, 2, iteration)));
    let bounds: Vec<f64> = bounds.collect();
    assert!(bounds.iter().all(|bound| *bound > pairs - 0.04), "{bounds:?} {pairs}");
    assert!(bounds[19] < pairs + 0.3, "{bounds:?} {pairs}");
}

#[test]
fn a_values_probability_is_its_smoothed_frequency() {
    let mut density = density(DensityKind::Categorical, 1);
    density.fit(Observations { data: &[5.0, 5.0, 7.0, 0.0], width: 1 }, at(0)).unwrap();
    let queries = Observations { data: &[5.0, -0.0, 9.0], width: 1 };
    // Three values and the unseen one: each counts once more, 8 in all.
    let found = density.log_prob(queries, at(0)).unwrap();
    assert_eq!(found, [3.0 / 8.0, 2.0 / 8.0, 1.0 / 8.0].map(libm::log));
}

#[test]
fn an_autoencoder_continues_training_from_iteration_to_iteration() {
    // A ring, which no Gaussian per feature approximates well.
    let normal = normals(ROWS);
    let ring: Vec<f32> = normal
        .iter()
        .flat_map(|z| {
            let angle = 3.0 * f64::from(*z);
            [libm::cos(angle) as f32, libm::sin(angle) as f32]
        })
        .collect();
    let mut density = density(DensityKind::Vae, 2);
    let bounds: Vec<f64> = (0..20)
        .map(|iteration| entropy_bound(&fit(density.as_mut(), &ring, 2, iteration)))
        .collect();
    let gaussian = found_entropy(DensityKind::DiagonalGaussian, &ring, 2);
    assert!(bounds[19] < bounds[0] - 0.3, "{bounds:?}");
    assert!(bounds[19] < gaussian - 0.3, "{bounds:?} {gaussian}");
}

fn arrays(density: &mut dyn Density) -> NamedArrays {
    saved("", |visitor| density.visit("density/", visitor)).unwrap()
}

#[test]
fn a_restored_density_continues_bit_for_bit_whatever_its_previous_state() {
    let (first, second) = (normal_pairs(), normals(2 * ROWS));
    for kind in KINDS {
        let (mut kept, mut other) = (density(kind, 2), density(kind, 2));
        fit(kept.as_mut(), &first, 2, 0);
        fit(other.as_mut(), &second, 2, 5);
        let stored = arrays(kept.as_mut());
        restored(&stored, |visitor| other.visit("density/", visitor)).unwrap();
        let queries = Observations { data: &second, width: 2 };
        assert_eq!(kept.log_prob(queries, at(1)).unwrap(), other.log_prob(queries, at(1)).unwrap());
        let (mine, yours) = (fit(kept.as_mut(), &second, 2, 1), fit(other.as_mut(), &second, 2, 1));
        assert_eq!(mine, yours, "{kind:?}");
        assert_eq!(arrays(kept.as_mut()), arrays(other.as_mut()), "{kind:?}");
        let nothing = restored(&NamedArrays::new(), |visitor| other.visit("density/", visitor));
        assert!(nothing.unwrap_err().to_string().contains("density/"), "{kind:?}");
    }
}

#[test]
fn every_density_gives_the_same_bits_on_one_two_and_three_threads() {
    let data = normal_pairs();
    for kind in KINDS {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| fit(density(kind, 2).as_mut(), &data, 2, 0))
        };
        assert_eq!(on(1), on(2), "{kind:?}");
        assert_eq!(on(1), on(3), "{kind:?}");
    }
}

#[test]
fn constant_features_are_left_out_and_equal_rows_have_finite_scores() {
    let data: Vec<f32> = normals(300).into_iter().flat_map(|z| [z, 2.0]).collect();
    for kind in KINDS {
        let mut masked = density(kind, 2);
        let found = fit(masked.as_mut(), &data, 2, 0);
        let of_kind = if kind == DensityKind::RandomEncoder { (OUTPUTS, 0) } else { (1, 1) };
        assert_eq!(masked.features(), of_kind, "{kind:?}");
        assert!(found.iter().all(|l| l.is_finite()), "{kind:?} {found:?}");
        let same = [0.5, -0.5].repeat(50);
        for rows in [&same[..], &same[..2]] {
            let found = fit(density(kind, 2).as_mut(), rows, 2, 0);
            assert!(found.iter().all(|score| score.is_finite()), "{kind:?} {found:?}");
        }
    }
}

#[test]
fn an_agent_without_features_has_the_density_1() {
    for kind in KINDS {
        let mut density = density(kind, 0);
        assert_eq!(fit(density.as_mut(), &normals(6), 2, 0), [0.0; 3], "{kind:?}");
        assert_eq!(density.omitted_constant(), 0.0, "{kind:?}");
    }
}

#[test]
fn rows_drawn_for_different_optimiser_steps_have_different_noise_with_a_vae_alone() {
    for kind in KINDS {
        let (mut density, data) = (density(kind, 1), symbols());
        let fitted = fit(density.as_mut(), &data, 1, 0);
        let observations = Observations { data: &data, width: 1 };
        let query =
            |query| density.log_prob(observations, DensityContext { query, ..at(0) }).unwrap();
        assert_eq!(query(0), fitted);
        assert_eq!(query(1), query(1));
        assert_eq!(query(1) == query(2), kind != DensityKind::Vae, "{kind:?}");
    }
}
