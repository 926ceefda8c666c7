"""Crew: a few threads that help the calling one with work that comes in parts."""

import os
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from queue import SimpleQueue
from threading import Thread, current_thread
from typing import Any

Call = Callable[[Any], None]


class Crew:
    """Helpers who share the parts of one call with the thread that calls.

    Whoever is free takes the next part. So nobody waits for a helper to wake up: where they come
    late, because other programs have the cores, the caller does all parts alone. The helpers
    end with the object, and at the interpreter's exit; in a forked process there are none.
    """

    def __init__(self, helpers: int) -> None:
        self._jobs: SimpleQueue = SimpleQueue()
        self._process = os.getpid()
        self._helpers = [
            Thread(target=_help, args=(self._jobs,), name="waterline", daemon=True)
            for _ in range(helpers)
        ]
        for helper in self._helpers:
            helper.start()
        weakref.finalize(self, _dismiss, self._jobs, self._helpers)

    def share(self, call: Call, parts: Sequence[Any]) -> None:
        """Call `call` with each of the parts and return when all are done. What one of the calls
        raises is raised here, after the others have ended."""
        outcomes: list[BaseException | None] = []
        job = (call, iter(parts), outcomes)
        if os.getpid() == self._process:
            for _ in self._helpers:
                self._jobs.put(job)
        _do_parts(*job)
        while len(outcomes) < len(parts):
            time.sleep(0)  # lets a helper have Python's lock
        for error in outcomes:
            if error is not None:
                raise error


def _do_parts(call: Call, parts: Iterator[Any], outcomes: list[BaseException | None]) -> None:
    for part in parts:  # a list's iterator gives each part to one thread only
        try:
            call(part)
        except BaseException as error:
            outcomes.append(error)
        else:
            outcomes.append(None)


def _help(jobs: SimpleQueue) -> None:
    while _do_next(jobs):
        pass


def _do_next(jobs: SimpleQueue) -> bool:
    """Help with the next job; whether there was one. A function, so that a waiting helper keeps
    nothing of the last job alive."""
    job = jobs.get()
    if job is None:
        return False
    _do_parts(*job)
    return True


def _dismiss(jobs: SimpleQueue, helpers: Sequence[Thread]) -> None:
    for _ in helpers:
        jobs.put(None)
    for helper in helpers:
        if helper is not current_thread():  # garbage may be collected in any thread
            helper.join()
