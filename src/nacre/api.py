"""The verbs of nacre for Python: the same words as on the command line.

`nacre.load`, `nacre.material`, `nacre.evaluate`, `nacre.spectrum`; pictures come from `nacre.render`, figures
from `nacre.plot`, structures from `nacre.design`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre._version import __version__
from nacre.bsdf import Bsdf
from nacre.bsdf.masked import MaskedLobe
from nacre.errors import RecipeError, UnsupportedError
from nacre.recipe import Material

Array = NDArray[np.float64]
PLOT_SAMPLES = 1024  # the same for a pixel of a figure, the least; a figure of few pairs takes more ...
PLOT_WALKS = 1 << 16  # ... up to so many together
MOST_SAMPLES = 1 << 14
DIRECTIONAL_KINDS = ("slice", "lobe", "tracks")
DEFAULT_SAMPLES = 4096  # paths a direction pair of a stochastic lobe: about 2 % noise for a broad lobe


class HasBsdf(Protocol):
    """Anything that answers with a Bsdf: a material, or a wing's own object."""

    def bsdf(self) -> Bsdf:
        """Return the arrays."""
        ...


def as_bsdf(thing: HasBsdf | Bsdf | str | Path) -> Bsdf:
    """Return the Bsdf of a material, a Bsdf, a recipe's path or a `.nacre` file.

    Raises:
        NacreError: the file is not a material.
    """
    if isinstance(thing, Bsdf):
        return thing
    if isinstance(thing, str | Path):
        from nacre.recipe import load

        return load(thing).bsdf()
    return thing.bsdf()


def evaluate(
    thing: HasBsdf | Bsdf | str | Path,
    wi: ArrayLike,
    wo: ArrayLike,
    *,
    uv: ArrayLike | None = None,
    samples: int | None = None,
    seed: int = 0,
) -> Array:
    """Return the non-delta BSDF, `[..., wavelength]`, in 1/sr, without the cosine.

    Args:
        thing: a material, a Bsdf, or the path of a recipe or `.nacre` file.
        wi: unit vectors to the light, `[..., 3]`, in the local frame (z is the normal).
        wo: unit vectors to the eye, `[..., 3]`; on the other side of the surface: the radiance BTDF.
        uv: surface coordinates `[..., 2]` for materials that vary over the surface; default: (0.5, 0.5).
        samples: paths a pair, for lobes that are evaluated by a random walk; seed: of that walk.

    Raises:
        UnsupportedError: a stochastic lobe, and no LLVM on this machine.
    """
    return evaluate_with_error(as_bsdf(thing), wi, wo, uv=uv, samples=samples, seed=seed)[0]


def evaluate_with_error(
    bsdf: Bsdf,
    wi: ArrayLike,
    wo: ArrayLike,
    *,
    uv: ArrayLike | None = None,
    samples: int | None = None,
    seed: int = 0,
) -> tuple[Array, Array | None]:
    """Return the values of `evaluate` and, where a lobe is stochastic, their standard error (else None).

    Raises:
        UnsupportedError: as `evaluate`.
    """
    wi_array, wo_array = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
    if wi_array.shape[-1:] != (3,):
        raise UnsupportedError(f"wi and wo have shape {list(wi_array.shape)}; the last axis must be 3")
    uv_array = None if uv is None else np.asarray(uv, dtype=float)
    total = np.zeros((*wi_array.shape[:-1], len(bsdf.wavelengths_nm)))
    variance: Array | None = None
    for lobe in bsdf.lobes:
        if lobe.is_stochastic:
            # a masked walk is walked bare and dimmed after
            share: Array | float = 1.0
            while isinstance(lobe, MaskedLobe):
                share = share * lobe.share(uv_array, wi_array.shape[:-1])[..., None]
                lobe = lobe.inner
            from nacre.bsdf.layered import Layered
            from nacre.render.plugins.layered import evaluate_layered

            assert isinstance(lobe, Layered)  # the only walk there is
            values, error = evaluate_layered(
                lobe, wi_array, wo_array, samples=samples or DEFAULT_SAMPLES, seed=seed, uv=uv_array
            )
            error = error * share
            variance = error**2 if variance is None else variance + error**2
            total = total + values * share
        else:
            total = total + lobe.evaluate(wi_array, wo_array, uv_array)
    return total, None if variance is None else np.sqrt(variance)


def spectrum(
    thing: Material | str | Path,
    angles_deg: ArrayLike = 0.0,
    wavelengths_nm: ArrayLike | None = None,
    polarisation: str = "both",
) -> Any:
    """Return reflectance and transmittance of a material as a `Spectrum`, each part `[angle, wavelength]`.

    Raises:
        NacreError: the recipe is wrong, or an optical constant is not known at a wavelength.
    """
    from nacre.recipe import load

    material = load(thing) if isinstance(thing, str | Path) else thing
    return material.spectrum(np.radians(np.atleast_1d(angles_deg)), wavelengths_nm, polarisation)


def plot_material(
    material: Material,
    kind: str,
    path: str | Path,
    *,
    angles_deg: ArrayLike | None = None,
    wavelengths_nm: ArrayLike | None = None,
    illuminant: str = "D65",
    over: tuple[str, Sequence[float] | Array] | None = None,
) -> None:
    """Draw a figure of a material into a PNG, PDF or SVG that carries the recipe; kinds: `nacre.plot.KINDS`.

    `over` names a number of the recipe and its values, for "tracks". Figures over directions show the noise-free
    form (`quality = "fast"`) of a material that has one, unless its recipe names a quality.

    Raises:
        UnsupportedError: the material has no such figure.
        NacreError: the recipe is wrong, or the file cannot be written.
    """
    from nacre.plot import save_material

    save_material(
        as_drawn(material, kind, over), kind, path, angles_deg=angles_deg, wavelengths_nm=wavelengths_nm,
        illuminant=illuminant, over=over, provenance=recipe_provenance(material), evaluate=plot_walk,
    )  # fmt: skip


def recipe_provenance(material: Material) -> dict[str, Any]:
    """Return what a file made from a recipe tells of its origin."""
    return {"nacre": __version__, "source": Path(material.context.source).name, "recipe": material.context.text}


def as_drawn(material: Material, kind: str, over: object = None) -> Material:
    """Return the material as a figure shows it: over directions noise-free, where its family and recipe allow it.

    Over a number every step would be baked anew; there the few walks are the shorter way.
    """
    if kind not in DIRECTIONAL_KINDS or over is not None or "quality" in material.data:
        return material
    try:
        return material.vary({"quality": "fast"})
    except RecipeError:  # a family that knows no such choice
        return material


def plot_walk(bsdf: Bsdf, wi: Array, wo: Array) -> Array:
    """Evaluate for a figure: lobes that are random walks get the fewer samples the more pairs there are."""
    pairs = max(1, int(np.prod(np.shape(wi)[:-1])))
    return evaluate_with_error(bsdf, wi, wo, samples=int(np.clip(PLOT_WALKS // pairs, PLOT_SAMPLES, MOST_SAMPLES)))[0]
