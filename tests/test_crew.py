"""Crew: helpers take parts of the work, hand on what goes wrong, and go home."""

import subprocess
import sys
import threading
from collections import Counter

import pytest

from independent import REPOSITORY
from sim.methods.crew import Crew


def test_helpers_work_at_the_same_time_as_the_caller():
    """A barrier lets nobody through before three threads stand at it."""
    barrier = threading.Barrier(3, timeout=30.0)
    workers = set()

    def meet(part: int) -> None:
        workers.add(threading.get_ident())
        barrier.wait()

    Crew(2).share(meet, range(3))
    assert len(workers) == 3
    assert threading.get_ident() in workers


def test_every_part_is_done_once():
    crew, done = Crew(3), Counter()
    for _ in range(200):
        crew.share(lambda part: done.update([part]), range(7))
    assert done == dict.fromkeys(range(7), 200)


@pytest.mark.parametrize("wrong", [0, 1])
def test_what_a_part_raises_is_raised_to_the_caller_when_all_are_done(wrong):
    """Each of the two threads has one part; either may be the one that goes wrong."""
    barrier, caller, done = threading.Barrier(2, timeout=30.0), threading.get_ident(), []

    def call(part: int) -> None:
        barrier.wait()
        if (threading.get_ident() == caller) == (wrong == 0):
            raise ArithmeticError("no such wrench")
        done.append(part)

    crew = Crew(1)
    with pytest.raises(ArithmeticError, match="no such wrench"):
        crew.share(call, range(2))
    assert len(done) == 1
    crew.share(done.append, range(5))  # and it goes on working
    assert len(done) == 6


FORK = """
import os
from sim.methods.crew import Crew

crew, done = Crew(1), []
crew.share(done.append, range(4))
child = os.fork()
crew.share(done.append, range(4))
assert len(done) == 8
if child:
    assert os.waitpid(child, 0)[1] == 0
    print("both ended")
"""


def test_a_forked_process_and_the_interpreters_exit():
    """The child has no helpers and works alone; neither waits for a thread for ever."""
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORK],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "both ended\n", "")
