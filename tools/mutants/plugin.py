"""What pytest does in a run for a mutant: the tests of a plan in its order, and a log of each step.

`NACRE_MUTANTS_LOG` names the log, one JSON object a line; `NACRE_MUTANTS_PLAN` a file with the tests' names, all if
unset. Times are of the processor, so that a loaded machine makes no test slow, and compiling is separated from
running: a mutant has to compile what the baseline took from its cache.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Generator
from typing import Any

import pytest

LOG = os.environ.get("NACRE_MUTANTS_LOG", os.devnull)
PLAN = os.environ.get("NACRE_MUTANTS_PLAN", "")


def cpu() -> float:
    """Processor seconds of this process and of its children that have ended."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def log_event(**what: Any) -> None:
    """Append a line to the log."""
    with open(LOG, "a", encoding="utf-8") as log:
        log.write(json.dumps({**what, "cpu": cpu(), "at": time.time(), "pid": os.getpid()}) + "\n")


def pytest_configure(config: pytest.Config) -> None:
    """The same examples in every run, and no deadline that a busy machine would miss; log compiling."""
    import hypothesis
    from numba.core import event

    hypothesis.settings.register_profile("mutants", derandomize=True, deadline=None, database=None)
    hypothesis.settings.load_profile("mutants")

    class Compiling(event.Listener):
        depth = 0

        def on_start(self, _: Any) -> None:
            self.depth += 1
            if self.depth == 1:
                log_event(compile="start")

        def on_end(self, _: Any) -> None:
            self.depth -= 1
            if self.depth == 0:
                log_event(compile="end")

    event.register("numba:compile", Compiling())


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the tests of the plan, in its order."""
    if PLAN:
        with open(PLAN, encoding="utf-8") as plan:
            place = {name: i for i, name in enumerate(json.load(plan))}
        items[:] = sorted((i for i in items if i.nodeid in place), key=lambda item: place[item.nodeid])
    log_event(collected=len(items))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """Log when a test starts and ends."""
    log_event(start=item.nodeid)
    result = yield
    log_event(end=item.nodeid)
    return result


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Log the outcome of each part of a test."""
    if report.when == "call" or report.outcome != "passed":
        reason = "" if report.outcome == "passed" else str(report.longrepr)[-1500:]
        log_event(test=report.nodeid, outcome=report.outcome, reason=reason)


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """Log a file that cannot be imported."""
    if report.failed:
        log_event(test=report.nodeid, outcome="failed", reason=str(report.longrepr)[-1500:])
