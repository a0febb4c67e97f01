"""A disk that is replayed from a trace: what programs see on it, and what of that a power failure leaves."""

from __future__ import annotations

import os
import random
import re
from dataclasses import dataclass, field
from pathlib import Path

# What the replay does not know; a run that makes one of them on its own files is not judged.
UNKNOWN = {"writev", "truncate", "syncfs", "sync", "link", "linkat", "symlink", "symlinkat", "sendfile", "fallocate"}
TEXT = re.compile(r'"((?:\\x[0-9a-f]{2})*)"(\.\.\.)?')
PLACE = re.compile(r"(AT_FDCWD|\d+)(?:<([^>]*)>)?, \"")


@dataclass(eq=False)
class File:
    """A file: what was written, and what of it is on the disk."""

    content: bytearray = field(default_factory=bytearray)
    synchronised: bytes = b""

    def after(self, state: str, rng: random.Random) -> bytes:
        """What of it a power failure leaves."""
        if state != "ordered" or self.synchronised == self.content:
            return self.synchronised
        part = bytes(self.content[: rng.randint(0, len(self.content))])
        return rng.choice([self.synchronised, b"", part, bytes(len(self.content)), bytes(self.content)])


@dataclass(eq=False)
class Folder:
    """A folder: the names as programs see them, and those on the disk."""

    names: dict[str, File | Folder] = field(default_factory=dict)
    on_disk: dict[str, File | Folder] = field(default_factory=dict)


# A name in a folder, and what it stands for from then on.
Step = tuple[Folder, str, "File | Folder | None"]


@dataclass
class Disk:
    """A folder on a disk, as a traced run changes it."""

    root: str
    folder: Folder = field(default_factory=Folder)
    # Changes of names that are not on the disk, in their order; those of one change belong together.
    pending: list[list[Step]] = field(default_factory=list)
    opened: dict[int, File | Folder] = field(default_factory=dict)
    places: dict[int, int] = field(default_factory=dict)
    num_changes: int = 0

    @staticmethod
    def of(root: Path, there: Path) -> Disk:
        """A disk that holds a folder's content since long."""
        disk = Disk(str(root))
        for path in sorted(there.rglob("*")):
            above = disk.at(str(root / path.relative_to(there).parent))
            assert isinstance(above, Folder)
            content = b"" if path.is_dir() else path.read_bytes()
            node = Folder() if path.is_dir() else File(bytearray(content), content)
            above.names[path.name] = above.on_disk[path.name] = node
        return disk

    def at(self, path: str) -> File | Folder | None:
        """What lies at a path, as programs see it."""
        node: File | Folder | None = self.folder
        for name in [part for part in path.removeprefix(self.root).split("/") if part]:
            node = node.names.get(name) if isinstance(node, Folder) else None
        return node

    def parent(self, path: str) -> tuple[Folder, str]:
        """The folder of a path and the last name of it."""
        above = self.at(os.path.dirname(path))
        assert isinstance(above, Folder), path
        return above, os.path.basename(path)

    def change(self, *steps: Step) -> None:
        """Changes names, as programs see them."""
        for folder, name, node in steps:
            folder.names.pop(name, None) if node is None else folder.names.__setitem__(name, node)
        self.pending.append(list(steps))

    def commit(self, change: list[Step]) -> None:
        """Brings a change of names to the disk."""
        for folder, name, node in change:
            folder.on_disk.pop(name, None) if node is None else folder.on_disk.__setitem__(name, node)

    def synchronise(self, node: File | Folder) -> None:
        """Brings a file's content to the disk, or a folder's names with all that must come before them."""
        if isinstance(node, File):
            node.synchronised = bytes(node.content)
            return
        touched, kept, committed = {node}, [], []
        for change in reversed(self.pending):
            folders = {folder for folder, _, _ in change}
            together = bool(folders & touched)
            touched |= folders if together else set()
            (committed if together else kept).append(change)
        for change in reversed(committed):
            self.commit(change)
        self.pending = kept[::-1]

    def see(self, call: Call) -> None:
        """Takes a call that succeeded."""
        handler = getattr(self, f"_{call.kind}", None)
        if handler is None or not self._is_here(call):
            return
        assert call.name not in UNKNOWN, f"{call.name} is not replayed"
        handler(call)
        self.num_changes += call.kind != "open"

    def _is_here(self, call: Call) -> bool:
        paths = call.paths or [call.place]
        return any(path == self.root or path.startswith(self.root + "/") for path in paths)

    def _open(self, call: Call) -> None:
        node = self.at(call.paths[0])
        if node is None:
            node = File()
            self.change((*self.parent(call.paths[0]), node))
        elif isinstance(node, File) and "O_TRUNC" in call.arguments:
            node.content.clear()
        self.opened[call.result], self.places[call.result] = node, 0

    def _write(self, call: Call) -> None:
        node, data = self.opened[call.descriptor], call.data[: call.result]
        at = call.offset if call.name == "pwrite64" else self.places[call.descriptor]
        assert isinstance(node, File) and len(data) == call.result, call.name
        node.content.extend(bytes(max(at - len(node.content), 0)))
        node.content[at : at + len(data)] = data
        if call.name != "pwrite64":
            self.places[call.descriptor] = at + len(data)

    def _ftruncate(self, call: Call) -> None:
        node, length = self.opened[call.descriptor], call.offset
        assert isinstance(node, File)
        node.content[:] = bytes(node.content[:length]) + bytes(max(length - len(node.content), 0))

    def _sync(self, call: Call) -> None:
        self.synchronise(self.opened[call.descriptor])

    def _mkdir(self, call: Call) -> None:
        # The folder itself: its name lies beside it, where nothing else is looked at.
        if call.paths[0] != self.root:
            self.change((*self.parent(call.paths[0]), Folder()))

    def _unlink(self, call: Call) -> None:
        self.change((*self.parent(call.paths[0]), None))

    def _rename(self, call: Call) -> None:
        source, target = call.paths
        assert source.startswith(self.root) and target.startswith(self.root), "moved over the border"
        self.change((*self.parent(source), None), (*self.parent(target), self.at(source)))

    def differences(self, there: Path) -> list[str]:
        """What of a folder is not as programs see it here."""
        found = {str(path): None if path.is_dir() else path.read_bytes() for path in there.rglob("*")}
        return sorted(path for path, content in found.items() if not _is(self.at(path), content))

    def fail(self, state: str, rng: random.Random, into: Path) -> None:
        """Makes the folder that is found after a power failure. The disk is of no further use."""
        num_kept = {"strict": 0, "names": len(self.pending)}.get(state, rng.randint(0, len(self.pending)))
        for change in self.pending[:num_kept]:
            self.commit(change)
        _write(self.folder, state, rng, into)


def _is(node: File | Folder | None, content: bytes | None) -> bool:
    return isinstance(node, Folder) if content is None else isinstance(node, File) and node.content == content


def _write(folder: Folder, state: str, rng: random.Random, into: Path) -> None:
    into.mkdir()
    for name, node in sorted(folder.on_disk.items()):
        if isinstance(node, Folder):
            _write(node, state, rng, into / name)
        else:
            (into / name).write_bytes(node.after(state, rng))


KINDS = {"fsync": "sync", "fdatasync": "sync", "pwrite64": "write", "creat": "open", "rmdir": "unlink"}


@dataclass
class Call:
    """A call of the system in strace's words, strings in hexadecimal digits."""

    name: str
    arguments: str
    result: int

    @property
    def kind(self) -> str:
        """The name without what tells variants apart."""
        return KINDS.get(self.name, re.sub(r"at2?$", "", self.name))

    @property
    def paths(self) -> list[str]:
        """The paths that it names, whole."""
        if self.kind in ("write", "sync", "ftruncate"):
            return []
        texts = [text.decode("utf-8", "surrogateescape") for text in self.texts]
        places = [place for _, place in PLACE.findall(self.arguments)]
        if len(places) < len(texts):
            return texts
        return [os.path.join(_text(place), text) for place, text in zip(places, texts, strict=False)]

    @property
    def texts(self) -> list[bytes]:
        """All strings."""
        found = TEXT.findall(self.arguments)
        assert not any(cut for _, cut in found), "the trace is cut"
        return [bytes.fromhex(text.replace("\\x", "")) for text, _ in found]

    @property
    def data(self) -> bytes:
        """What is written."""
        return self.texts[0]

    @property
    def descriptor(self) -> int:
        """The first argument."""
        return int(re.match(r"\d+", self.arguments).group()) if self.arguments[:1].isdigit() else -1

    @property
    def place(self) -> str:
        """Where the file of the first argument lies."""
        found = re.match(r"\d+<([^>]*)>", self.arguments)
        return _text(found.group(1)) if found else ""

    @property
    def offset(self) -> int:
        """The last argument."""
        return int(self.arguments.rsplit(",", 1)[1])


def _text(place: str) -> str:
    return bytes.fromhex(place.replace("\\x", "")).decode() if place.startswith("\\x") else place
