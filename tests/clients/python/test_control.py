"""A learner is watched by a program that knows the .proto files alone."""

import subprocess

import grpc
import pytest
from conftest import FEW, SMALL, command
from google.protobuf.descriptor_pool import Default, DescriptorPool
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase
from s2mia import wire


@pytest.fixture
def channel():
    """Opens channels that are closed again."""
    opened = []

    def open_to(address: str):
        opened.append(grpc.insecure_channel(address))
        return opened[-1]

    yield open_to
    for one in opened:
        one.close()


def test_a_watcher_is_told_of_each_iteration_it_has_not_seen_and_of_the_end(serve, channel):
    learner = serve("watched", [*FEW, "evaluation.every_steps=1", "evaluation.episodes=2"])
    control = wire.ControlServiceStub(channel(learner.address))
    streams = [control.WatchRun(wire.WatchRunRequest(after_iteration=after)) for after in (0, 1)]
    # Both are being served when the answers to later calls have come.
    for stream in streams:
        assert stream.initial_metadata() is not None
    subprocess.run(command("actor", "--learner", learner.url), check=True, capture_output=True)
    everything, news = (list(stream) for stream in streams)
    assert [line.iteration for line in everything] == [1, 2, 2]
    assert [line.end for line in everything] == [0, 0, wire.RUN_END_FINISHED]
    assert everything[1:] == news
    assert [line.env_steps for line in everything[:2]] == [everything[0].env_steps * k for k in (1, 2)]
    last = everything[-1]
    assert (last.run_id, last.evaluation.iteration, last.evaluation.episodes) == ("watched", 2, 2)
    learner.finish()


def test_reflection_describes_what_is_served_as_the_files_do(serve, channel, policies):
    learner = serve("reflected", SMALL)
    for address, services in {
        learner.address: {"s2mia.v1.ControlService", "s2mia.v1.LearnerService"},
        policies.address: {"s2mia.v1.PolicyService"},
    }.items():
        database = ProtoReflectionDescriptorDatabase(channel(address))
        assert set(database.get_services()) == services | {"grpc.health.v1.Health"}
        told, files = DescriptorPool(database), Default()
        for name in services:
            methods = [method.name for method in told.FindServiceByName(name).methods]
            assert methods == [method.name for method in files.FindServiceByName(name).methods]
