"""A learner is paused, saved, watched and stopped by a program that knows the .proto files alone."""

import pathlib
import subprocess
import threading

import grpc
import pytest
from conftest import FEW, SMALL, command, hashes
from google.protobuf.descriptor_pool import Default, DescriptorPool
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase
from s2mia import Learner, wire

CALL = {"timeout": 20}


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


def leased(client: Learner, wait_millis: int = 0) -> str:
    """What the answer to a request for work is."""
    request = wire.LeaseSlotsRequest(
        actor_id=client.actor_id, incarnation=client.incarnation, wait_millis=wait_millis
    )
    return client.service.LeaseSlots(request, timeout=40).WhichOneof("answer")


def test_a_paused_learner_leases_nothing_keeps_what_is_leased_and_goes_on(serve, channel):
    learner = serve("paused", SMALL)
    control = wire.ControlServiceStub(channel(learner.address))
    client = Learner(learner.address)
    lease = client.lease()
    assert control.Pause(wire.PauseRequest(), **CALL).open_leases == 1
    assert leased(client) == "retry"
    status = control.GetStatus(wire.GetStatusRequest(), **CALL)
    assert (status.paused, len(status.leases)) == (True, 1)
    assert client.heartbeat(lease, 1), "what is leased may be finished"
    # Whoever waits for work gets it in the moment of the resumption.
    answers = []
    waiting = threading.Thread(target=lambda: answers.append(leased(client, wait_millis=30_000)))
    waiting.start()
    control.Resume(wire.ResumeRequest(), **CALL)
    waiting.join()
    assert answers == ["lease"]
    assert not control.GetStatus(wire.GetStatusRequest(), **CALL).paused
    client.close()


def test_a_checkpoint_is_on_disk_when_the_answer_comes_and_a_stop_leaves_another(serve, channel):
    learner = serve("saved", SMALL)
    control = wire.ControlServiceStub(channel(learner.address))
    saved = control.SaveCheckpoint(wire.SaveCheckpointRequest(), **CALL)
    path = pathlib.Path(saved.path)
    assert (saved.iteration, path.name) == (0, "iter_00000000")
    assert (path / "manifest.json").is_file()
    before = hashes(learner.folder)
    control.Stop(wire.StopRequest(), **CALL)
    assert "stopped after iteration 0" in learner.finish()
    assert hashes(learner.folder) == before


def test_a_checkpoint_that_cannot_be_written_is_told_and_the_run_goes_on(serve, channel):
    learner = serve("full", [*SMALL, "--die-at=disk-rename@0"])
    control = wire.ControlServiceStub(channel(learner.address))
    with pytest.raises(grpc.RpcError) as raised:
        control.SaveCheckpoint(wire.SaveCheckpointRequest(), **CALL)
    assert raised.value.code() == grpc.StatusCode.FAILED_PRECONDITION
    assert "iter_00000000" in raised.value.details()
    client = Learner(learner.address)
    assert leased(client) == "lease"
    client.close()


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
