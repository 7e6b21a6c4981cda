"""Run sheet: monitor signals, turning points and stop criteria of growing layers, against the theory of one layer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.recipe.toml import dump_toml

LAMBDA_NM = 550.0
N_L, N_H, N_S = 1.38, 2.1, 1.52


def film(*layers: tuple[float, float]) -> dict[str, Any]:
    return {
        "family": "film",
        "substrate": {"n": N_S},
        "layers": [{"material": {"n": n}, "thickness_nm": d} for n, d in layers],
    }


def airy(n: float, d: float) -> float:
    """Reflectance of one lossless layer at normal incidence (Born & Wolf, sec. 7.6)."""
    r1, r2 = (1 - n) / (1 + n), (n - N_S) / (n + N_S)
    phase = np.exp(4j * np.pi * n * d / LAMBDA_NM)
    return float(abs((r1 + r2 * phase) / (1 + r1 * r2 * phase)) ** 2)


def test_the_curve_of_one_layer_is_airys_and_turns_at_quarter_waves() -> None:
    quarter = LAMBDA_NM / (4 * N_H)
    (layer,) = nacre.runsheet(film((N_H, 3.4 * quarter)), LAMBDA_NM).layers
    np.testing.assert_allclose(layer.signal, [airy(N_H, d) for d in layer.grown_nm], atol=1e-12)
    np.testing.assert_allclose(layer.turning_nm, quarter * np.array([1, 2, 3]), rtol=1e-3)
    high = ((1 - N_H**2 / N_S) / (1 + N_H**2 / N_S)) ** 2  # quarter-wave formula
    bare = ((1 - N_S) / (1 + N_S)) ** 2
    np.testing.assert_allclose(layer.turning_signal, [high, bare, high], rtol=1e-4)
    assert layer.stop == "swing"
    assert layer.swing_percent == pytest.approx(100 * (layer.stop_signal - high) / (bare - high), rel=1e-3)


def test_the_thickness_error_is_what_the_noise_hides() -> None:
    noise = 1e-3
    for share in (0.5, 1.0):  # on the slope and at the turning point
        end = share * LAMBDA_NM / (4 * N_H)
        (layer,) = nacre.runsheet(film((N_H, end)), LAMBDA_NM, noise=noise).layers
        moved = abs(airy(N_H, end + layer.thickness_error_nm) - airy(N_H, end))
        assert moved == pytest.approx(noise, rel=0.1)
        assert layer.stop == ("level" if share < 1 else "turning point")


def test_layers_grow_from_the_substrate_and_join() -> None:
    sheet = nacre.runsheet(film((N_L, 95.0), (N_H, 115.0)), LAMBDA_NM, quantity="transmittance")
    assert [layer.layer for layer in sheet.layers] == [1, 0]
    assert sheet.layers[1].signal[0] == pytest.approx(sheet.layers[0].stop_signal, abs=1e-12)
    whole = nacre.spectrum(film((N_L, 95.0), (N_H, 115.0)), [0.0], [LAMBDA_NM]).specular_transmittance
    assert sheet.layers[1].stop_signal == pytest.approx(float(whole[0, 0]), abs=1e-12)


def test_the_command_writes_table_curves_and_figure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "ar.toml").write_text(dump_toml(film((N_L, 95.0), (N_H, 115.0))))
    files = [tmp_path / name for name in ("run.txt", "run.csv", "run.json", "run.png")]
    outputs = [word for path in files for word in ("-o", str(path))]
    assert run(["runsheet", str(tmp_path / "ar.toml"), *outputs, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads(files[2].read_text())
    assert len(document["layers"]) == 2
    rows = files[1].read_text().splitlines()
    assert len(rows) == 1 + sum(len(layer["signal"]) for layer in document["layers"])
    assert float(rows[-1].split(",")[4]) == pytest.approx(210.0)
    assert files[0].stat().st_size > 0 and files[3].read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("extra", [["--wavelength-nm", "-1"], ["--angle-deg", "95"], ["--noise", "0"], ["-o", "x.doc"]])
def test_a_bad_command_ends_with_status_2(extra: list[str], tmp_path: Path) -> None:
    (tmp_path / "ar.toml").write_text(dump_toml(film((N_L, 95.0))))
    assert run(["runsheet", str(tmp_path / "ar.toml"), *extra]) == 2


@pytest.mark.parametrize(
    "recipe", [film(), film((N_L, 95.0)) | {"layers": [{"material": "SiO2", "thickness_mm": 1, "incoherent": True}]}]
)
def test_a_film_without_coherent_layers_is_refused(recipe: dict[str, Any]) -> None:
    with pytest.raises(NacreError):
        nacre.runsheet(recipe)
