//! Tests of a single complete log.

use foxglove::messages::{FrameTransforms, JointStates};
use policy::{Draw, Noise, PolicyConfig, RunSeed};
use prost::Message as _;
use proto::trajectory_log::Kind;
use proto::{Episodes, EvaluationWork};

use super::fixture::{ENVIRONMENTS, policy_config, policy_of, task, world};
use super::work::{fresh_work, run};
use super::{WHOLE, evaluate, files, read, roll, roll_with, slot_log, start};
use crate::share::LoggedShare;
use crate::trajectory_log::file::{LogFile, Origin};
use crate::trajectory_log::source::{new_log, read_bytes};
use crate::trajectory_log::{replay, totals};

#[test]
fn a_slot_is_split_where_its_episodes_end() {
    let folder = tempfile::tempdir().unwrap();
    let (log, shares) = read(&slot_log(folder.path()).0);
    let found: Vec<_> = shares
        .iter()
        .map(|share| (share.head.episode_id.as_str(), share.head.first_step, share.end.steps))
        .collect();
    // Environment 6 is truncated after 15 of the 40 steps.
    let expected = [("rollout-6-0", 0, 15), ("rollout-7-0", 0, 40), ("rollout-6-1", 0, 25)];
    assert_eq!(found, expected);
    let head = &shares[2].head;
    assert_eq!((head.iteration, head.slot, head.environment, head.episode), (4, 3, 6, 1));
    assert_eq!((head.attempt, head.seed, head.weights_version), (1, 3, 4));
    assert_eq!((head.kind(), head.weights_sha256.as_slice()), (Kind::Rollout, &[7; 32][..]));
    assert_eq!(log.words["run_id"], "test");
    assert_eq!(log.settings_toml, "task = \"halfcheetah-2x3\"");
    assert_eq!(log.task().unwrap(), task());
    assert!(shares[0].end.environment_state.is_empty(), "the episode is finished");
}

#[test]
fn a_share_contains_the_data_sent_to_the_learner() {
    let folder = tempfile::tempdir().unwrap();
    let (path, chunks) = slot_log(folder.path());
    let shares = read(&path).1;
    let last = &shares[2];
    for (index, step) in last.steps.iter().enumerate() {
        let slot_step = 15 + index;
        let (chunk, row) = (&chunks[slot_step / 20], (slot_step % 20) * ENVIRONMENTS);
        assert_eq!(step.step.step as usize, index);
        assert_eq!(step.step.reward, chunk.reward[row]);
        assert!(step.step.signal.is_empty(), "these agents share no noise");
        assert_eq!(step.step.state, chunk.state[row * 17..(row + 1) * 17]);
        for (agent, sent) in step.agents.iter().zip(&chunk.agents) {
            assert_eq!(agent.observation, sent.observation[row * 19..(row + 1) * 19]);
            assert_eq!(agent.action, sent.action[row * 3..(row + 1) * 3]);
            assert_eq!(agent.log_prob, Some(sent.log_prob[row]));
        }
    }
    let end = chunks[1].end.as_ref().unwrap();
    assert_eq!(last.end.environment_state, end.environments[0]);
}

#[test]
fn a_step_of_agents_that_share_noise_has_the_signal_of_its_key() {
    let noise = PolicyConfig {
        noise: Some(Noise::Shared),
        noise_size: Some(2),
        noise_hold: Some(3),
        ..policy_config()
    };
    let policy = policy_of(&noise, world().description());
    let folder = tempfile::tempdir().unwrap();
    let (log, handle) = start(folder.path(), "a", Episodes::All, 64);
    roll_with(&policy, &handle, &fresh_work(), WHOLE);
    log.close();
    let shares = read(&files(folder.path())[0]).1;
    let noise = policy.agents[1].head().shared_noise().unwrap();
    // Environment and first step in the slot of each share.
    for (share, (environment, first)) in shares.iter().zip([(6, 0), (7, 0), (6, 15)]) {
        for (step, logged) in (first..).zip(&share.steps) {
            let key = Draw::of_action(4, environment, step, 1);
            assert_eq!(logged.step.signal, noise.signal(RunSeed(3), key), "step {step}");
        }
    }
    let first = &shares[0].steps;
    assert_eq!((first[0].step.signal.len(), &first[0].step.signal), (2, &first[2].step.signal));
    assert_ne!(first[0].step.signal, first[3].step.signal);
}

#[test]
fn a_log_has_a_schema_for_every_topic_and_totals() {
    let folder = tempfile::tempdir().unwrap();
    let path = slot_log(folder.path()).0;
    let bytes = read_bytes(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let statistics = summary.stats.unwrap();
    let channels = summary.channels.iter();
    let mut topics: Vec<_> = channels
        .map(|(id, channel)| {
            let schema = channel.schema.as_ref().unwrap();
            (channel.topic.as_str(), schema.name.as_str(), statistics.channel_message_counts[id])
        })
        .collect();
    topics.sort_unstable();
    let expected = [
        ("/agents/0", "s2mia.log.v1.AgentStep", 80),
        ("/agents/1", "s2mia.log.v1.AgentStep", 80),
        ("/joint_states", "foxglove.JointStates", 80),
        ("/scene", "foxglove.SceneUpdate", 3),
        ("/share", "s2mia.log.v1.Share", 3),
        ("/share_end", "s2mia.log.v1.ShareEnd", 3),
        ("/step", "s2mia.log.v1.Step", 80),
        ("/tf", "foxglove.FrameTransforms", 80),
    ];
    assert_eq!(topics, expected);
    // 80 steps of 0.05 s, and a second between successive shares.
    assert_eq!(statistics.message_end_time - statistics.message_start_time, 6_000_000_000);
    let totals = totals(&path).unwrap();
    assert_eq!((totals["steps"].as_str(), totals["lost_steps"].as_str()), ("80", "0"));
}

#[test]
fn a_log_shows_the_links_as_a_tree_and_joints_before_a_step_and_their_efforts_during_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = slot_log(folder.path()).0;
    let bytes = read_bytes(&path).unwrap();
    let first = |topic: &str| {
        let mut messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
        messages.find(|message| message.channel.topic == topic).unwrap().data
    };
    let transforms = FrameTransforms::decode(first("/tf").as_ref()).unwrap().transforms;
    let joints = JointStates::decode(first("/joint_states").as_ref()).unwrap().joints;
    let mut world = sim::environments(&task(), 1).unwrap();
    let share = &read(&path).1[0];
    world.restore(0, &share.head.environment_state).unwrap();
    let pose = world.pose(0);
    assert_eq!((transforms.len(), joints.len()), (pose.links.len(), pose.joints.len()));
    assert!(transforms.len() >= 7 && joints.len() >= 6, "seven links, six of them with motors");
    let close = |found: &[f32], expected: &[f32]| {
        found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4)
    };
    for (found, link) in transforms.iter().zip(&pose.links) {
        assert_eq!(found.child_frame_id, link.name);
        let (at, turned) = (found.translation.unwrap(), found.rotation.unwrap());
        let parent = pose.links.iter().find(|link| link.name == found.parent_frame_id);
        assert_eq!(parent.is_none(), found.parent_frame_id == "world");
        let position = [at.x, at.y, at.z].map(|part| part as f32);
        let in_world = parent.map_or(position, |parent| parent.in_world(position));
        assert!(close(&in_world, &link.position), "{found:?} {link:?}");
        let turn = [turned.x, turned.y, turned.z, turned.w].map(|part| part as f32);
        let arrow = sim::rotated(turn, [1.0, 2.0, 3.0]);
        let arrow = parent.map_or(arrow, |parent| sim::rotated(parent.quaternion, arrow));
        assert!(close(&arrow, &sim::rotated(link.quaternion, [1.0, 2.0, 3.0])), "{found:?}");
    }
    let gears = [120.0, 90.0, 60.0, 120.0, 60.0, 30.0];
    let actions = share.steps[0].agents.iter().flat_map(|agent| &agent.action);
    let torques = gears.iter().zip(actions).map(|(gear, action)| gear * action.clamp(-1.0, 1.0));
    for ((found, joint), torque) in joints.iter().zip(&pose.joints).zip(torques) {
        assert_eq!(found.name, joint.name);
        let numbers = [found.position, found.velocity, found.effort].map(|one| one.unwrap() as f32);
        let expected = [joint.position, joint.velocity, torque];
        assert!(close(&numbers, &expected), "{found:?} {joint:?}");
    }
}

#[test]
fn an_evaluation_is_logged_completely_without_log_probabilities() {
    let folder = tempfile::tempdir().unwrap();
    let (log, handle) = start(folder.path(), "a", Episodes::Evaluation, 64);
    roll(&handle, &fresh_work(), WHOLE);
    evaluate(&handle, EvaluationWork { iteration: 9, episode: 2 });
    log.close();
    let shares = read(&files(folder.path())[0]).1;
    assert_eq!(shares.len(), 1, "rollouts are not logged");
    let share = &shares[0];
    assert_eq!((share.head.episode_id.as_str(), share.end.steps), ("evaluation-9-2", 1000));
    assert!(
        share.steps.iter().all(|step| step.agents.iter().all(|agent| agent.log_prob.is_none()))
    );
    assert!(share.steps[999].step.truncated && !share.steps[998].step.truncated);
}

/// Difference that a replay of the slot's log finds after `change`.
fn difference_after(change: impl Fn(&mut LoggedShare)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let mut shares = read(&slot_log(folder.path()).0).1;
    change(&mut shares[1]);
    let origin = Origin::of_run(&run(), &task(), "b", Episodes::All);
    let (path, target) = new_log(folder.path(), "b").unwrap();
    let mut file = LogFile::begin((path.clone(), target), &origin).unwrap();
    shares.iter().for_each(|share| file.write(share).unwrap());
    file.finish((0, 0)).unwrap();
    let replayed = replay(&read_bytes(&path).unwrap(), |_, _| {}).unwrap();
    assert_eq!(replayed.shares, 1, "the share before is unchanged");
    replayed.difference.unwrap().to_string()
}

#[test]
fn a_replay_names_the_first_step_that_differs() {
    let found = difference_after(|share| share.steps[20].step.reward += 1.0);
    assert!(found.starts_with("rollout-7-0, step 20: the reward differs: "), "{found}");
    let found = difference_after(|share| share.steps[20].step.reward_terms[0] += 1.0);
    assert!(
        found.starts_with("rollout-7-0, step 20: the reward's term forward_speed differs: "),
        "{found}"
    );
    let found = difference_after(|share| share.steps[20].agents[1].observation[3] = 5.0);
    let start =
        "rollout-7-0, step 20: agent 1's observation of bshin.position differs: logged 5.0, ";
    assert!(found.starts_with(start), "{found}");
    let found = difference_after(|share| share.steps[30].agents[0].action[1] -= 0.5);
    assert!(found.starts_with("rollout-7-0, step 30: the reward differs: "), "{found}");
    let found = difference_after(|share| share.end.environment_state[40] ^= 1);
    let what = "the equality of encoded states differs: logged true, replayed false";
    assert_eq!(found, format!("rollout-7-0, step 40: {what}"));
}
