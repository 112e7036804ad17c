//! Suggestions for misspelt names.

/// The candidate most similar to `word`, if it is a few typing errors away at most.
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    nearest_by(word, candidates, strsim::osa_distance)
}

/// As [`nearest`], where `distance` counts the typing errors between the word and a candidate.
pub fn nearest_by<'a>(
    word: &str,
    candidates: impl IntoIterator<Item = &'a str>,
    distance: impl Fn(&str, &str) -> usize,
) -> Option<&'a str> {
    let ranked = candidates.into_iter().map(|candidate| (distance(word, candidate), candidate));
    let similar = ranked.filter(|(errors, _)| *errors <= most_errors(word));
    similar.min_by_key(|(errors, _)| *errors).map(|(_, candidate)| candidate)
}

/// Errors in a word of this length with which it is still recognisable: one in four letters, at most three.
fn most_errors(word: &str) -> usize {
    match word.chars().count() {
        0..=2 => 0,
        letters => (letters / 4).clamp(1, 3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_has_the_fewest_errors_and_not_many() {
        assert_eq!(nearest("kne", ["hip", "knee"]), Some("knee"));
        assert_eq!(nearest("ankle", ["hip", "knee"]), None);
        assert_eq!(nearest("kne", []), None);
    }
}
