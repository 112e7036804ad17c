"""Which agent controls which joints of a robot of multi-agent MuJoCo."""

import re

from gymnasium_robotics import mamujoco_v1

from s2mia_environment.environment import InvalidEnvironment

# Robots of the published tasks. Other robots have only the partitions of gymnasium-robotics.
ROBOTS = ("HalfCheetah", "Walker2d", "Ant")

# Opposite legs, as MaMuJoCo first defined them. The `2x4d` of gymnasium-robotics has the legs 1 and 4, and 2 and 3, which
# are neighbours, and are the agents of `2x4` below.
OPPOSITE = {("Ant", "2x4d"): (("hip1", "ankle1", "hip3", "ankle3"), ("hip2", "ankle2", "hip4", "ankle4"))}


def factorization(scenario: str, agent_conf: str | None) -> dict | None:
    """The `agent_factorization` of a published task; `None` if gymnasium-robotics defines the partition.

    In `AxJ` with all joints of the robot, each of A agents controls the next J joints in the order of the model's
    actuators: thigh, leg, foot. The published results have these partitions, because their code concatenates the
    agents' actions, whatever the names of the joints. gymnasium-robotics has no HalfCheetah 3x2, Walker2d 3x2 and 6x1
    and Ant 8x1, and in its Walker2d 2x3 an agent's action begins with the foot. In Ant 2x4d, an agent controls opposite
    legs.
    """
    if named := OPPOSITE.get((scenario, agent_conf)):
        (joints,), edges, of_root = mamujoco_v1.get_parts_and_edges(scenario, None)
        by_label = {joint.label: joint for joint in joints}
        parts = [tuple(by_label[label] for label in labels) for labels in named]
        return {"partition": parts, "edges": edges, "globals": of_root}
    sizes = re.fullmatch(r"(\d+)x(\d+)", agent_conf or "")
    if scenario not in ROBOTS or sizes is None:
        return None
    (joints,), edges, of_root = mamujoco_v1.get_parts_and_edges(scenario, None)
    agents, each = map(int, sizes.groups())
    if agents * each != len(joints):
        raise InvalidEnvironment(f"{scenario} has {len(joints)} joints; agent_conf={agent_conf} has {agents} x {each}")
    joints = sorted(joints, key=lambda joint: joint.act_ids)
    parts = [tuple(joints[first : first + each]) for first in range(0, len(joints), each)]
    return {"partition": parts, "edges": edges, "globals": of_root}
