"""A recording opens in the reference reader, and holds what a robot player needs."""

import math

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

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
