"""Design folders: the best solution and the search state on disk, from which `--resume` continues."""

from __future__ import annotations

import abc
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import read_text, write_text
from nacre.core.jit import clock
from nacre.optimise.problem import Budget, Changes, Result, Search
from nacre.optimise.solutions import Design, DesignProgress, Solution, claim, write_summary

STATE = "search.json"
WRITE_INTERVAL_S = 2.0
Answer = TypeVar("Answer", covariant=True)


@dataclass
class Checkpointer:
    """Writes the search state, at intervals unless forced.

    Attributes:
        folder: design folder.
        fingerprint: the task's fingerprint; checkpoints of other tasks are refused.
        runs: number of starts, this run included.
        solutions: recipe changes by path, best first; or the candidates of another search.
        progress: how far the search is.
    """

    folder: Path
    fingerprint: str
    runs: int = 1
    solutions: Sequence[Mapping[str, Any]] = ()
    progress: Mapping[str, Any] = field(default_factory=dict)
    written_at: float = -np.inf

    @property
    def is_due(self) -> bool:
        """Whether the interval since the last write is over."""
        return clock() - self.written_at > WRITE_INTERVAL_S

    def update(self, solutions: Sequence[Mapping[str, Any]], **progress: Any) -> None:
        """Write the solutions and the progress.

        Raises:
            NacreError: the folder cannot be written.
        """
        self.written_at, self.solutions, self.progress = clock(), solutions, progress
        state = {"target": self.fingerprint, "runs": self.runs, "solutions": [dict(one) for one in solutions]}
        state |= {"progress": progress} if progress else {}
        write_text(self.folder / STATE, json.dumps(state) + "\n")

    @classmethod
    def open(cls, folder: Path, fingerprint: str, resume: bool) -> Checkpointer:
        """Return a folder's checkpointer, with an earlier state if the search resumes.

        Raises:
            RecipeError: the checkpoint belongs to another task.
            NacreError: the checkpoint cannot be read.
        """
        path = folder / STATE
        if not resume or not path.exists():
            return cls(folder, fingerprint)
        try:
            state = json.loads(read_text(path, "state"))
            solutions, runs, owner = state["solutions"], int(state["runs"]), state["target"]
            progress = state.get("progress", {})
            is_list = runs >= 1 and isinstance(solutions, list)
            is_valid = is_list and all(isinstance(one, dict) for one in [*solutions, progress])
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            is_valid = False
        if not is_valid:
            raise unreadable(folder)
        if owner != fingerprint:
            raise RecipeError(
                f"{path}: belongs to another target, or a file that it names, or nacre itself has changed since; "
                "take another folder, or omit --resume"
            )
        return cls(folder, fingerprint, runs + 1, solutions, progress)


def unreadable(folder: Path) -> NacreError:
    """Return the error of a damaged checkpoint."""
    return NacreError(f"{folder / STATE}: cannot be read to resume; delete it to start afresh")


class DesignFolder(abc.ABC, Generic[Answer]):
    """A running search, and the folder that always holds its best solution.

    Attributes:
        folder: output folder.
        search: the method.
        checkpointer: writes the search state.
        seconds: time limit.
        jobs: threads of a search that uses several; default: all cores.
    """

    search: Search

    def __init__(
        self,
        checkpointer: Checkpointer,
        begun: float,
        seconds: float,
        progress: Callable[[DesignProgress], None] | None,
        jobs: int | None,
    ) -> None:
        self.folder, self.checkpointer, self.begun, self.seconds = checkpointer.folder, checkpointer, begun, seconds
        self.jobs, self._progress, self._written = jobs, progress, Changes()

    @abc.abstractmethod
    def budget(self) -> Budget:
        """Return the search budget."""

    @abc.abstractmethod
    def write_best(self, worst: float, changes: Changes) -> dict[str, Any]:
        """Write the files of the best solution so far; return its part of design.json."""

    @abc.abstractmethod
    def finish(self, result: Result) -> Answer:
        """Evaluate the solutions with the reference model, write them and the report."""

    def claim(self) -> None:
        """Mark the folder as this design's before its first file."""
        claim(self.folder)

    def write_running(self, part: dict[str, Any]) -> None:
        """Write `part`, which describes the best solution so far, to the summary."""
        write_summary(self.folder, {"status": "running", "seconds": round(self.spent_s, 3), **part})

    def design(self, source: str) -> Answer:
        """Search, write the checkpoint, and finish.

        Raises:
            KeyboardInterrupt: before there was a solution.
            RecipeError: all candidates fail.
        """
        result = self.search.run(self.budget(), self.update, self.checkpointer.solutions)
        if not result.solutions and result.status == "interrupted":
            raise KeyboardInterrupt
        if not result.solutions:
            raise RecipeError(f"{source}: the recipe cannot be computed anywhere in its bounds")
        self.claim()
        self.save([changes for _, changes in result.solutions])
        return self.finish(result)

    @property
    def spent_s(self) -> float:
        """Time since the start of the design."""
        return clock() - self.begun

    @property
    def left_s(self) -> float:
        """Time until the limit."""
        return self.seconds - self.spent_s

    def update(self, worst: float, changes: Changes) -> None:
        """Write a better solution if the last one was written some time ago, and report progress."""
        if changes and changes is not self._written and self.checkpointer.is_due:
            self._written = changes
            self.claim()
            self.write_running(self.write_best(worst, changes))
            self.save([changes])
        if self._progress is not None:
            rest_s, evaluations = max(self.left_s, 0.0), self.search.budget.used
            self._progress(DesignProgress(worst, self.spent_s, rest_s, evaluations, self.search.description, changes))

    def save(self, solutions: Sequence[Changes]) -> None:
        """Write the checkpoint.

        Raises:
            NacreError: the folder cannot be written.
        """
        candidates, progress = self.search.state(solutions)
        self.checkpointer.update(candidates, **progress)


class SolvableFolder(DesignFolder[Design]):
    """A design of one recipe, which a list of colours repeats."""

    @abc.abstractmethod
    def evaluated(self, changes: Changes) -> Solution | None:
        """Return a solution evaluated with the reference model, without its files; None if that fails."""
