"""Names and texts that reach a terminal."""

import re
import types

import pytest
from conftest import ROOT
from s2mia import name, wire
from s2mia_environment.streams import EnvironmentFailed, Streams


def test_the_rules_are_those_of_the_program():
    source = (ROOT / "proto/src/name.rs").read_text()
    table = re.findall(r"\('\\u\{(\w+)\}', '\\u\{(\w+)\}'\)", source)
    assert [(int(first, 16), int(last, 16)) for first, last in table] == list(name.INVISIBLE)
    assert f"LONGEST: usize = {name.LONGEST};" in source


@pytest.mark.parametrize("text", ["a", "front thigh", "host-7/2", "Fuß", "关节", "x" * 128])
def test_a_visible_line_is_a_name(text):
    name.check(text, "it")


@pytest.mark.parametrize("text", ["", " a", "a ", "x" * 129, "a\nb", "\x1b[2J", "a\u2028b", "a\u202eb", "\u200b", "\xa0"])
def test_any_other_text_is_no_name(text):
    with pytest.raises(ValueError, match="^it (is|has|begins)"):
        name.check(text, "it")


def test_a_text_becomes_one_line_without_invisible_characters():
    assert name.printable(" a \r\n\u2028 b\tc\xa0 ") == "a b c"
    assert name.printable("\x1b[2Ja\u202eb") == "<U+001B>[2Ja<U+202E>b"


@pytest.mark.parametrize("hostile", ["", "a\u202eb", "a\nb"])
@pytest.mark.parametrize("field", ["task", "agent", "joint", "observation", "state"])
def test_an_environment_with_a_name_that_cannot_be_shown_is_not_offered(field, hostile):
    named = {"task": "t", "agent": "a", "joint": "j", "observation": "o", "state": "s"} | {field: hostile}
    agent = wire.AgentSpec(
        name=named["agent"], joints=[named["joint"]], observation=[wire.FeatureSpec(name=named["observation"])]
    )
    spec = wire.EnvironmentSpec(task=named["task"], agents=[agent], state=[wire.FeatureSpec(name=named["state"])])
    with pytest.raises(EnvironmentFailed, match="name"):
        Streams(lambda: types.SimpleNamespace(spec=spec))
