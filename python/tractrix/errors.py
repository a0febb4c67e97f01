"""Exceptions of the package. All are `OutputError`, with a message `subject: problem; remedy`."""

from __future__ import annotations


class OutputError(Exception):
    """Base of all exceptions of the package.

    Attributes:
        subject: file, folder or vehicle at fault.
        problem: what is wrong with it.
        remedy: action that cures it.
    """

    def __init__(self, subject: object, problem: str, remedy: str) -> None:
        super().__init__(str(subject), problem, remedy)
        self.subject = str(subject)
        self.problem = problem
        self.remedy = remedy

    def __str__(self) -> str:
        return f"{self.subject}: {self.problem}; {self.remedy}"


class MissingError(OutputError):
    """A file, a vehicle, a frame or a quantity that the result does not have, or an optional package."""


class VersionError(OutputError):
    """A file of a version that this package does not read."""


class DamagedError(OutputError):
    """A file whose content contradicts its format."""
