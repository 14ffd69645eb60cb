"""Errors that say which field, which value, which bound, and how to mend it."""

from __future__ import annotations


class LivlabError(Exception):
    """Base of every error livlab raises on purpose; the command line prints it without a traceback.

    Parameters
    ----------
    message
        What is wrong, in one sentence.
    remedy
        What the user can do about it.
    """

    exit_code = 2

    def __init__(self, message: str, *, remedy: str = "") -> None:
        self.message = message
        self.remedy = remedy
        super().__init__(f"{message} {remedy}".strip())


def briefly(value: object) -> str:
    """How a message shows a value: as Python writes it, at most 80 characters.

    >>> briefly("a" * 100)[-5:]
    'aa...'
    """
    try:
        shown = repr(value)
    except (ValueError, RecursionError):  # a whole number of thousands of digits; tables without an end
        shown = f"a huge {type(value).__name__}"
    return shown if len(shown) <= 80 else shown[:77] + "..."


class InputError(LivlabError, ValueError):
    """A value outside its bounds.

    >>> raise InputError.of("tissue.layers[0].thickness_mm", -1, "must be > 0", "Give a positive length.")
    Traceback (most recent call last):
        ...
    livlab.errors.InputError: tissue.layers[0].thickness_mm = -1: must be > 0. Give a positive length.
    """

    @classmethod
    def of(cls, field: str, value: object, bound: str, remedy: str) -> InputError:
        """Name the field, the value, the bound and the remedy."""
        return cls(f"{field} = {briefly(value)}: {bound}.", remedy=remedy)


class ConfigError(InputError):
    """An experiment file that does not fit the schema."""


class DatasetError(InputError):
    """A dataset that is missing, damaged, or asked outside its range."""


class RangeError(DatasetError):
    """A wavelength outside the range a table covers."""


class EnvironmentProblem(LivlabError):
    """The machine lacks something livlab needs (a usable libLLVM, disk space, permission)."""

    exit_code = 3


class Interrupted(LivlabError):
    """The user stopped the run; what was done is kept and a second call resumes it."""

    exit_code = 130
