"""A worker thread that answers only the newest request."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Generic, TypeVar

REST_S = 0.25  # pause after a draft, in which a newer request may arrive
Request = TypeVar("Request")


class SupersededError(Exception):
    """A newer request has arrived."""


class LatestOnlyWorker(Generic[Request]):
    """Answers the newest request; older ones are dropped, and one in progress is superseded.

    `answer(request, is_superseded)` yields `(message, is_draft)` and may raise `SupersededError`; the worker rests
    after a draft. The thread ends when all requests are answered.
    """

    def __init__(
        self,
        answer: Callable[[Request, Callable[[], bool]], Iterator[tuple[Any, bool]]],
        send: Callable[[Any], None],
        fail: Callable[[Request, Exception], None],
        slot: AbstractContextManager[Any] | None = None,
        drops_superseded: bool = True,
    ) -> None:
        """Create an idle worker.

        Args:
            answer: generates messages for a request.
            send: sends a message; never called concurrently.
            fail: reports an exception in `answer`.
            slot: held while a message is computed, to limit the workers that compute at once.
            drops_superseded: whether a message is dropped if a newer request arrived during its computation.
        """
        self._answer, self._send, self._fail = answer, send, fail
        self._slot = nullcontext() if slot is None else slot
        self._drops_superseded = drops_superseded
        self._changed = threading.Condition()
        self.sending = threading.Lock()
        self._number = 0
        self._waiting: list[Request] = []  # the newest request, until its answer begins
        self._is_cancelled = False
        self._thread: threading.Thread | None = None

    def submit(self, request: Request) -> None:
        """Replace the current request; return at once."""
        with self._changed:
            self._number += 1
            self._waiting = [request]
            self._is_cancelled = False
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, daemon=True, name="nacre-studio")
                self._thread.start()
            self._changed.notify_all()

    def cancel(self) -> None:
        """Drop the current request."""
        with self._changed:
            self._number += 1
            self._waiting = []
            self._is_cancelled = True
            self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Wait until all requests are answered; return whether they are."""
        with self._changed:
            return self._changed.wait_for(lambda: self._thread is None, seconds)

    def _work(self) -> None:
        while True:
            with self._changed:
                if not self._waiting:
                    self._thread = None
                    self._changed.notify_all()
                    return
                number, request = self._number, self._waiting.pop()
            try:
                self._respond(request, lambda number=number: self._number != number)  # type: ignore[misc]
            except SupersededError:
                pass
            except Exception as error:  # reported; the next request is answered all the same
                with self.sending:
                    if not self._is_cancelled:
                        self._fail(request, error)

    def _respond(self, request: Request, is_superseded: Callable[[], bool]) -> None:
        messages = self._answer(request, is_superseded)
        while True:
            with self._slot:
                message, is_draft = next(messages, (None, False))
            if message is None:
                return
            with self.sending:
                if self._is_cancelled or (self._drops_superseded and is_superseded()):
                    raise SupersededError
                self._send(message)
            if is_draft:
                with self._changed:
                    if self._changed.wait_for(is_superseded, REST_S):
                        raise SupersededError
