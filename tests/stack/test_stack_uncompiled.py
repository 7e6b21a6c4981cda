"""The recursion in NumPy, which a command's first small work uses: the kernel's results, and when it ends."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from nacre.core import jit
from nacre.matter.stack.inputs import StackArrays, prepare, run_kernel


@pytest.fixture(autouse=True)
def _kernels_afterwards() -> Iterator[None]:
    yield
    jit.spare_compilation(0)


def both(stack: StackArrays) -> list[tuple[np.ndarray, np.ndarray]]:
    """Amplitudes and powers by NumPy and by the kernel."""
    found = []
    for work in (1e12, 0):
        jit.spare_compilation(work)
        found.append(run_kernel(stack, True, True, None))
    return found


@pytest.mark.parametrize("wavelengths", [1, 31, 100])
@pytest.mark.parametrize("layers", [0, 1, 20, 60])
def test_random_stacks_have_the_kernels_amplitudes_and_powers(wavelengths: int, layers: int) -> None:
    rng = np.random.default_rng(1000 * layers + wavelengths)
    n = rng.uniform(1.0, 3.5, (3, layers + 2, wavelengths)) + 0j
    n[:, 1:] += 1j * np.where(rng.random((3, layers + 1, 1)) < 0.5, 0.0, rng.uniform(0.0, 4.0, (3, layers + 1, 1)))
    d = rng.uniform(0.0, 400.0, (3, layers)) * (rng.random((3, layers)) > 0.1)
    angles = np.r_[0.0, rng.uniform(0.0, np.pi / 2, 4), np.pi / 2]
    ours, kernel = both(prepare(n, d, np.linspace(380.0, 780.0, wavelengths), theta_rad=angles))
    for one, other in zip(ours, kernel, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-10)


def test_total_reflection_evanescent_waves_and_a_matched_stack_are_the_kernels() -> None:
    wavelengths = np.linspace(400.0, 700.0, 5)
    tunnel = prepare([[1.5], [1.0], [1.5]], [2000.0], wavelengths, theta_rad=np.radians([20.0, 41.9, 60.0, 90.0]))
    matched = prepare([[1.0], [1.0], [1.0]], [100.0], wavelengths, theta_rad=[0.0, np.pi / 2])
    beyond = prepare([[1.0], [2.0], [1.5]], [50.0], wavelengths, kappa=[0.3, 1.2, 2.5 + 0.1j], waves_only=True)
    for stack, has_powers in ((tunnel, True), (matched, True), (beyond, False)):
        ours, kernel = both(stack)
        np.testing.assert_allclose(ours[0], kernel[0], rtol=0, atol=1e-12)
        if has_powers:
            np.testing.assert_allclose(ours[1], kernel[1], rtol=0, atol=1e-12)


def test_work_is_spared_until_a_piece_exceeds_the_rest() -> None:
    assert not jit.is_spared(1)
    jit.spare_compilation(100)
    assert [jit.is_spared(work) for work in (60, 40, 1, 0.5)] == [True, True, False, False]
    jit.spare_compilation(100)
    assert [jit.is_spared(work) for work in (60, 50, 1)] == [True, False, False]


def test_numbas_files_are_found_where_numba_puts_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    module = tmp_path / "module"
    for place in (module / "__pycache__", tmp_path / "home" / "numba" / "x_1", tmp_path / "given" / "x_1"):
        assert not jit.may_be_stored(module, "kernel.solve_range")
        place.mkdir(parents=True)
        (place / "kernel.solve_range-459.py311.nbi").touch()
        if place.parent == tmp_path / "given":
            monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "given"))
        assert jit.may_be_stored(module, "kernel.solve_range")
        (place / "kernel.solve_range-459.py311.nbi").unlink()


def test_a_first_spectrum_compiles_nothing(tmp_path: Path) -> None:
    code = (
        "import sys, nacre.cli\n"
        "try: nacre.cli.main(['spectrum', 'soap', '--wavelengths-nm', '500,600'])\n"
        "except SystemExit as end: print('numba' in sys.modules, end.code)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "False 0", done.stderr
