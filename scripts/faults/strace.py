"""System calls of a traced run, and two questions to every trace: changes outside the output folder, and sockets."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from common import Bench, Outcome, run

# Classes of calls that the questions need: those that name a file, and those of sockets.
QUESTIONS = "%file,%network"
# Calls that change what they name. `open` and `openat` do so with one of the flags.
CHANGES = re.compile(
    r"^(creat|truncate|mknod|mkdir|rmdir|unlink|rename|link|symlink|chmod|fchmod|l?chown|fchown|utime)"
)
OPENS = {"open", "openat", "openat2"}
WRITES = re.compile(r"O_WRONLY|O_RDWR|O_CREAT|O_TRUNC")
# `socketpair` is none of them: it has no address, and the handler of signals wakes a thread of its own process by it.
SOCKETS = {"socket", "connect", "bind", "listen", "accept", "accept4"}
# Children have it in the place of a terminal.
NOWHERE = "/dev/null"
CALL = re.compile(r"^(\w+)\((.*)\)\s+= (-?\d+)(?:<([^>]*)>)?")
# A path with the folder in which it begins, where strace names one.
PATH = re.compile(r'(?:<([^>]*)>, )?"((?:[^"\\]|\\.)*)"')


def traced(
    bench: Bench, command: list[str | Path], *, calls: str = "", options: Sequence[str] = (), **how: object
) -> tuple[Outcome, list[str]]:
    """Runs the program under strace. Gives how it ended, and all calls of the questions and of `calls`.

    Libraries that report their use are silent on machines that build software, and where they are told to be: the
    variables that say so are removed.
    """
    log = bench.path("calls.txt")
    quiet = dict.fromkeys(["CI", "GITHUB_ACTIONS", "ORT_DISABLE_TELEMETRY"])
    how["environment"] = {**quiet, **how.get("environment", {})}  # type: ignore[dict-item]
    trace = ",".join(filter(None, [QUESTIONS, calls]))
    flags = ["-f", "-qq", "-y", "-e", "signal=none", "-e", f"trace={trace}", "-o", log, *options]
    # Calls that are not traced go at full speed, but signals cannot be injected then.
    flags += [] if any("inject" in option for option in options) else ["--seccomp-bpf"]
    flags += [] if "-s" in options else ["-s", "4096"]
    outcome = run(["strace", *flags, bench.program, *command], **how)  # type: ignore[arg-type]
    return outcome, whole_lines(log.read_text("utf-8", "replace"))


def whole_lines(text: str) -> list[str]:
    """The calls of all threads, those that strace had to break put together again at their ends."""
    begun: dict[str, str] = {}
    whole = []
    for line in text.splitlines():
        thread, _, call = line.partition(" ")
        call = call.strip()
        if call.endswith("<unfinished ...>"):
            begun[thread] = call.removesuffix("<unfinished ...>")
        elif call.startswith("<..."):
            whole.append(begun.pop(thread, "") + call.partition("resumed>")[2])
        else:
            whole.append(call)
    return whole + list(begun.values())


def changed_outside(lines: Iterable[str], *inside: Path) -> list[str]:
    """The calls that change, or try to change, something outside some folders."""
    roots = [os.path.realpath(path) for path in inside]
    return [line for line in lines if any(not _is_in(path, roots) for path in changed(line))]


def changed(line: str) -> list[str]:
    """The paths that a call changes or tries to change."""
    name, found = line.partition("(")[0], CALL.match(line)
    if not (CHANGES.match(name) or (name in OPENS and WRITES.search(line))):
        return []
    paths = [os.path.join(_plain(folder), _plain(path)) for folder, path in PATH.findall(line)]
    # Where an opened path leads through links.
    return paths + [_plain(found.group(4))] if found and found.group(4) and name in OPENS else paths


def opened(lines: Iterable[str]) -> list[str]:
    """The paths of all files that were opened, through all links."""
    found = [CALL.match(line) for line in lines]
    return [_plain(match.group(4)) for match in found if match and match.group(1) in OPENS and match.group(4)]


def sockets(lines: Iterable[str]) -> list[str]:
    """The calls that ask for a socket, or do something with one that leads anywhere."""
    return [line for line in lines if line.partition("(")[0] in SOCKETS]


def problem(lines: list[str], *inside: Path) -> str | None:
    """What is wrong with a trace, whatever else it was made for."""
    for what, found in (("changes outside", changed_outside(lines, *inside)), ("a socket", sockets(lines))):
        if found:
            return f"{len(found)} calls, {what}: {found[0][:200]}"
    return None


def _is_in(path: str, roots: list[str]) -> bool:
    path = os.path.normpath(path)
    return path == NOWHERE or any(path == root or path.startswith(root + "/") for root in roots)


def _plain(text: str) -> str:
    """A path without strace's escapes: octal or hexadecimal numbers of bytes."""
    return text.encode().decode("unicode_escape").encode("latin-1").decode("utf-8", "surrogateescape")
