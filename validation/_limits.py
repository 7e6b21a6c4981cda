"""Where each row's limit comes from: a source's own number or words, theory, statistics, or another code's accuracy.

For each script a list of (words that a claim contains, source); the first that fits counts, and "" fits all. The report
prints them under each table, and a test holds every row of the last run against them. *Bar* marks a number that was
asked of the work before it was done and is not derived; *word* marks a measure of ours for a source's word.
"""

from __future__ import annotations

import re
from typing import Any

ROUNDING = "theory: equal but for rounding, in double precision"
PAPER = "source's words; where they need a number, the script's docstring or the row gives it"
SOLVERS = "issue's quota, set before the cases were drawn"

LIMITS: dict[str, tuple[tuple[str, str], ...]] = {
    "film_anisotropy": (
        ("albedo", "theory: the smooth film; *bar*: 3 % are left to facets that mix angles"),
        ("width along y", "theory: the slopes' own widths; *bar*: 15 % are left to masking"),
    ),
    "film_anodised_titanium": (("", "the charts' voltages and the spread of the published rates, 1.6-2.5 nm a volt"),),
    "film_bragg": (
        ("half-spaces|peak reflectance", ROUNDING),
        ("", "theory (Yeh): closed form, to the step of the wavelengths or the width left by the finite stack"),
    ),
    "film_coated_glass": (("R \\+ T", ROUNDING), ("", "theory: orders of one film, to a wavelength step")),
    "film_metals": (
        ("against bulk|the same at", "theory: Beer's law, exp(-4 pi k d / lambda) of the film"),
        ("passes green", "the name green: 495-570 nm"),
        ("hue", "the metals' names of colour"),
    ),
    "film_morpho": (
        ("cuticle", "Wu and Zheng's words"),
        ("peak of the light|its height", "Vukusic et al. 1999, with their spread"),
        ("grating orders", "theory: the grating equation; half the width of an order of 60 ridges is 0.3 degrees"),
        ("peak of the fan", "the name blue: 440-495 nm"),
        ("isotropic lobe", "theory: no direction is marked"),
        ("", "Kinoshita et al. 2002: a fan across, a line along; *word*: by a factor"),
    ),
    "film_morpho_rcwa": (
        ("vector optics", "*bar*: dE00 3 and 1.5 degrees"),
        ("one cell|fmmax", "issue: two answers agree to 1 % in strong orders"),
        ("solved again", "rounding of the kept digits"),
        ("peak of the light|its height", "Vukusic et al. 1999, with their spread"),
        ("nacre's (peak|height)|half of the light", "statistics: spread of means of 20, half a wavelength step"),
        ("colour seen", "issue's classes of dE00 2, 5, 10; beyond 10 a relief is called outside"),
        ("peaks seen", "one step of the wavelengths"),
        ("halve", "issue: an improvement is taken when it halves the error"),
    ),
    "film_opaque_body": (("", "theory: Airy's formula; " + ROUNDING),),
    "film_soap_and_oil": (
        ("black", "theory: 4 r^2 sin^2 of the phase of 5 nm is 0.05 %; *word*: black is below 0.2 %"),
        ("quarter wave|in step|reflectance", "theory: two faces in step, at the eye's peak of 555 nm"),
        ("Newton", "Newton's scale, by neighbouring names of colour"),
        ("", "theory: faces that differ more leave less"),
    ),
    "film_temper_steel": (("", "the smiths' table: its order"),),
    "glass_balls": (
        ("open", "*word*: the reason is the greater half"),
        ("", "what the page on glass states to the user"),
    ),
    "glass_red": (("", "Magkiriadou et al. 2014: which of two is greater; *word*: saturated is below a half"),),
    "grating_errors": (("energy|reciprocity", "*bar*: 1e-8"), ("", "*bar*: 95 of 100 stated errors are not exceeded")),
    "grating_pillars": (
        ("largest difference", "*bar*: 4e-3 of gratings of two periods"),
        ("", "theory: a difference is at most the sum of both errors"),
    ),
    "metasurface_choice": (("", "*bar*: 0.12, up to which the mean field is taken, as of mixtures"),),
    "metasurface_critical_packing": (
        ("rms", "statistics: twice what the number of modes in a ring leaves"),
        ("energy|reciprocity", ROUNDING),
        ("samples as discs", "geometry: spheres around discs that do not meet"),
        ("", PAPER),
    ),
    "metasurface_ensembles": (
        ("130 to 260", "statistics: the standard error of 48 patterns"),
        ("straight line", "theory: edge over area; statistics: two standard errors"),
        ("standard errors", "statistics: two standard errors, and the other code's 4 %; *bar*: of 90 % of angles"),
        ("", "*bar*: 8 % each, 6 % on the mean, of relative L2"),
    ),
    "metasurface_mixtures": (("", "*bar*: of one kind, 0.12 of the mean field and 0.08 of the ensemble"),),
    "metasurface_order_and_model": (("QCA", "*bar*: 1 %"), ("", PAPER)),
    "metasurface_particles": (("", "*bar* above the reference's own convergence (shared particles.md, by particle)"),),
    "metasurface_published_series": (("", PAPER),),
    "metasurface_renders": (("converged", "dE00 1 is just noticeable"), ("vanishes", "theory; noise"), ("", PAPER)),
    "metasurface_silicon_and_halo": (("", PAPER),),
    "pearl_equal_time": (("", "Guillen et al. 2020, figure 15: which is better; standard errors over twelve seeds"),),
    "pearl_matrix": (("interference", "*word*: attenuated is below a half"), ("", PAPER)),
    "pearl_measured_materials": (("limits of its search", "Guillen et al., sec. 6.1"), ("", PAPER)),
    "pearl_parameter_panels": (("", PAPER),),
    "pearl_platelets": (("R \\+ T", ROUNDING), ("opaque", "theory: Beer's law"), ("", PAPER)),
    "pearl_renders": (("", "*word*: dE00 5 is a change that nobody misses"),),
    "pearl_stochastic_transmittance": (("", "a prototype's range"),),
    "pearl_texture": (
        ("standard errors", "statistics: 95.4 % of normal errors lie within two of them; *bar*: 0.9"),
        ("", "*bar*: 5 % for ratios, 10 and 60 CPU seconds for times"),
    ),
    "pearl_trends": (("", PAPER),),
    "pearl_turned_and_strata": (("R, ?T|foil of clear", "theory: energy; rough faces uncompensated"), ("", PAPER)),
    "relief_ablations": (("", PAPER),),
    "relief_ablations_designed": (("", PAPER),),
    "relief_designs": (
        ("median", "*bar*: 0.8 and 0.75 of the published losses"),
        ("", "the published design's own loss, under one model"),
    ),
    "relief_improvements": (("", "issue: an improvement is taken when it halves the error"),),
    "relief_published_renders": (("", "the published renders: half precision of their numbers, 0.001, and its tail"),),
    "relief_rcwa": (
        ("solved again", "rounding of the kept digits, and of linear algebra between machines"),
        ("plane waves", "issue: two answers agree to 1 % in strong orders"),
        ("coefficients", "rounding of the coefficients in the code"),
        ("dropped|scalar diffraction on all", "stated"),
        ("", SOLVERS),
    ),
    "tools_fit_recovery": (
        ("covers", "statistics: of 20 at 95 %, fewer than 17 come once in 60 times"),
        ("half width", "*bar*: what a maker's tolerance asks"),
    ),
    "tools_other_codes": (
        ("stacks$|random stacks", ROUNDING),
        ("free spheres", ROUNDING),
        ("on stacks", "the other code's truncation error"),
        ("hard disks", "statistics of the Monte Carlo; the closed form's own error of 0.02 at the highest packing"),
        ("slabs", "statistics: standard errors of the walk"),
    ),
    "tools_blender_extension": (("white", "dE00 1 is just noticeable"), ("", "stated")),
    "tools_tables_in_cycles": (("white", "dE00 1 is just noticeable"), ("", "stated")),
}


def source_of(script: str, claim: object) -> str | None:
    """Where the limit of a row comes from; None: nothing is known of it."""
    for words, source in LIMITS.get(script, ()):
        if re.search(words, str(claim)):
            return source
    return None


def sources(script: str, rows: list[dict[str, Any]]) -> list[str]:
    """The sources of a script's limits, each once, in the order of its rows."""
    return list(dict.fromkeys(found for each in rows if (found := source_of(script, each["claim"])) is not None))
