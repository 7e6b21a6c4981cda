"""Exit statuses that are not 0, and how a line reaches the person: whole, on one line, and never in the way."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import sys

import click

STATUS_BAD_INPUT = 2
STATUS_INTERRUPTED = 130
STOPPED = "nacre: stopped; what was finished is kept"
LONGEST_WORD = 200  # of a message: what is longer is somebody's 5,000 nines


def say(message: str) -> None:
    """Print one line on stderr, if there is one: nobody's work fails because nobody listens."""
    with contextlib.suppress(OSError, ValueError):
        click.echo(one_line(message), err=True)


def one_line(message: str) -> str:
    """Return a message on one line, endless words cut short, and nothing in it that moves a terminal's cursor."""
    line = " ".join(message.split())
    line = re.sub(rf"\S{{{LONGEST_WORD},}}", lambda word: f"{word[0][:60]}...{word[0][-20:]}", line)
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in line)


class _Closed(io.TextIOBase):
    """Stands for a stdout that its caller closed: what is written to it is not lost in silence."""

    def write(self, text: str) -> int:
        """Refuse.

        Raises:
            OSError: always.
        """
        raise OSError(errno.EBADF, "standard output is closed; there is nowhere to write the answer")


def hold_closed_streams() -> None:
    """Take the places of standard streams that are closed, so that no file of ours gets the number of one."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
    if sys.stdout is None:
        sys.stdout = _Closed()
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # for the process's whole life
