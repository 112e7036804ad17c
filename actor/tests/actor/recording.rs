//! Tests of recordings: topics, schemas, messages, times.

use std::collections::BTreeMap;

use policy::RunSeed;

use crate::fixture::{policy, task};

#[test]
fn a_recording_holds_every_topic_with_its_schema_and_a_message_per_step() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("walk.mcap");
    let metadata = BTreeMap::from([("task".to_owned(), "halfcheetah-2x3".to_owned())]);
    let (mut world, seed) = (sim::environments(&task(), 1).unwrap(), RunSeed(1));
    let summary =
        actor::record((&mut *world, Some(&task())), &policy(), seed, 2, &path, &metadata).unwrap();
    assert_eq!(summary.episodes.len(), 2);
    assert_eq!(summary.bytes, std::fs::metadata(&path).unwrap().len());

    let bytes = std::fs::read(&path).unwrap();
    let mut counts: BTreeMap<String, (String, usize)> = BTreeMap::new();
    let mut last = 0;
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        assert!(message.log_time >= last, "times do not decrease");
        last = message.log_time;
        let schema = message.channel.schema.as_ref().unwrap();
        assert!(!schema.data.is_empty());
        let entry = counts.entry(message.channel.topic.clone()).or_default();
        *entry = (schema.name.clone(), entry.1 + 1);
    }
    let found: Vec<(&str, &str, usize)> = counts
        .iter()
        .map(|(topic, (schema, count))| (topic.as_str(), schema.as_str(), *count))
        .collect();
    assert_eq!(
        found,
        [
            ("/agents/0/action", "s2mia.Action", 2000),
            ("/agents/1/action", "s2mia.Action", 2000),
            ("/episode", "s2mia.Episode", 2000),
            ("/joint_states", "foxglove.JointStates", 2002),
            ("/scene", "foxglove.SceneUpdate", 2),
            ("/tf", "foxglove.FrameTransforms", 2002),
        ]
    );
    // Two episodes of 1,000 steps of 0.05 s with a second between them.
    assert_eq!(last, 101_000_000_000);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!((summary.metadata_indexes.len(), summary.attachment_indexes.len()), (1, 1));
}

#[test]
fn a_missing_folder_is_an_error() {
    let path = std::path::Path::new("/nowhere/at/all.mcap");
    let (mut world, none) = (sim::environments(&task(), 1).unwrap(), BTreeMap::new());
    assert!(actor::record((&mut *world, None), &policy(), RunSeed(1), 1, path, &none).is_err());
}
