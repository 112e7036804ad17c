//! The learning curves of a run on the topic `/curves`: all of them in each message, so that one message is enough.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use actor::{LiveServer, LiveTopic};
use anyhow::Context as _;
use serde_json::{Map, Value, json};

use crate::run::run_path;

/// How often the metrics are looked at.
const LOOK_AGAIN: Duration = Duration::from_secs(1);

/// The curves of a run, as far as they have been read.
pub(super) struct Curves {
    topic: LiveTopic,
    lines: Lines,
    curves: learner::metrics::Curves,
    looked: Option<Instant>,
}

impl Curves {
    /// Of the run in `folder`.
    pub(super) fn of(folder: &Path, server: &LiveServer) -> anyhow::Result<Self> {
        let topic = server.topic("/curves", &schema()).context("cannot show the curves")?;
        let lines = Lines::of(run_path::metrics_file(folder));
        Ok(Self { topic, lines, curves: learner::metrics::Curves::default(), looked: None })
    }

    /// Shows what is new, once a second at most, and only if anybody looks.
    pub(super) fn follow(&mut self) {
        let recent = self.looked.is_some_and(|looked| looked.elapsed() < LOOK_AGAIN);
        if recent || !self.topic.is_watched() {
            return;
        }
        self.looked = Some(Instant::now());
        match self.lines.more() {
            Ok(more) => self.take_in(&more),
            Err(error) => tracing::warn!("{}: {error}", self.lines.path.display()),
        }
    }

    fn take_in(&mut self, more: &More) {
        if more.from_the_start {
            self.curves = learner::metrics::Curves::default();
        }
        if !more.lines.is_empty() {
            more.lines.iter().for_each(|line| self.curves.add(line));
            self.topic.show(&message(&self.curves));
        }
    }
}

/// A file of JSON objects that grows, and may be cut back by a resume.
struct Lines {
    path: PathBuf,
    /// Which file stood at the path.
    inode: u64,
    /// Bytes of it that have been read.
    read: u64,
}

/// What has come since.
struct More {
    lines: Vec<Map<String, Value>>,
    /// Whether they are all there are: the file is another one than before.
    from_the_start: bool,
}

impl Lines {
    fn of(path: PathBuf) -> Self {
        Self { path, inode: 0, read: 0 }
    }

    /// The whole lines that have not been read yet; none if there is no file.
    fn more(&mut self) -> std::io::Result<More> {
        let mut file = match File::open(&self.path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(More { lines: Vec::new(), from_the_start: false });
            }
            opened => opened?,
        };
        let found = file.metadata()?;
        let from_the_start = found.ino() != self.inode || found.len() < self.read;
        if from_the_start {
            (self.inode, self.read) = (found.ino(), 0);
        }
        file.seek(SeekFrom::Start(self.read))?;
        let mut text = Vec::new();
        file.read_to_end(&mut text)?;
        let whole = text.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        self.read += whole as u64;
        let lines = text[..whole].split(|byte| *byte == b'\n');
        let lines = lines.filter_map(|line| serde_json::from_slice(line).ok()).collect();
        Ok(More { lines, from_the_start })
    }
}

/// Every curve as `{"env_steps": [...], "value": [...]}`. A name with a slash is a path: `evaluation/mean` stands under
/// `mean` in `evaluation`.
fn message(curves: &learner::metrics::Curves) -> Value {
    let mut message = json!({});
    for (name, curve) in curves.iter() {
        let (env_steps, value): (Vec<u64>, Vec<f64>) = curve.points().unzip();
        let place = name.split('/').fold(&mut message, |outer, part| &mut outer[part]);
        *place = json!({ "env_steps": env_steps, "value": value });
    }
    message
}

/// Two of the curves; the others depend on the algorithm.
fn schema() -> Value {
    let numbers = |about: &str| json!({ "type": "array", "items": { "type": "number" }, "description": about });
    let curve = |about: &str| {
        let (env_steps, value) = (numbers("environment steps"), numbers(about));
        json!({ "type": "object", "properties": { "env_steps": env_steps, "value": value } })
    };
    let mean = curve("mean extrinsic return of an evaluation");
    json!({
        "title": "s2mia.Curves",
        "type": "object",
        "properties": {
            "episode_return": curve("mean extrinsic return of training episodes that ended"),
            "evaluation": { "type": "object", "properties": { "mean": mean } },
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::OpenOptions;
    use std::io::Write as _;

    fn append(path: &Path, text: &str) {
        let mut file = OpenOptions::new().create(true).append(true).open(path).unwrap();
        file.write_all(text.as_bytes()).unwrap();
    }

    fn more(lines: &mut Lines) -> (Vec<u64>, bool) {
        let More { lines, from_the_start } = lines.more().unwrap();
        (lines.iter().map(|line| line["iteration"].as_u64().unwrap()).collect(), from_the_start)
    }

    #[test]
    fn each_line_is_read_once_and_only_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let mut lines = Lines::of(path.clone());
        assert_eq!(more(&mut lines), (vec![], false));
        append(&path, "{\"iteration\":1}\n{\"itera");
        assert_eq!(more(&mut lines), (vec![1], true));
        assert_eq!(more(&mut lines), (vec![], false));
        append(&path, "tion\":2}\n");
        assert_eq!(more(&mut lines), (vec![2], false));
    }

    #[test]
    fn a_file_that_a_resume_has_cut_back_is_read_from_its_start() {
        let folder = tempfile::tempdir().unwrap();
        let (path, cut) = (folder.path().join("metrics.jsonl"), folder.path().join("cut"));
        let mut lines = Lines::of(path.clone());
        append(&path, "{\"iteration\":1}\n{\"iteration\":2}\n");
        assert_eq!(more(&mut lines), (vec![1, 2], true));
        // As long as before, so that its length would not tell.
        append(&cut, "{\"iteration\":1}\n{\"iteration\":3}\n");
        std::fs::rename(&cut, &path).unwrap();
        assert_eq!(more(&mut lines), (vec![1, 3], true));
    }

    #[test]
    fn a_curve_stands_where_the_slashes_of_its_name_lead() {
        let mut curves = learner::metrics::Curves::default();
        let lines = [
            json!({"kind": "iteration", "env_steps": 40, "episode_return": 1.5, "losses/value": 2}),
            json!({"kind": "evaluation", "env_steps": 40, "mean": -1.0}),
            json!({"kind": "evaluation", "env_steps": 80, "mean": 3.0}),
        ];
        lines.iter().for_each(|line| curves.add(line.as_object().unwrap()));
        let expected = json!({
            "episode_return": {"env_steps": [40], "value": [1.5]},
            "losses": {"value": {"env_steps": [40], "value": [2.0]}},
            "evaluation": {"mean": {"env_steps": [40, 80], "value": [-1.0, 3.0]}},
        });
        assert_eq!(message(&curves), expected);
    }
}
