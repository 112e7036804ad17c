"""A trajectory log opens in the reference reader, and its numbers are those that the run tells elsewhere."""

import hashlib
import json
import math

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from conftest import ITERATIONS, ROOT, STEPS_PER_ITERATION, TINY, examples, s2mia

AGENTS = 6


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """Folder of a run, with noise that agents share, that logged every episode."""
    folder = tmp_path_factory.mktemp("runs") / "logged"
    noise = ["policy.noise=shared", "policy.noise_hold=4"]
    s2mia("train", *TINY, *noise, f"run.dir={folder}", "log.episodes=all")
    return folder


@pytest.fixture(scope="module")
def logs(logged):
    """The run's trajectory logs."""
    return sorted((logged / "logs").glob("trajectories-*.mcap"))


@pytest.fixture(scope="module")
def shares(logs):
    """Each share as (head, steps, end); a step is (agents' messages, the step's message)."""
    found, agents = [], []
    for log in logs:
        with log.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
            for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
                if channel.topic == "/share":
                    found.append([message, [], None])
                elif channel.topic.startswith("/agents/"):
                    agents.append(message)
                elif channel.topic == "/step":
                    found[-1][1].append((agents, message))
                    agents = []
                elif channel.topic == "/share_end":
                    found[-1][2] = message
    found.sort(key=lambda share: (share[0].kind, share[0].episode_id, share[0].first_step))
    return found


def test_every_topic_has_its_schema_in_the_file(logs):
    with logs[0].open("rb") as file:
        summary = make_reader(file).get_summary()
    named = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
    expected = {f"/agents/{agent}": "s2mia.log.v1.AgentStep" for agent in range(AGENTS)}
    expected |= {"/share": "s2mia.log.v1.Share", "/step": "s2mia.log.v1.Step"}
    expected |= {"/share_end": "s2mia.log.v1.ShareEnd", "/tf": "foxglove.FrameTransforms"}
    expected |= {"/joint_states": "foxglove.JointStates", "/scene": "foxglove.SceneUpdate"}
    assert {topic: schema.name for topic, schema in named.items()} == expected
    assert all(schema.encoding == "protobuf" and schema.data for schema in named.values())


def test_every_step_has_numbers_of_the_task_s_shapes(shares, tasks):
    task = tasks["halfcheetah-6x1"]
    sizes = [len(agent["joints"]) for agent in task["agents"]]
    for head, steps, end in shares:
        assert [step.step for _, step in steps] == list(range(head.first_step, head.first_step + end.steps))
        for agents, step in steps:
            assert [len(agent.action) for agent in agents] == sizes
            assert len({len(agent.observation) for agent in agents}) == 1
            assert len(step.state) == len(end.state) == 17
            assert math.isfinite(step.reward) and all(map(math.isfinite, step.state))
            assert all(agent.HasField("log_prob") == (head.kind == 1) for agent in agents)


def test_training_is_logged_step_by_step(shares):
    rollouts = [(head, steps) for head, steps, _ in shares if head.kind == 1]
    assert sum(len(steps) for _, steps in rollouts) == ITERATIONS * STEPS_PER_ITERATION
    assert {head.weights_version for head, _ in rollouts} == set(range(ITERATIONS))
    assert all(head.attempt == 0 and head.seed == 7 for head, _ in rollouts)


def test_a_step_has_the_signal_of_all_agents_which_stays_for_its_hold(shares):
    for head, steps, _ in shares:
        signals = [tuple(step.signal) for _, step in steps]
        # Mean actions have no noise.
        held = [signal for signal in signals[::4] for _ in range(4)] if head.kind == 1 else [()] * len(steps)
        assert signals == held
        assert head.kind == 2 or ({len(signal) for signal in held}, len(set(held))) == ({1}, 5)


def test_shares_of_an_episode_follow_one_another(shares):
    ends = {}
    for head, _, end in shares:
        if head.episode_id in ends:
            step, state = ends[head.episode_id]
            assert (head.first_step, head.environment_state) == (step, state)
        ends[head.episode_id] = (head.first_step + end.steps, end.environment_state)
    assert len(ends) == 4 + 3


def test_returns_of_evaluations_are_those_of_the_metrics(logged, shares):
    lines = [json.loads(line) for line in (logged / "metrics.jsonl").read_text().splitlines()]
    told = {line["env_steps"]: line["mean"] for line in lines if line["kind"] == "evaluation"}
    found = {
        head.iteration * STEPS_PER_ITERATION: sum(step.reward for _, step in steps)
        for head, steps, _ in shares
        if head.kind == 2
    }
    assert found == pytest.approx(told, rel=1e-9)


def test_weights_are_named_by_the_digest_of_their_snapshot(logged, shares):
    newest = logged / "checkpoints" / (logged / "checkpoints" / "LATEST").read_text().strip()
    digest = hashlib.sha256((newest / "policy.safetensors").read_bytes()).digest()
    last = [head for head, _, _ in shares if head.weights_version == ITERATIONS]
    assert last and all(head.weights_sha256 == digest for head in last)


def test_the_file_carries_the_run_s_settings(logged, logs):
    with logs[0].open("rb") as file:
        reader = make_reader(file)
        attachments = {record.name: record.data for record in reader.iter_attachments()}
        words = {record.name: record.metadata for record in reader.iter_metadata()}
    assert attachments["config.toml"].decode() == (logged / "config.toml").read_text()
    assert json.loads(attachments["task.json"])["task"] == words["s2mia.log"]["task"] == "halfcheetah-6x1"
    assert words["s2mia.log.totals"]["lost_shares"] == "0"


def test_the_ten_lines_of_the_documentation_print_a_return_per_share(logged, shares, capsys):
    (block,) = examples("Trajectory logs")
    exec(block.replace('"RUN/logs"', repr(str(logged / "logs"))), {})
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == len(shares)
    assert any(line.startswith("rollout-0-0 from step 0: ") for line in printed)


def test_the_foxglove_layout_shows_topics_that_are_there(logs, recording):
    layout = json.loads((ROOT / "deploy" / "foxglove" / "s2mia.json").read_text())
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    paths += [panel["xAxisPath"]["value"] for panel in panels.values() if "xAxisPath" in panel]
    paths += [panel["topicPath"] for panel in panels.values() if "topicPath" in panel]
    topics = set()
    for name in [logs[0], recording]:
        with name.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            topics |= {channel.topic for channel in reader.get_summary().channels.values()}
            links = {frame.child_frame_id for frame in next(reader.iter_decoded_messages(["/tf"]))[3].transforms}
        assert panels["3D!robot"]["followTf"] in links
    assert paths and {path.split(".")[0] for path in paths} <= topics
    assert set(panels["3D!robot"]["topics"]) <= topics
