"""Noise of the pearl walk at equal time: without and with multiple importance sampling, one wavelength against four.

Guillen et al. 2020, figure 15, shows that both matter and gives no numbers. A lone sphere under the studio's soft
boxes or under thin tubes, one scattering event, so that each path asks the material once and one wavelength can stand
for four. The switches: "next event" gives full weight to next-event estimation, "walk alone"
gives it to the random walk, "both" weights them as the product does. One wavelength: the walk uses the first
and carries all of the weight; it costs the same table reads as four here, where a walk written for one would save
some, so equal numbers of paths are compared too. Errors are mean squares over the sphere's pixels against a long
render, over twelve seeds; times are CPU seconds of the same renders, taken in turns.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from validation._pearl import EXAMPLES, Array, material_of
from validation._rows import finish, row

RUNS = (("bottle2", "studio"), ("bottle3", "studio"), ("bottle8", "studio"), ("bottle8", "line"))
SIDE, SPP, SEEDS, LONG_SPP = 64, 16, 12, 512
SWITCHES = ("next event", "walk alone", "both, one wavelength", "both")


class OneWavelength:
    """A plugin that sees the first wavelength of a ray alone; it carries the weight of all four."""

    def __init__(self, plugin: Any) -> None:
        self.plugin = plugin

    def __getattr__(self, name: str) -> Any:
        return getattr(self.plugin, name)

    def _one(self, si: Any) -> Any:
        import mitsuba as mi

        other = mi.SurfaceInteraction3f(si)
        other.wavelengths = mi.Spectrum(si.wavelengths[0])
        return other

    def _weight(self, value: Any) -> Any:
        import mitsuba as mi

        return mi.Spectrum(4.0 * value[0], 0.0, 0.0, 0.0)

    def sample(self, ctx: Any, si: Any, *rest: Any) -> Any:
        """Sample by the first wavelength."""
        bs, weight = self.plugin.sample(ctx, self._one(si), *rest)
        return bs, self._weight(weight)

    def eval(self, ctx: Any, si: Any, *rest: Any) -> Any:
        """Evaluate at the first wavelength."""
        return self._weight(self.plugin.eval(ctx, self._one(si), *rest))

    def eval_pdf(self, ctx: Any, si: Any, *rest: Any) -> Any:
        """Evaluate at the first wavelength."""
        value, pdf = self.plugin.eval_pdf(ctx, self._one(si), *rest)
        return self._weight(value), pdf


def switched(bsdf: Any, switch: str) -> Any:
    """The material's BSDF with one of the switches set."""
    from nacre.device.bsdf import make_bsdf
    from nacre.device.plugin import opaque

    made = make_bsdf(bsdf, two_sided=True)
    plugin = made.plugins[0]
    if switch == "next event":
        plugin.proxy.trust = opaque(0.0)
    elif switch == "walk alone":
        plugin.proxy.trust = opaque(1e6)
    elif switch == "both, one wavelength":
        made.plugins[0] = OneWavelength(plugin)
    return made


class Sphere:
    """A lone sphere under a light, and its pixels."""

    def __init__(self, light: str) -> None:
        from nacre.device.variant import use_variant
        from nacre.picture.built_scene import BuiltScene
        from nacre.picture.emitters import make_light
        from nacre.picture.scenes import SCENES, Part, Scene

        self.mi = use_variant()
        shape = Part({"type": "sphere", "center": [0.0, 0.0, 1.0], "radius": 1.0})
        scene = Scene("lone", lambda: [shape], SCENES["sphere"].view, "none")
        self.stage = BuiltScene(scene, make_light(light), see_through=False)
        film = {"type": "hdrfilm", "pixel_format": "xyz", "rfilter": {"type": "box"}}
        self.sensor = self.stage.sensor(scene.view, (SIDE, SIDE), film)
        self.integrator = self.mi.load_dict({"type": "path", "max_depth": 2})
        shots = [self.shot(self.mi.load_dict({"type": "diffuse", "reflectance": {"type": "uniform", "value": a}}), 4, 0)
                 for a in (0.0, 0.9)]  # fmt: skip
        self.pixels = (shots[1] - shots[0])[..., 1] > 1e-6

    def shot(self, material: Any, spp: int, seed: int) -> Array:
        """One render, `[row, column, 3]` of XYZ."""
        self.stage.set_material(material)
        picture = self.mi.render(self.stage.mitsuba_scene, sensor=self.sensor, integrator=self.integrator, spp=spp,
                                 seed=seed)  # fmt: skip
        return np.array(picture, dtype=float)


def measure(sphere: Sphere, name: str) -> tuple[dict[str, dict[str, Any]], Array]:
    """Error, time and a picture of each switch, and the long render."""
    bsdf = material_of(EXAMPLES / f"{name}.toml").bsdf()
    made = {switch: switched(bsdf, switch) for switch in SWITCHES}
    passes = [sphere.shot(made["both"], 64, 1000 + i) for i in range(LONG_SPP // 64)]
    reference = np.mean(passes, axis=0)
    for material in made.values():
        sphere.shot(material, SPP, 0)  # compiles
    shots: dict[str, list[Array]] = {switch: [] for switch in SWITCHES}
    seconds: dict[str, list[float]] = {switch: [] for switch in SWITCHES}
    for seed in range(1, SEEDS + 1):
        for switch, material in made.items():
            start = time.process_time()
            shots[switch].append(sphere.shot(material, SPP, seed))
            seconds[switch].append(time.process_time() - start)
    found = {}
    scale = reference[sphere.pixels][:, 1].mean()
    for switch, taken in shots.items():
        off = np.stack([(shot - reference)[sphere.pixels] for shot in taken]) / scale
        mean = np.stack(taken).mean(axis=0)[sphere.pixels][:, 1].mean() / scale
        error = np.mean(off**2, axis=1)  # of each seed
        found[switch] = {"xyz": error.sum(axis=1), "y": error[:, 1], "bias": float(mean - 1.0),
                         "noise": float(np.std([shot[sphere.pixels][:, 1].mean() for shot in taken]) / scale
                                        / np.sqrt(SEEDS)),
                         "seconds": float(np.median(seconds[switch])), "shot": taken[0]}  # fmt: skip
    return found, reference


def compare_rows(results: dict[str, dict[str, dict[str, Any]]], figure: str) -> list[dict[str, Any]]:
    """Ask for the importance of each technique, and that none shifts the mean."""

    def ratios(switch: str, what: str, timed: bool = True) -> tuple[list[float], list[float], str]:
        """Of the variances, their standard errors, and both as text."""
        found, errors, words = [], [], []
        for result in results.values():
            one, both = result[switch], result["both"]
            cost = one["seconds"] / both["seconds"] if timed else 1.0
            found.append(cost * one[what].mean() / both[what].mean())
            relative = [np.std(r[what]) / r[what].mean() / np.sqrt(SEEDS - 1) for r in (one, both)]
            errors.append(found[-1] * float(np.hypot(*relative)))
            words.append(f"{found[-1]:.2f} +- {errors[-1]:.2f}")
        return found, errors, ", ".join(words)

    rows = []
    names = "; ".join(results)
    single = {switch: ratios(switch, "xyz") for switch in ("next event", "walk alone")}
    # the balance of two methods promises to be about as good as the better one, and so far from the worse
    scenes = [[(s[0][i], s[1][i]) for s in single.values()] for i in range(len(results))]
    margins = [value + 2.0 * error for value, error in map(min, scenes)]
    text = "; ".join(f"{switch} {s[2]}" for switch, s in single.items())
    rows.append(row(f"MIS matters: never worse than the better single method, variance at equal time ({names})",
                    "ratio to both at least 1 within two standard errors", text, min(margins) >= 1.0,
                    figure))  # fmt: skip
    far = [max(scene)[0] for scene in scenes]
    rows.append(row(f"MIS matters: far better than the worse single method in each scene ({names})",
                    "ratio above 2 in each", ", ".join(f"{value:.1f}" for value in far), min(far) > 2.0,
                    figure))  # fmt: skip
    for timed, word in ((True, "time"), (False, "number of walks")):
        values, _, text = ratios("both, one wavelength", "xyz", timed)
        grey = ratios("both, one wavelength", "y", timed)[2]
        rows.append(row(f"hero wavelengths matter: variance of one over four, equal {word} ({names})", "above 1",
                        f"{text}; luminance {grey}", min(values) > 1.0, figure))  # fmt: skip
    worst = max(abs(r[s]["bias"]) / (r[s]["noise"] + r["both"]["noise"] + 1e-12) for r in results.values() for s in r)
    rows.append(row("all four converge to one picture: mean luminance of the sphere", "within 4 standard errors",
                    f"{worst:.1f} at most; off by " + ", ".join(
                        f"{max(abs(r[s]['bias']) for s in r):.2%}" for r in results.values()), worst < 4.0,
                    figure))  # fmt: skip
    return rows


def draw(results: dict[str, tuple[dict[str, dict[str, Any]], Array]], out: Path, figure: str) -> None:
    """Tiles of one seed each, with error and time, beside the long render."""
    from matplotlib import pyplot

    from nacre.light import clip_to_srgb, srgb_encode, xyz_to_srgb_linear

    page, axes = pyplot.subplots(len(results), len(SWITCHES) + 1, figsize=(11, 2.45 * len(results)))
    for line, (name, (found, reference)) in zip(axes, results.items(), strict=True):
        tiles = {f"{name}, {LONG_SPP} spp": reference}
        for switch, data in found.items():
            cost = data["seconds"] / found["both"]["seconds"]
            ratio = cost * data["xyz"].mean() / found["both"]["xyz"].mean()
            tiles[f"{switch}\n{data['seconds']:.2f} s, var x time {ratio:.1f}"] = data["shot"]
        for axis, (title, xyz) in zip(line, tiles.items(), strict=True):
            axis.imshow(np.clip(srgb_encode(clip_to_srgb(xyz_to_srgb_linear(np.maximum(xyz, 0) * 1.4)).rgb), 0, 1))
            axis.set_title(title, fontsize=7)
            axis.set_axis_off()
    page.tight_layout()
    finish(page, out, figure, dpi=120)


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Measure, draw, return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    figure = "pearl_equal_time.png"
    results = {f"{name}, {light}": measure(Sphere(light), name) for name, light in RUNS}
    rows = compare_rows({name: found for name, (found, _) in results.items()}, figure)
    draw(results, Path(out_dir), figure)
    return rows


if __name__ == "__main__":
    main(Path(__file__).resolve().parent / "figures" / Path(__file__).stem)
