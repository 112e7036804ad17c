"""Settings as keywords."""

import pathlib

import numpy as np
import pytest
from s2mia.settings import arguments


@pytest.mark.parametrize(
    ("name", "value", "argument"),
    [
        ("run__seed", 1, "run.seed=1"),
        ("update__learning_rate", 1e-5, "update.learning_rate=1e-05"),
        ("algorithm", "happo", 'algorithm="happo"'),
        ("run__dir", pathlib.Path('a/Fuß "1"'), 'run.dir="a/Fuß \\"1\\""'),
        ("evaluation__sampled", True, "evaluation.sampled=true"),
        ("run__seed", np.uint32(7), "run.seed=7"),
        ("surprise__alpha", np.float64(0.1), "surprise.alpha=0.1"),
        ("evaluation__sampled", np.bool_(False), "evaluation.sampled=false"),
    ],
)
def test_a_keyword_with_two_underscores_is_a_setting_of_the_program(name, value, argument):
    assert arguments("ant-4x2", {name: value}) == ["task=ant-4x2", argument]


@pytest.mark.parametrize("value", [None, [1], {"seed": 1}, np.zeros(2), 1j])
def test_a_value_that_no_setting_has_is_refused_with_its_name(value):
    with pytest.raises(ValueError, match="^run.seed "):
        arguments(pathlib.Path("robot.toml"), {"run__seed": value})
