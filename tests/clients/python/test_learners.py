"""Learners of other projects train on the simulator, through the examples of the package."""

import re

from test_package import CLIENTS, python


def test_cma_es_finds_a_policy_that_moves_a_whole_robot_forwards(tmp_path):
    script = CLIENTS / "examples" / "cma_es.py"
    told = python(script, "halfcheetah", "--generations", "5", "--steps", "100", cwd=tmp_path)
    start, end = (float(value) for value in re.findall(r"(?:start|end): (-?[\d.]+)", told))
    assert end > start + 50
    assert len(re.findall(r"generation \d+: ", told)) == 5
