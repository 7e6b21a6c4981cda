"""Work of minutes is always announced, confirmed on a terminal only, and --yes confirms."""

import click
import pytest

from nacre.cli import common, run
from nacre.core import jobs, machine
from nacre.core.progress import on_progress


@pytest.fixture
def asked(monkeypatch):
    questions = []
    monkeypatch.setattr(click, "confirm", lambda text, **_: questions.append(text))
    monkeypatch.setattr(machine, "add_progress_listener", lambda listener: None)
    return questions


@pytest.mark.parametrize(
    ("terminal", "seconds", "yes", "questions"),
    [(True, 200.0, False, 1), (True, 200.0, True, 0), (True, 5.0, False, 0), (False, 200.0, False, 0)],
)
def test_a_person_is_asked_before_minutes(monkeypatch, capsys, asked, terminal, seconds, yes, questions):
    monkeypatch.setattr(common, "_is_terminal", lambda: terminal)
    common.listener(yes)("a.toml: 24 patterns: about 3 minutes", seconds)
    assert len(asked) == questions
    assert "about 3 minutes" in capsys.readouterr().err


@pytest.mark.filterwarnings("always")
def test_a_warning_is_one_line_without_its_source_code(tmp_path, capsys):
    recipe = tmp_path / "dense.toml"
    recipe.write_text(
        'family = "metasurface"\nsubstrate = "air"\n[particle]\nmaterial = "Ag"\nradius_nm = 60\n'
        '[monolayer]\ncoverage = 0.2\n[model]\ncorrection = "qca-balanced"\nmultipole_order = 2\n'
    )
    assert run(["spectrum", str(recipe), "--wavelengths-nm", "500:500:10", "--angles-deg", "0"]) == 0
    reported = capsys.readouterr().err.strip().splitlines()
    assert len(reported) == 1
    assert reported[0].startswith(f"{recipe}: the mean field is taken of metal spheres with nothing below")


def test_yes_may_stand_anywhere(capsys):
    assert run(["keys", "--yes", "film.substrate"]) == 0
    assert "substrate" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("seconds", "pace", "lines", "share"),
    [(200.0, 25.0, 4, 1.0), (200.0, 25.0, 4, 0.2), (200.0, 1e9, 1, 1.0), (30.0, 0.0, 0, 1.0)],
)
def test_without_a_terminal_long_work_reports_progress_in_lines(monkeypatch, capsys, seconds, pace, lines, share):
    """With a fifth of the cores available, the lines also state the remaining time on free cores."""
    clock = iter(range(0, 1000, 10))  # each look at the clock finds it ten seconds on
    monkeypatch.setattr(common, "_is_terminal", lambda: False)
    monkeypatch.setattr(common, "PACE_S", pace)
    looks = [0.0]
    monkeypatch.setattr(common.time, "monotonic", lambda: looks.append(float(next(clock))) or looks[-1])
    monkeypatch.setattr(common.time, "process_time", lambda: 2 * share * looks[-1])
    monkeypatch.setattr(machine, "available_jobs", lambda: 2)
    watchers = list(machine._progress_listeners)
    common.listener(False)("a.toml: 10 patterns: about 3 minutes", seconds)
    for done in range(1, 11):
        for listener in list(machine._progress_listeners):
            listener(done, 10)
    reported = [line for line in capsys.readouterr().err.splitlines() if "of 10 solved" in line]
    assert len(reported) == lines
    if lines:
        assert reported[-1].startswith("10 of 10 solved, after ")
    if lines > 1:
        rest = "70 seconds left" if share == 1.0 else "14 seconds left on free cores, 70 seconds as busy as it is"
        assert reported[0] == f"3 of 10 solved, about {rest}"
    assert machine._progress_listeners == watchers


@pytest.mark.parametrize(("least", "expected"), [(-1.0, 1), (1e9, 0)])
def test_described_work_is_announced_once_if_the_rest_takes_long(monkeypatch, least, expected):
    monkeypatch.setattr(jobs, "ANNOUNCED_S", least)
    heard = []
    with on_progress(lambda what, seconds: heard.append(seconds)):
        assert jobs.in_workers(lambda item: 2 * item, range(20), description="numbers") == list(range(0, 40, 2))
        assert len(heard) == expected
        jobs.in_workers(lambda item: item, range(20))
        jobs.in_workers(lambda item: item, [], description="nothing")
    assert len(heard) == expected
