"""An actor that shares no line with the project's own trains a policy through the same wire."""

import json
import subprocess

import numpy as np
from conftest import FEW, MANY, SMALL, command, refusal
from s2mia import Learner, act_for, wire
from s2mia.cue import Cue

# Both agents guess: one step of nine is paid, of fifty.
GUESSING = 50 / 9


def evaluations(metrics: list[dict]) -> list[float]:
    return [line["mean"] for line in metrics if line["kind"] == "evaluation"]


def iterations(metrics: list[dict]) -> list[dict]:
    return [line for line in metrics if line["kind"] == "iteration"]


def test_agents_learn_to_follow_the_cue_from_what_a_python_actor_plays(serve):
    learner = serve("python", MANY)
    client = Learner(learner.address)
    done = act_for(client, Cue, np.random.default_rng(1))
    client.close()
    assert "finished after iteration 30" in learner.finish()
    metrics = learner.metrics()
    assert evaluations(metrics)[0] < 3 * GUESSING
    assert evaluations(metrics)[-1] > 45.0, "of 50"
    assert done >= 30 * 2, "two slots an iteration, and evaluations"
    assert iterations(metrics)[-1]["messages_refused"] == 0
    manifest = json.loads((learner.folder / "manifest.json").read_text())
    assert manifest["foreign_actors"] is True, "such a run is not exactly repeatable, and says so"


def test_python_and_the_projects_own_actors_take_over_each_others_games(serve):
    learner = serve("both", [*SMALL, "run.iterations=20", "evaluation.every_steps=0", "environments.steps=30",
                             "environments.message_steps=30"])
    with subprocess.Popen(command("actor", "--learner", learner.url), stderr=subprocess.DEVNULL) as own:
        client = Learner(learner.address)
        done = act_for(client, Cue, np.random.default_rng(2))
        client.close()
        assert own.wait(timeout=60) == 0
    assert "finished after iteration 20" in learner.finish()
    assert 0 < done
    assert iterations(learner.metrics())[-1]["messages_refused"] == 0


def test_an_actor_returns_leases_whose_states_it_cannot_restore_and_their_episodes_begin_again(serve):
    class Forgetful(Cue):
        def restore(self, state: bytes) -> int:
            raise ValueError("no state of this game")

    learner = serve("forgetful", [*SMALL, "run.iterations=3", "evaluation.every_steps=0", "environments.steps=30",
                                  "environments.message_steps=30"])
    client = Learner(learner.address)
    assert act_for(client, Forgetful, np.random.default_rng(3)) > 0
    client.close()
    assert "finished after iteration 3" in learner.finish()
    assert iterations(learner.metrics())[-1]["messages_refused"] == 0


def test_the_learner_tells_a_python_program_where_the_run_stands(serve):
    learner = serve("status", [*SMALL, "environments.per_slot=10"])
    client = Learner(learner.address)
    stub = wire.ControlServiceStub(client.channel)
    lease = client.lease()
    status = stub.GetStatus(wire.GetStatusRequest(), timeout=10)
    assert (status.iteration, status.actors, status.slots) == (0, 1, 2)
    assert [one.lease_id for one in status.leases] == [lease.lease_id]
    assert client.heartbeat(lease, 0)
    client.close()


def test_an_actor_that_cannot_be_audited_gets_no_work_where_everything_is(serve):
    learner = serve("audited", [*FEW, "audit.share=1"])
    client = Learner(learner.address)
    request = wire.LeaseSlotsRequest(actor_id=client.actor_id, incarnation=client.incarnation)
    assert refusal(lambda: client.service.LeaseSlots(request, timeout=10)) == ("MISSING_FIELD", "rollout_fingerprint")
    with subprocess.Popen(command("actor", "--learner", learner.url), stderr=subprocess.DEVNULL) as own:
        assert own.wait(timeout=60) == 0
    client.close()
    learner.finish()
    manifest = json.loads((learner.folder / "manifest.json").read_text())
    assert manifest["foreign_actors"] is False, "it has registered only"
