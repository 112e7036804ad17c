//! The part of an experiment's runs that one process computes.

use std::fmt::{self, Display};
use std::str::FromStr;

use super::plan::PlannedRun;
use crate::errors::Usage;

/// The runs whose index modulo `count` is `index`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shard {
    index: usize,
    count: usize,
}

/// Runs of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Selection {
    /// All runs.
    All,
    /// The runs of a shard.
    Shard(Shard),
    /// The run with this index.
    Only(usize),
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(index, count)| {
            Some(Self { index: index.parse().ok()?, count: count.parse().ok()? })
        });
        match numbers {
            Some(shard) if shard.index < shard.count => Ok(shard),
            Some(Self { count, .. }) if count > 0 => {
                Err(format!("I of I/N must be in 0..={}", count - 1))
            }
            _ => Err("write I/N, for example 0/4 for the first of four shards".to_owned()),
        }
    }
}

impl Selection {
    /// The selected runs.
    ///
    /// # Errors
    /// Names an index that no run has.
    pub(crate) fn of(self, runs: &[PlannedRun]) -> Result<Vec<PlannedRun>, Usage> {
        if let Self::Only(index) = self
            && index >= runs.len()
        {
            let last = runs.len().saturating_sub(1);
            return Err(Usage::new(format!(
                "--only {index}: the runs have the indexes 0..={last}; --list shows them"
            )));
        }
        Ok(runs.iter().filter(|run| self.contains(run.index)).cloned().collect())
    }

    fn contains(self, index: usize) -> bool {
        match self {
            Self::All => true,
            Self::Shard(shard) => index % shard.count == shard.index,
            Self::Only(only) => index == only,
        }
    }
}

/// The arguments that select the runs, after a space.
impl Display for Selection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => Ok(()),
            Self::Shard(Shard { index, count }) => write!(f, " --shard {index}/{count}"),
            Self::Only(index) => write!(f, " --only {index}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::file::tests::SAMPLE;
    use crate::experiment::plan::plan;

    fn indexes(selection: Selection) -> Vec<usize> {
        let runs = plan(&toml::from_str(SAMPLE).unwrap()).unwrap();
        selection.of(&runs).unwrap().iter().map(|run| run.index).collect()
    }

    #[test]
    fn the_shards_of_a_plan_contain_each_run_once() {
        let shard = |text: &str| indexes(Selection::Shard(text.parse().unwrap()));
        assert_eq!(indexes(Selection::All), [0, 1, 2, 3, 4]);
        assert_eq!((shard("0/2"), shard("1/2")), (vec![0, 2, 4], vec![1, 3]));
        assert_eq!(shard("6/7"), Vec::<usize>::new());
        assert_eq!(indexes(Selection::Only(3)), [3]);
    }

    #[test]
    fn a_shard_or_a_run_that_does_not_exist_is_refused_with_what_exists() {
        for (text, words) in
            [("4/4", "I of I/N must be in 0..=3"), ("1/0", "write I/N"), ("3", "write I/N")]
        {
            let error = text.parse::<Shard>().unwrap_err();
            assert!(error.contains(words), "{error}");
        }
        let runs = plan(&toml::from_str(SAMPLE).unwrap()).unwrap();
        let error = Selection::Only(5).of(&runs).unwrap_err().to_string();
        assert_eq!(error, "--only 5: the runs have the indexes 0..=4; --list shows them");
    }
}
