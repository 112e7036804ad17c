"""What a program does to a folder, recorded by strace, and the folders that a power loss can leave of it.

Only what was flushed is certain: the bytes of a file by fsync of the file, a name in a folder by fsync of the folder. `Disk` keeps both
what the running system sees and what is certain. Of the rest a disk may have any part; `KINDS` are the extremes.
"""

import dataclasses
import hashlib
import os
import pathlib
import re
import shutil
import subprocess

from debian import program

CALLS = (
    "?open,openat,?creat,write,pwrite64,writev,ftruncate,?truncate,fsync,fdatasync,?rename,renameat,?renameat2,?mkdir,mkdirat,"
    "?unlink,unlinkat,?rmdir,copy_file_range,sendfile,?link,linkat,?symlink,symlinkat"
)
# Paths and data are printed in hexadecimal, so that no quoting has to be undone; longer data would be cut off.
MOST_BYTES = 1 << 26
LINE = re.compile(r"(?P<start>\d+\.\d+) (?P<name>\w+)\((?P<arguments>.*)\) += (?P<result>-?\d+).* <(?P<secs>\d+\.\d+)>$")
# A folder or file by its descriptor, or a quoted string.
PLACE = re.compile(r'(?:AT_FDCWD|\d+)<(?P<path>(?:\\x[0-9a-f]{2})*)>|"(?P<text>(?:\\x[0-9a-f]{2})*)"')

# What a power loss may leave: (whether names that were not flushed are there, which bytes that were not flushed are).
KINDS = {
    "nothing that was not flushed": (False, "none"),
    "names, but no bytes": (True, "none"),
    "names, and half of the bytes": (True, "half"),
    "bytes, but no names": (False, "all"),
    "everything, as after kill -9": (True, "all"),
}


@dataclasses.dataclass
class File:
    """A file: its bytes, and those that the last flush made certain."""

    content: bytes = b""
    flushed: bytes = b""

    def left(self, share: str) -> bytes:
        if share == "none":
            return self.flushed
        if share == "all":
            return self.content
        grown = self.content.startswith(self.flushed)
        kept = len(self.flushed) if grown else 0
        return self.content[: kept + (len(self.content) - kept) // 2]


@dataclasses.dataclass
class Folder:
    """A folder: its names, and those that the last flush made certain."""

    names: dict = dataclasses.field(default_factory=dict)
    flushed: dict = dataclasses.field(default_factory=dict)


@dataclasses.dataclass
class Call:
    """One system call that succeeded."""

    end: float
    name: str
    arguments: str
    places: list


def strace() -> str:
    return shutil.which("strace") or str(program("strace", "usr/bin/strace"))


def record(command: list, folder: pathlib.Path) -> tuple[int, list[Call]]:
    """Runs a command to its end; returns its status and its calls, of all its processes and threads, in order."""
    folder.mkdir()
    own = [strace(), "-ff", "-ttt", "-T", "-y", "-xx", "-s", str(MOST_BYTES), "-e", f"trace={CALLS}", "-o", str(folder / "of")]
    ended = subprocess.run([*own, *command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    calls = [call for file in folder.iterdir() for call in map(parsed, file.open()) if call]
    return ended.returncode, sorted(calls, key=lambda call: call.end)


def parsed(line: str) -> Call | None:
    found = LINE.match(line)
    if not found or int(found["result"]) < 0:
        return None
    unquoted = lambda text: bytes.fromhex(text.replace("\\x", ""))
    places = [
        unquoted(one["path"]).decode() if one["text"] is None else unquoted(one["text"])
        for one in PLACE.finditer(found["arguments"])
    ]
    return Call(float(found["start"]) + float(found["secs"]), found["name"], found["arguments"], places)


class Disk:
    """The folder `root` and everything in it, as the calls of a record make it."""

    def __init__(self, root: pathlib.Path) -> None:
        self.root = str(root.resolve())
        self.top = Folder()

    def apply(self, call: Call) -> bool:
        """Whether the call was about this disk."""
        name, paths = call.name.rstrip("2"), list(self.paths(call))
        inside = [path for path in paths if path == self.root or path.startswith(self.root + "/")]
        if not inside:
            return False
        match name.removesuffix("at"):
            case "open" | "creat":
                return self.open(inside[0], call.arguments + ("O_CREAT|O_TRUNC" if name == "creat" else ""))
            case "write" | "pwrite64" | "writev":
                return self.write(inside[0], b"".join(place for place in call.places if isinstance(place, bytes)))
            case "ftruncate" | "truncate":
                return self.truncate(inside[0], int(call.arguments.rsplit(", ", 1)[1]))
            case "fsync" | "fdatasync":
                return self.flush(inside[0])
            case "mkdir":
                return self.put(inside[0], Folder())
            case "rename":
                return self.put(paths[-1], self.take(inside[0]))
            case "unlink" | "rmdir":
                return self.take(inside[0]) is not None
        raise SystemExit(f"strace recorded {call.name}, which the record does not know")

    def paths(self, call: Call):
        """The files and folders of a call: a quoted path is relative to the folder before it."""
        places = iter(call.places)
        if call.name in ("write", "pwrite64", "writev", "fsync", "fdatasync", "ftruncate"):
            yield next(places)
            return
        base = os.getcwd()
        for place in places:
            if isinstance(place, str):
                base = place
                if call.name in ("copy_file_range", "sendfile"):
                    yield base
            else:
                yield os.path.normpath(os.path.join(base, place.decode()))

    def at(self, path: str):
        """The file or folder at a path; none if there is none, as for a file that was deleted while it was open."""
        found = self.top
        for name in pathlib.PurePath(path).relative_to(self.root).parts:
            found = found.names.get(name) if isinstance(found, Folder) else None
        return found

    def put(self, path: str, what) -> bool:
        self.at(os.path.dirname(path)).names[os.path.basename(path)] = what
        return True

    def take(self, path: str):
        return self.at(os.path.dirname(path)).names.pop(os.path.basename(path))

    def open(self, path: str, arguments: str) -> bool:
        found = self.at(path)
        if found is None and "O_CREAT" in arguments:
            return self.put(path, File())
        if isinstance(found, File) and "O_TRUNC" in arguments:
            found.content = b""
            return True
        return False

    def write(self, path: str, more: bytes) -> bool:
        """All programs here append, or write a new file from its beginning; `agrees` would notice another."""
        if (found := self.at(path)) is None:
            return False
        found.content += more
        return True

    def truncate(self, path: str, length: int) -> bool:
        found = self.at(path)
        found.content = found.content[:length].ljust(length, b"\0")
        return True

    def flush(self, path: str) -> bool:
        found = self.at(path)
        if isinstance(found, Folder):
            found.flushed = dict(found.names)
        elif found:
            found.flushed = found.content
        return found is not None

    def left(self, kind: str) -> dict[str, bytes | None]:
        """What a power loss leaves: the bytes of each file by its path, none for a folder."""
        all_names, share = KINDS[kind]
        found: dict[str, bytes | None] = {}

        def add(folder: Folder, path: str) -> None:
            for name, what in (folder.names if all_names else folder.flushed).items():
                found[path + name] = None if isinstance(what, Folder) else what.left(share)
                if isinstance(what, Folder):
                    add(what, f"{path}{name}/")

        add(self.top, "")
        return found

    def agrees(self) -> bool:
        """Whether the record explains what is in the folder now, so that no call was missed."""
        root = pathlib.Path(self.root)
        there = {str(path.relative_to(root)): path.read_bytes() if path.is_file() else None for path in root.rglob("*")}
        return there == self.left("everything, as after kill -9")


def digest(left: dict[str, bytes | None]) -> str:
    whole = hashlib.sha256()
    for path, content in sorted(left.items()):
        whole.update(repr((path, None if content is None else hashlib.sha256(content).digest())).encode())
    return whole.hexdigest()


def build(left: dict[str, bytes | None], root: pathlib.Path) -> None:
    root.mkdir(parents=True)
    for path, content in sorted(left.items()):
        if content is None:
            (root / path).mkdir(parents=True)
        else:
            (root / path).write_bytes(content)
