"""The .proto files follow Buf's rules, and no change breaks programs that were built from the last stable ones."""

import shutil
import subprocess
import sysconfig
from pathlib import Path

import pytest

from conftest import ROOT

BUF = Path(sysconfig.get_path("scripts")) / "buf"
PROTO = ROOT / "proto"
# What buf ends with when it has found something.
FOUND = 100


def buf(*arguments, folder=PROTO):
    """Exit status, and what was found."""
    done = subprocess.run([BUF, *map(str, arguments)], cwd=folder, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def breaking(folder=PROTO):
    return buf("breaking", "--against", PROTO / "stable.binpb", folder=folder)


@pytest.fixture
def changed(tmp_path):
    """Puts one text in place of another in a copy of the .proto files; the copy's folder."""
    folder = tmp_path / "proto"
    shutil.copytree(PROTO / "proto", folder / "proto")
    shutil.copy(PROTO / "buf.yaml", folder)

    def change(name: str, old: str, new: str) -> Path:
        path = folder / "proto" / "s2mia" / "v1" / name
        text = path.read_text()
        assert text.count(old) == 1, old
        path.write_text(text.replace(old, new))
        return folder

    return change


def test_the_files_follow_the_standard_rules():
    assert buf("lint") == (0, "")


def test_nothing_breaks_programs_built_from_the_stable_files():
    assert breaking() == (0, ""), "docs/PROTOCOL.md says what to do where a change must break them"


def test_a_field_that_is_renumbered_renamed_or_of_another_type_is_found(changed):
    for new in ("uint64 leases_reissued = 99;", "uint64 reissued = 10;", "string leases_reissued = 10;"):
        status, found = breaking(changed("control.proto", "uint64 leases_reissued = 10;", new))
        assert status == FOUND and "leases_reissued" in found, found
        changed("control.proto", new, "uint64 leases_reissued = 10;")


def test_a_call_that_is_new_breaks_nothing_and_one_that_is_gone_does(changed):
    call = "  rpc Heartbeat(HeartbeatRequest) returns (HeartbeatResponse);\n"
    new = call.replace("rpc Heartbeat", "rpc Pulse")
    assert breaking(changed("learner.proto", call, call + new)) == (0, "")
    status, found = breaking(changed("learner.proto", call, ""))
    assert status == FOUND and "Heartbeat" in found, found


def test_a_name_out_of_style_is_found(changed):
    status, found = buf("lint", folder=changed("control.proto", "message StopRequest {}", "message StopNow {}"))
    assert status == FOUND, found
