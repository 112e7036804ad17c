"""A recording opens in the reference reader, and holds what a robot player and a script need."""

import json
import math

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from conftest import TINY, s2mia

SCHEMAS = {
    "/tf": "foxglove.FrameTransforms",
    "/joint_states": "foxglove.JointStates",
    "/scene": "foxglove.SceneUpdate",
}


@pytest.fixture(scope="module")
def messages(recording):
    """Decoded protobuf messages by topic, as (log time in ns, message)."""
    found = {}
    with recording.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=list(SCHEMAS)):
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


def test_schemas_are_foxglove_s_and_come_with_the_file(recording):
    with recording.open("rb") as file:
        summary = make_reader(file).get_summary()
    named = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
    for topic, name in SCHEMAS.items():
        assert named[topic].name == name
        assert named[topic].encoding == "protobuf" and named[topic].data


def read_all(path):
    """Every message of the file as (topic, message), by the loop that mcap's documentation shows."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [(channel.topic, decoded) for _, channel, _, decoded in reader.iter_decoded_messages()]


def test_every_topic_of_a_recording_and_of_a_log_is_decoded(recording, tmp_path):
    s2mia("train", *TINY, f"run.dir={tmp_path / 'run'}", "run.iterations=1", "log.episodes=all")
    logs = sorted((tmp_path / "run" / "logs").glob("trajectories-*.mcap"))
    topics = {f"/agents/{agent}" for agent in range(6)} | {"/share", "/step", "/share_end", *SCHEMAS}
    assert {topic for topic, _ in read_all(recording)} == topics
    assert logs and {topic for log in logs for topic, _ in read_all(log)} == topics


def test_the_return_of_the_rewards_is_the_one_that_is_printed(run, tmp_path):
    path = tmp_path / "two.mcap"
    printed = s2mia("record", run, "--episodes", 2, "--out", path)
    episodes = []
    for topic, message in read_all(path):
        if topic == "/share":
            episodes.append([message.episode_id, 0.0])
        elif topic == "/step":
            episodes[-1][1] += message.reward
    told = [f"episode {index} ({name}, seed 7): return {total:.2f}, " for index, (name, total) in enumerate(episodes)]
    assert len(told) == 2 and all(line in printed for line in told), (told, printed)


def test_channels_name_the_numbers_of_their_messages(recording, tasks):
    with recording.open("rb") as file:
        channels = {channel.topic: channel for channel in make_reader(file).get_summary().channels.values()}
    names = {topic: {key: json.loads(text) for key, text in channel.metadata.items()} for topic, channel in channels.items()}
    for index, agent in enumerate(tasks["halfcheetah-6x1"]["agents"]):
        assert names[f"/agents/{index}"]["action"] == agent["joints"]
        assert names[f"/agents/{index}"]["action_unit"] == "half_range"
    first = {topic: message for topic, message in reversed(read_all(recording))}
    for index in range(6):
        step = first[f"/agents/{index}"]
        assert len(names[f"/agents/{index}"]["observation"]) == len(step.observation)
    assert len(names["/step"]["state"]) == len(first["/step"].state)


def test_efforts_are_gear_times_action_and_terms_sum_to_the_reward(recording):
    gears = {"bthigh": 120, "bshin": 90, "bfoot": 60, "fthigh": 120, "fshin": 60, "ffoot": 30}
    with recording.open("rb") as file:
        channels = {channel.topic: channel.metadata for channel in make_reader(file).get_summary().channels.values()}
    joints = {topic: json.loads(metadata["action"]) for topic, metadata in channels.items() if "action" in metadata}
    assert json.loads(channels["/step"]["reward_terms"]) == ["forward_speed", "control"]
    expected, steps = {}, 0
    for topic, message in read_all(recording):
        if topic == "/joint_states":
            efforts = {joint.name: joint.effort for joint in message.joints if joint.name in gears}
        elif topic in joints:
            torques = [max(-1.0, min(1.0, action)) for action in message.action]
            expected |= {joint: gears[joint] * torque for joint, torque in zip(joints[topic], torques, strict=True)}
        elif topic == "/step":
            assert efforts == pytest.approx(expected, rel=1e-6)
            assert sum(message.reward_terms) == pytest.approx(message.reward, rel=1e-5, abs=1e-6)
            steps += 1
    assert steps >= 1000


def test_links_have_their_agents_colours_and_transforms_are_a_tree(messages):
    _, scene = messages["/scene"][0]
    colours = {}
    for entity in scene.entities:
        for shape in [*entity.spheres, *entity.cylinders]:
            colours.setdefault(entity.frame_id, set()).add((shape.color.r, shape.color.g, shape.color.b))
    driven = {link for link in colours if link not in ("world", "torso")}
    assert all(len(own) == 1 for own in colours.values())
    assert len(driven) == 6 and len(set.union(*(colours[link] for link in driven))) == 6
    _, update = messages["/tf"][0]
    parents = {frame.child_frame_id: frame.parent_frame_id for frame in update.transforms}
    assert parents["torso"] == "world" and parents["bfoot"] == "bshin" and parents["bshin"] == "bthigh"
    assert parents["bthigh"] == "torso"


def test_every_step_has_a_time_of_its_own_and_finite_joints(messages, tasks):
    task = tasks["halfcheetah-6x1"]
    states = messages["/joint_states"]
    assert len(states) >= task["episode_steps"]
    times = [time for time, _ in states]
    assert times == sorted(set(times))
    step_ns = round(task["dt_secs"] * 1e9)
    assert all(abs(later - time - step_ns) <= 1 for time, later in zip(times, times[1:]))
    joints = {joint for agent in task["agents"] for joint in agent["joints"]}
    for _, state in states:
        assert joints <= {joint.name for joint in state.joints}
        assert all(math.isfinite(joint.position) for joint in state.joints)


def test_frames_are_rotations_and_the_robot_moves(messages):
    for _, update in messages["/tf"]:
        for frame in update.transforms:
            turn = frame.rotation
            norm = math.sqrt(turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2)
            assert abs(norm - 1.0) < 1e-3
    first, last = messages["/tf"][0][1], messages["/tf"][-1][1]
    assert first.transforms != last.transforms


def test_the_scene_shows_shapes(messages):
    entities = [entity for _, update in messages["/scene"] for entity in update.entities]
    shapes = [len(e.cubes) + len(e.spheres) + len(e.cylinders) + len(e.models) + len(e.triangles) for e in entities]
    assert sum(shapes) > 0


def test_the_file_says_which_run_it_shows(recording, inspected):
    with recording.open("rb") as file:
        reader = make_reader(file)
        metadata = {key: value for record in reader.iter_metadata() for key, value in record.metadata.items()}
    assert metadata["task"] == "halfcheetah-6x1"
    assert metadata["seed"] == "7"
    assert metadata["iteration"] == str(inspected["iteration"])
