"""Run the tests against mutants: import and collect once, then fork a process for each mutant.

The fork of a mutant in a function's body replaces that function's code. A mutant in a constant, a default, a decorator
or a class is put in while the package is imported: its process forks before that, and collects its tests itself. What
numba compiled of a mutant's line is compiled anew, outside its disk cache. A test that fails counts where it passes
without the mutant.

    python -m tools.mutants.worker PLACE NUMBER COUNT LIMIT_S    (every COUNT-th mutant)
"""

from __future__ import annotations

import gc
import importlib
import importlib.abc
import importlib.machinery
import json
import os
import signal
import sys
import time
import traceback
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import hypothesis
import numba
import numba.core.event
import numpy as np
import pytest
from tools.mutants.choose import Package, Tests

PATIENCE_S = 900.0  # on the clock, against a test that waits; all other limits are of the processor
COMPILING_S = 60.0  # beside the limit
SLOWER = 3.0  # times its own time, and more than the limit: a killed mutant
OVERHEAD_S = 10.0  # of the first test in a process
FILES = 12  # that a mutant collects which is put in while importing
FOREIGN = (
    "numba.core.event pydantic yaml tomlkit PIL.Image jax colour tmm filelock jinja2 scipy.stats scipy.optimize "
    "scipy.special scipy.integrate scipy.interpolate scipy.sparse.linalg scipy.ndimage"
).split()
SKIPPED = (
    "docs/test_n",
    "docs/test_r",
    "docs/test_s",
    "cli",
    "render_scenes",
    "design",
    "study",
    "studio",
    "plot",
    "test_packaging",
    "test_every_verb",
)
OPTIONS = (
    *"-q -s -p no:cacheprovider -p no:xdist -p no:cov --continue-on-collection-errors --timeout=0".split(),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # packages that were imported before
    *("-m", "(slow or not full) and not gpu"),
)
TICK = os.sysconf("SC_CLK_TCK")


def changed_function(before: CodeType, after: CodeType) -> tuple[str, int, CodeType] | None:
    """Return (qualified name, first line, new code) of the one function that differs; None where more does."""
    if before.co_flags & 0x2:  # a function
        return None if before == after else (before.co_qualname, before.co_firstlineno, after)
    outer = [
        (c.co_code, c.co_names, [None if isinstance(k, CodeType) else repr(k) for k in c.co_consts])
        for c in (before, after)
    ]
    pairs = list(zip(before.co_consts, after.co_consts, strict=False))
    inner = [(a, b) for a, b in pairs if isinstance(a, CodeType) and isinstance(b, CodeType) and a != b]
    found = changed_function(*inner[0]) if outer[0] == outer[1] and len(inner) == 1 else None
    return found if found and "<" not in found[0].rpartition(".")[2] else None


def module_of(file: str) -> str:
    """Return the module's name of a file."""
    return file.removeprefix("src/").removesuffix(".py").replace("/", ".").removesuffix(".__init__")


class Loader(importlib.machinery.SourceFileLoader):
    """Loads the mutant's file."""

    mutant: dict[str, Any]

    def get_code(self, fullname: str) -> CodeType | None:
        """Compile the mutated text in place of the file's."""
        if Path(self.path) == Path(self.mutant["file"]).resolve():
            return compile(self.mutant["text"], self.path, "exec")
        return super().get_code(fullname)


def import_mutant(mutant: dict[str, Any]) -> None:
    """Let the import of the mutant's file load its mutated text."""
    Loader.mutant = mutant
    name = module_of(mutant["file"])

    class Finder(importlib.abc.MetaPathFinder):
        def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
            spec = importlib.machinery.PathFinder.find_spec(fullname, path) if fullname == name else None
            if spec and spec.origin:
                spec.loader = Loader(fullname, spec.origin)
            return spec

    sys.meta_path.insert(0, Finder())


def compile_anew(kernels: set[tuple[str, str]]) -> None:
    """Compile these kernels without numba's disk cache, and all in this process, without locks between processes."""
    from nacre.core import jit

    usual = jit._dispatcher
    jit._compiled_by_one = lambda dispatcher: dispatcher

    def dispatcher(function: Any, options: dict[str, Any]) -> Any:
        file = str(Path(function.__code__.co_filename).relative_to(Path.cwd()))
        if (file, function.__name__) in kernels:
            jit._register_listener()
            return numba.njit(**options)(function)
        return usual(function, options)

    jit._dispatcher = dispatcher
    numba.config.OPT = 1 if kernels else 3  # half the time of compiling


class Compiling(numba.core.event.Listener):
    """Adds up what numba's compiler takes of the processor."""

    seconds, depth, start = 0.0, 0, 0.0

    def on_start(self, event: Any) -> None:
        """Note the time at the outermost start."""
        if self.depth == 0:
            self.start = time.process_time()
        self.depth += 1

    def on_end(self, event: Any) -> None:
        """Add the time since then."""
        self.depth -= 1
        if self.depth == 0:
            Compiling.seconds += time.process_time() - self.start


def spent(pid: int) -> float:
    """Return the processor seconds of a process and of its children that have ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / TICK


class Session:
    """Pytest's plugin that tries mutants in place of running the tests."""

    def __init__(self, place: Path, limit_s: float) -> None:
        self.place, self.limit_s = place, limit_s
        self.package = Package(Path.cwd())
        self.log, self.out = place / "events.jsonl", place / "output.txt"
        self.known = place / "tests.json"  # what they cost, and those that fail without a mutant
        kept = json.loads(self.known.read_text()) if self.known.exists() else {"cost": {}, "failed": []}
        self.cost: dict[str, float] = kept["cost"]
        self.failed = set(kept["failed"])
        self.fast: list[dict[str, Any]] = []
        self.every = False  # all collected tests, or those that name a mutant

    # in the processes that have the tests

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Take the tests that remain after pytest has chosen by mark."""
        self.items = list(session.items)
        gc.unfreeze()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self) -> bool:
        """Try the mutants of functions, and write down the tests of the others."""
        functions = self.functions()
        tests = Tests(Path.cwd(), self.items)
        print(f"mutants: {len(self.items)} tests collected, {time.process_time():.0f} s", flush=True)
        plans: dict[str, list[str]] = {}
        for mutant in self.fast:
            ranked = tests.order(self.package, mutant, self.cost, self.every)
            order = [item for item in ranked if item.nodeid not in self.failed]
            text = Path(mutant["file"]).read_text(encoding="utf-8")
            name = str(Path(mutant["file"]).resolve())
            found = changed_function(compile(text, name, "exec"), compile(mutant["text"], name, "exec"))
            places = functions[name, *found[:2]] if found else []
            if found is None or not places:
                plans[mutant["id"]] = [item.nodeid for item in order]
                continue

            def work(change: Callable[[], None], order: list[Any] = order) -> int:
                change()
                return self.run(order)

            def change(places: list[Any] = places, code: CodeType = found[2], mutant: Any = mutant) -> None:
                compile_anew(self.package.kernels_of(mutant["file"], mutant["line"]))
                for function in places:
                    function.__code__ = code

            self.attempt(mutant, len(order), lambda w=work, c=change: w(c), self.alone)
        (self.place / "plans.json").write_text(json.dumps(plans), encoding="utf-8")
        self.confirm(self.alone)
        return True

    def confirm(self, alone: Callable[[str], int]) -> None:
        """Run the tests that failed without a mutant, in one process; forget the answers of those that fail again."""
        path = self.place / "results.jsonl"
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        answers = [json.loads(line) for line in lines]
        unsure = {a["test"] for a in answers if a.get("by") == "failure" and "::" in a["test"]}
        unsure -= self.cost.keys() | self.failed
        _, _, events = self.watch(lambda: max((alone(test) for test in sorted(unsure)), default=0), patient=True)
        self.cost |= {e["end"]: e["took"] for e in events if "end" in e}
        self.failed |= (wrong := {e["failed"] for e in events if "failed" in e})
        self.cost = {test: took for test, took in self.cost.items() if test not in wrong}
        self.known.write_text(json.dumps({"cost": self.cost, "failed": sorted(self.failed)}))
        right = [json.dumps(a) + "\n" for a in answers if a.get("test") not in wrong]
        path.write_text("".join(right), encoding="utf-8")
        print(f"mutants: {len(unsure)} tests run without a mutant; these fail too: {sorted(wrong)}", flush=True)

    def functions(self) -> dict[tuple[str, str, int], list[FunctionType]]:
        """Import the files of the mutants, and return all functions by file, name and line."""
        for file in {mutant["file"] for mutant in self.fast}:
            importlib.import_module(module_of(file))
        found: dict[tuple[str, str, int], list[FunctionType]] = defaultdict(list)
        for thing in gc.get_objects():
            if type(thing) is FunctionType:
                code = thing.__code__
                found[code.co_filename, code.co_qualname, code.co_firstlineno].append(thing)
        gc.freeze()
        return found

    def run(self, order: list[Any]) -> int:
        """Run the tests, in a process of the mutant, up to the first that fails or the limit; return the status."""
        failed: list[str] = []
        log = self.log.open("a", buffering=1, encoding="utf-8")

        class Reports:
            def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
                if report.failed:
                    failed.append(report.nodeid)
                    log.write(json.dumps({"failed": report.nodeid, "reason": str(report.longrepr)[-600:]}) + "\n")

        def own_s() -> float:
            return sum(os.times()[:4]) - min(Compiling.seconds, COMPILING_S)

        order = [item for item in order if item.nodeid not in self.failed]
        began = own_s()
        for item, after in zip(order, [*order[1:], None], strict=True):
            if item is order[0]:
                item.config.pluginmanager.register(Reports())
            start = own_s()
            log.write(json.dumps({"start": item.nodeid}) + "\n")
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            log.write(json.dumps({"end": item.nodeid, "took": round(own_s() - start, 3)}) + "\n")
            if failed:
                return 1
            if own_s() - began > self.limit_s:
                return 3
        return 0

    def alone(self, test: str) -> int:
        """Run one test without a mutant."""
        compile_anew(set())
        return self.run([item for item in self.items if item.nodeid == test])

    # in the process that watches

    def watch(self, work: Callable[[], int], patient: bool = False) -> tuple[int | None, float, list[dict[str, Any]]]:
        """Fork a process for `work`; return its status, its processor seconds and its events."""
        self.log.write_text("")
        began, taken = time.monotonic(), 0.0
        child = os.fork()
        if child == 0:
            status = 70
            try:
                os.setsid()
                sink = os.open(self.out, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
                os.dup2(sink, 1)
                os.dup2(sink, 2)
                status = work()
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(status)
        status: int | None = None
        while status is None:
            time.sleep(0.1)
            ended, code = os.waitpid(child, os.WNOHANG)
            status = os.waitstatus_to_exitcode(code) if ended else None
            taken = max(taken, spent(child))
            late = taken > SLOWER * self.limit_s + COMPILING_S or time.monotonic() - began > PATIENCE_S
            if status is None and late and not patient:
                os.killpg(child, signal.SIGKILL)
                os.waitpid(child, 0)
                break
        return status, taken, [json.loads(line) for line in self.log.read_text().splitlines()]

    def attempt(self, mutant: dict[str, Any], count: int, work: Callable[[], int], alone: Callable[[str], int]) -> None:
        """Try a mutant until its tests pass, or one fails that passes without it; note what came of it."""
        answer = {"id": mutant["id"], "tests": count, "cpu": 0.0}
        while "outcome" not in answer:
            status, taken, events = self.watch(work)
            answer["cpu"] = round(answer["cpu"] + taken, 1)
            answer["ran"] = sum("end" in event for event in events)
            failure = next((e for e in events if "failed" in e), None)
            running = events[-1].get("start", "") if events else ""
            if failure:
                answer |= {"outcome": "killed", "by": "failure", "test": failure["failed"], "reason": failure["reason"]}
            elif running:  # the process died, or took too long
                test, known = running, self.cost.get(running)
                usual, took, _ = (0, known, []) if known is not None else self.watch(lambda test=test: alone(test))
                answer["cpu"] = round(answer["cpu"] + (took if known is None else 0.0), 1)
                if usual in (0, 3) and (status is not None or SLOWER * took + OVERHEAD_S < taken):
                    answer |= {"outcome": "killed", "by": "failure" if status else "time", "test": test}
                    answer["reason"] = f"{taken:.0f} s, alone {took:.0f} s; {status}"
                else:
                    self.failed.add(test)  # without a mutant, or for longer than a mutant may take
            elif status in (0, 3):
                why = "all passed" if status == 0 else f"{self.limit_s:.0f} s ran out"
                answer |= {"outcome": "survived", "why": why if count else "no test names it"}
            else:  # the package cannot be imported, or no test be collected
                reason = self.out.read_text(encoding="utf-8", errors="replace")[-600:]
                answer |= {
                    "outcome": "killed",
                    "by": "failure",
                    "test": "(collecting)",
                    "reason": f"{status}: {reason}",
                }
            self.cost |= {e["end"]: e["took"] for e in events if e.get("end", answer.get("test")) != answer.get("test")}
        self.known.write_text(json.dumps({"cost": self.cost, "failed": sorted(self.failed)}))
        with (self.place / "results.jsonl").open("a", encoding="utf-8") as results:
            results.write(json.dumps(answer) + "\n")
        verdict = f"{answer['outcome']} {answer.get('test') or answer.get('why')}"
        print(f"{mutant['file']}:{mutant['line']} {verdict} ({answer['ran']} tests, {answer['cpu']} s)", flush=True)


class Imported:
    """Pytest's plugin of a process that imports its mutant: it runs the tests of a plan."""

    def __init__(self, session: Session, plan: list[str], kernels: set[tuple[str, str]]) -> None:
        self.session, self.plan, self.kernels, self.status = session, plan, kernels, 70

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run those of the plan, in its order."""
        compile_anew(self.kernels)
        found = {item.nodeid: item for item in session.items}
        files = {test.partition("::")[0] for test in found}
        gone = [test for test in self.plan if test.partition("::")[0] not in files]
        if gone:  # files that cannot be imported
            with self.session.log.open("a", encoding="utf-8") as log:
                log.write(json.dumps({"failed": gone[0], "reason": "cannot be collected"}) + "\n")
            self.status = 1
        else:
            self.status = self.session.run([found[test] for test in self.plan if test in found])
        return True


def try_while_importing(session: Session, mutant: dict[str, Any], plan: list[str]) -> None:
    """Try a mutant that has to be there when the package is imported."""
    files = list(dict.fromkeys(test.partition("::")[0] for test in plan))[:FILES]
    plan = [test for test in plan if test.partition("::")[0] in files]
    kernels = session.package.kernels_of(mutant["file"], mutant["line"])

    def work() -> int:
        import_mutant(mutant)
        return collect(session, plan, kernels)

    session.attempt(mutant, len(plan), work, lambda test: collect(session, [test], set()))


def collect(session: Session, tests: list[str], kernels: set[tuple[str, str]]) -> int:
    """Collect the files of these tests, and run the tests."""
    plugin = Imported(session, [test for test in tests if test not in session.failed], kernels)
    pytest.main([*OPTIONS, *dict.fromkeys(test.partition("::")[0] for test in tests)], plugins=[plugin])
    return plugin.status


def main() -> None:
    """Try the mutants of todo.json: first those of functions, then those of modules and classes."""
    place, number, count, limit_s = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    hypothesis.settings.register_profile("mutants", derandomize=True, deadline=None, database=None)
    hypothesis.settings.load_profile("mutants")
    for name in FOREIGN:
        importlib.import_module(name)
    numba.njit(lambda x: x + 1.0)(np.zeros(3))  # loads numba's compiler
    numba.core.event.register("numba:compile", Compiling())
    todo = json.loads((place / "todo.json").read_text(encoding="utf-8"))
    os.chdir(place / "base")  # the modules of this tool come from the tree itself
    place = place / f"worker{number}"
    place.mkdir(exist_ok=True)
    files = [str(p) for p in sorted(Path("tests").rglob("test_*.py"))]
    left_out = tuple(f"tests/{s}" for s in SKIPPED) if todo["tests"] == ["tests/"] else ()
    files = [f for f in files if f.startswith(tuple(todo["tests"])) and not f.startswith(left_out)]
    package = Package(Path.cwd())
    groups: dict[bool, list[dict[str, Any]]] = {False: [], True: []}
    for mutant in todo["mutants"][number::count]:
        groups[bool(package.kernels_of(mutant["file"], mutant["line"]))].append(mutant)
    for group in (groups[False], groups[True]):  # those that numba has to compile last
        (place / "plans.json").unlink(missing_ok=True)
        child = os.fork() if group else 0
        if group and child == 0:
            session = Session(place, limit_s)
            session.fast, session.every = group, todo["tests"] != ["tests/"]
            compile_anew(set())  # before a test's file calls a kernel
            os._exit(int(pytest.main([*OPTIONS, *files], plugins=[session])))
        if group:
            os.waitpid(child, 0)
            plans = json.loads((place / "plans.json").read_text(encoding="utf-8"))
            session = Session(place, limit_s)
            for mutant in group:
                if mutant["id"] in plans:
                    try_while_importing(session, mutant, plans[mutant["id"]])
            session.confirm(lambda test, session=session: collect(session, [test], set()))


if __name__ == "__main__":
    main()
