"""Run sheet of a coating: optical monitor signal while each layer grows, turning points and stop criteria.

The signal is the reflectance or transmittance of the unfinished stack in vacuum at the monitor wavelength, without the
rear side of the substrate. Swing: the stop's position between the last two extrema of the layer's own signal (percent
of optical extrema monitoring; Macleod, Thin-Film Optical Filters, chapter on monitoring).
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.analysis.ellipsometry import specular_stack
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.material.material import MaterialLike, as_material
from nacre.matter.stack.stack import Layer, Stack, index_of

QUANTITIES = ("reflectance", "transmittance")
POINTS_PER_FRINGE, LEAST_POINTS, MOST_POINTS = 48, 24, 4000
AT_TURN = 0.02  # distance from an extremum, in fringes, below which a stop counts as a turning point
LEAST_SWING = 1e-9


@dataclass(frozen=True)
class MonitoredLayer:
    """One layer, in order of deposition.

    Attributes:
        layer: index in the stack, from the ambient inward, with repeated groups written out.
        material: name.
        thickness_nm: final thickness.
        grown_nm, signal: `[step]`, growing thickness and monitor signal.
        turning_nm, turning_signal: `[turn]`, extrema while it grows.
        stop_signal: signal at the end.
        slope_per_nm, curvature_per_nm2: derivatives of the signal at the end.
        thickness_error_nm: change of the thickness that changes the signal by its noise.
        stop: "turning point", "swing" (from the last two extrema), "start" (from the start of the layer and its only
            extremum) or "level" (no extremum).
        swing_percent: way back from the last extremum, in per cent of the way to it; None for other criteria.
    """

    layer: int
    material: str
    thickness_nm: float
    grown_nm: Array
    signal: Array
    turning_nm: Array
    turning_signal: Array
    stop_signal: float
    slope_per_nm: float
    curvature_per_nm2: float
    thickness_error_nm: float
    stop: str
    swing_percent: float | None


@dataclass(frozen=True)
class RunSheet:
    """Run sheet.

    Attributes:
        name: recipe name.
        quantity: "reflectance" or "transmittance"; wavelength_nm, angle_deg: monitor light.
        noise: the signal's standard deviation.
        layers: layers in order of deposition.
    """

    name: str
    quantity: str
    wavelength_nm: float
    angle_deg: float
    noise: float
    layers: tuple[MonitoredLayer, ...]


def make_run_sheet(
    thing: MaterialLike,
    wavelength_nm: float = 550.0,
    angle_deg: float = 0.0,
    quantity: str = "reflectance",
    noise: float = 0.001,
) -> RunSheet:
    """Return the optical monitor signal of each layer of a film while it grows, with turning points and stop criteria.

    Args:
        thing: a material or a path.
        wavelength_nm, angle_deg: monitor light, which is unpolarised.
        quantity: "reflectance" or "transmittance" (into the substrate).
        noise: the signal's standard deviation.

    Raises:
        UnsupportedError: the material lacks a coherent stack.
        NacreError: a value is not allowed, or an index is not known at the wavelength.

    Example:
        >>> layer = {"material": {"n": 2.2}, "thickness_nm": 62.5}  # a quarter wave
        >>> nacre.runsheet({"family": "film", "substrate": {"n": 1.52}, "layers": [layer]}, 550.0).layers[0].stop
        'turning point'
    """
    material = as_material(thing)
    for name, value, is_valid, rule in (
        ("wavelength_nm", wavelength_nm, wavelength_nm > 0, "above 0"),
        ("angle_deg", angle_deg, 0 <= angle_deg < 90, "from 0 up to 90"),
        ("noise", noise, noise > 0, "above 0"),
    ):
        if not (np.isfinite(value) and is_valid):
            raise NacreError(f"{name} = {value:g} should be finite and {rule}")
    if quantity not in QUANTITIES:
        raise NacreError(f'quantity = "{quantity}" is not known; choose one of {", ".join(QUANTITIES)}')
    stack = specular_stack(material, "a run sheet")
    layers = [(i, layer) for i, layer in enumerate(stack.layers) if layer.thickness_nm > 0]
    if not layers or any(layer.incoherent for _, layer in layers):
        why = "has an incoherent layer" if layers else "has no layers"
        raise UnsupportedError(f"{material.context.source}: a run sheet needs coherent layers; this film {why}")
    sheet_layers = []
    below: tuple[Layer, ...] = ()
    for number, layer in reversed(layers):
        grow = _Growth(layer, below, stack.substrate, wavelength_nm, angle_deg, quantity)
        sheet_layers.append(_monitored(number, grow, noise))
        below = (layer, *below)
    return RunSheet(material.name, quantity, wavelength_nm, angle_deg, noise, tuple(sheet_layers))


@dataclass(frozen=True)
class _Growth:
    """Signal of a growing layer on those below."""

    layer: Layer
    below: tuple[Layer, ...]
    substrate: Any
    wavelength_nm: float
    angle_deg: float
    quantity: str

    @property
    def fringe_nm(self) -> float:
        """Thickness between two extrema of the same kind."""
        try:
            n = float(index_of(self.layer.material, np.array([self.wavelength_nm]))[0].real)
        except NacreError:
            n = 1.7  # anisotropic: only the sampling depends on it
        sin = np.sin(np.radians(self.angle_deg))
        return float(self.wavelength_nm / (2.0 * np.sqrt(max(n * n - sin * sin, 0.04))))

    def signal(self, thickness_nm: float) -> float:
        """Return the signal at a thickness."""
        layers = [Layer(self.layer.material, thickness_nm, helix=self.layer.helix), *self.below]
        powers = Stack(1.0, layers, self.substrate).powers([np.radians(self.angle_deg)], [self.wavelength_nm])
        part = powers.reflectance if self.quantity == "reflectance" else powers.transmittance
        return float(part[0, 0])


def _monitored(number: int, grow: _Growth, noise: float) -> MonitoredLayer:
    end, fringe = grow.layer.thickness_nm, grow.fringe_nm
    count = int(np.clip(POINTS_PER_FRINGE * end / fringe, LEAST_POINTS, MOST_POINTS)) + 1
    grown = np.linspace(0.0, end, count)
    signal = np.array([grow.signal(float(d)) for d in grown])
    turning_nm, turning = _extrema(grown, signal)
    step = 1e-3 * fringe
    behind, ahead = grow.signal(max(end - step, 0.0)), grow.signal(end + step)
    slope, curvature = (ahead - behind) / (2 * step), (ahead - 2 * signal[-1] + behind) / step**2
    stop, swing = "level", None
    to_turn = -slope / curvature if curvature != 0 else np.inf
    if abs(to_turn) < AT_TURN * fringe:
        stop = "turning point"
    elif len(turning):
        stop = "swing" if len(turning) > 1 else "start"
        before = turning[-2] if len(turning) > 1 else signal[0]
        if abs(before - turning[-1]) > LEAST_SWING:
            swing = float(100.0 * (signal[-1] - turning[-1]) / (before - turning[-1]))
        else:
            stop = "level"
    # noise = |slope| x + |curvature| x^2 / 2, without cancellation
    a, b = 0.5 * abs(curvature), abs(slope)
    root = b + np.sqrt(b * b + 4 * a * noise)
    error = float(2 * noise / root) if root > 0 else float("inf")
    name = str(getattr(grow.layer.material, "name", "") or grow.layer.material)
    return MonitoredLayer(
        number, name, float(end), grown, signal, turning_nm, turning, float(signal[-1]), float(slope),
        float(curvature), error, stop, swing,
    )  # fmt: skip


def _extrema(x: Array, y: Array) -> tuple[Array, Array]:
    """Return interior extrema by parabolas through three samples."""
    inner = np.flatnonzero((y[1:-1] - y[:-2]) * (y[2:] - y[1:-1]) < 0) + 1
    if not len(inner):
        return np.zeros(0), np.zeros(0)
    low, mid, high = y[inner - 1], y[inner], y[inner + 1]
    shift = 0.5 * (low - high) / (low - 2 * mid + high)
    return x[inner] + shift * (x[1] - x[0]), mid - 0.25 * (low - high) * shift


def run_sheet_text(sheet: RunSheet) -> str:
    """Return the run sheet as a table."""
    lines = [
        f"{sheet.name}: {sheet.quantity} at {sheet.wavelength_nm:g} nm, {sheet.angle_deg:g} degrees, noise "
        f"{sheet.noise:g}",
        "  no  layer  material              nm   start %  turns    stop %   criterion            swing %   error nm",
    ]
    for number, each in enumerate(sheet.layers, start=1):
        swing = "" if each.swing_percent is None else f"{each.swing_percent:8.2f}"
        lines.append(
            f"  {number:2d}  {each.layer:5d}  {each.material[:16]:16s} {each.thickness_nm:8.2f} "
            f"{100 * each.signal[0]:8.3f} {len(each.turning_nm):6d} {100 * each.stop_signal:9.3f}   {each.stop:18s} "
            f"{swing:>9s} {each.thickness_error_nm:10.3f}"
        )
        for at, level in zip(each.turning_nm, each.turning_signal, strict=True):
            lines.append(f"        turning point at {at:8.2f} nm: {100 * level:.3f} %")
    return "\n".join(lines) + "\n"


def run_sheet_csv(sheet: RunSheet) -> str:
    """Return the curves: number, layer, material, layer thickness and of all, signal."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["number", "layer", "material", "grown_nm", "total_nm", sheet.quantity])
    total = 0.0
    for number, each in enumerate(sheet.layers, start=1):
        for grown, signal in zip(each.grown_nm, each.signal, strict=True):
            row = (number, each.layer, each.material, f"{grown:.4f}", f"{total + grown:.4f}", f"{signal:.7f}")
            writer.writerow(row)
        total += each.thickness_nm
    return stream.getvalue()


def run_sheet_document(sheet: RunSheet) -> dict[str, Any]:
    """Return the run sheet as JSON data."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.tolist()
        return None if isinstance(value, float) and not np.isfinite(value) else value

    layers = [{key: plain(value) for key, value in each.__dict__.items()} for each in sheet.layers]
    return {**{key: value for key, value in sheet.__dict__.items() if key != "layers"}, "layers": layers}
