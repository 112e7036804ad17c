//! Suggestions for misspelt names.

use std::collections::BTreeSet;

/// The candidate most similar to `word`, if it is a few typing errors away at most.
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // Of long words and of words of other lengths, the distance is slow to compute, or known to be large.
    let letters = word.chars().count();
    let is_close = |candidate: &&str| {
        letters <= LONGEST && candidate.chars().count().abs_diff(letters) <= most_errors(word)
    };
    nearest_by(word, candidates.into_iter().filter(is_close), strsim::osa_distance)
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

/// Most names that a message lists.
const MOST_NAMED: usize = 40;

/// What to write in place of an unknown name: the nearest candidate, or one of all.
pub(crate) fn choice<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> String {
    let named = candidates.into_iter().filter(|name| !name.is_empty());
    let all: Vec<&str> = named.collect::<BTreeSet<_>>().into_iter().collect();
    match (nearest(word, all.iter().copied()), all.len()) {
        (Some(name), _) => format!("did you mean `{name}`?"),
        (None, 0) => "there is none".to_owned(),
        (None, 1..=MOST_NAMED) => format!("there are {}", all.join(", ")),
        (None, count) => {
            let more = count - MOST_NAMED;
            format!("there are {} and {more} more", all[..MOST_NAMED].join(", "))
        }
    }
}

/// Longest word that is compared with others, in letters.
const LONGEST: usize = 100;

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

    #[test]
    fn without_a_similar_name_all_are_named_up_to_a_limit() {
        assert_eq!(choice("kne", ["hip", "knee"]), "did you mean `knee`?");
        assert_eq!(choice("ankle", ["knee", "", "hip", "hip"]), "there are hip, knee");
        assert_eq!(choice("ankle", [""]), "there is none");
        let many: Vec<String> = (10..53).map(|number| format!("j{number}")).collect();
        let text = choice("ankle", many.iter().map(String::as_str));
        assert!(text.starts_with("there are j10, j11, ") && text.ends_with(", j49 and 3 more"));
    }
}
