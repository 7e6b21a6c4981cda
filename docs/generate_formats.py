"""The table of file formats, from the registry of readers."""

from __future__ import annotations

# format -> real files of it in public repositories, with independent readings, that the tests read or refuse by name
REAL_FILES = {
    "accurion": 2, "al3d": 1, "alta": 1, "asd-text": 1, "ase": 3, "aster": 1, "avantes-binary": 1,
    "avantes-text": 3, "bruker-dpt": 1, "cgats": 5, "craic-text": 1, "cxf": 1, "film-sense": 1, "gonio": 2,
    "grams-spc": 1, "gwyddion-text": 2, "holography": 1, "ibw": 1, "icc-text": 2, "jasco-text": 2, "jcamp": 2,
    "lamp": 1, "licor-prn": 1, "matrix": 1, "nanoscope": 1, "netcdf": 1, "nexus-dispersion": 1,
    "nexus-ellipsometry": 1, "ocean-text": 4, "palette": 1, "perkinelmer-text": 3, "profile": 2, "regress-pro": 1,
    "sdf": 1, "spd-pair": 1, "spectraray": 2, "spectrum-table": 7, "speos": 1, "table": 8, "tmatrix": 4, "tmd": 1,
    "woollam-dat": 1, "woollam-intensity": 1, "woollam-mat": 1, "woollam-text": 4, "wsxm": 1, "xyz": 1, "zemax": 1,
    "zemax-coating": 1,
}  # fmt: skip
# format -> further files of public source packages that were read, or refused for the right reason, in a trial of
# November 2026; the JCAMP-DX spectra agree with the package jcamp, the others were compared with their text or program
TRIED = {
    "accurion": 4, "cgats": 1, "grams-spc": 24, "gwy": 1, "ibw": 12, "jasco-jws": 3, "jcamp": 144, "jpk": 2, "lamp": 5,
    "nexus-dispersion": 6, "nexus-ellipsometry": 5, "opus": 1, "perkinelmer-sp": 2, "spectraray": 3,
    "spectrum-table": 15, "topostats": 2, "woollam-dat": 5, "woollam-mat": 1, "woollam-text": 17, "wsxm": 4,
}  # fmt: skip
# format -> how nacre writes it
WRITTEN = {
    "rgl": "`nacre export --to rgl`", "merl": "`nacre export --to merl`", "zemax": "`nacre export --to zemax`",
    "astm_e1392": "`nacre export --to astm`", "brdf_json": "`nacre export --to brdf-json`",
    "speos": "`nacre export --to speos`", "gonio": "`nacre export --to csv`", "table": "`nacre read -o`",
    "nacre-heights": "`nacre fabricate --to csv`", "nacre-table": "`nacre orders`, `fabricate`, `design --many`",
    "tmatrix": "`nacre export --to tmat`",
}  # fmt: skip
KINDS = {
    "ellipsometry": "Ellipsometry", "constants": "Optical constants", "spectrum": "Spectra", "heights": "Height maps",
    "colours": "Colours", "bsdf": "BRDF and BSDF", "tmatrix": "T-matrices", "table": "Tables",
}  # fmt: skip


def page() -> str:
    """Return the page of all formats that nacre reads, by kind."""
    from nacre.readers.registry import FORMATS

    lines = [
        "# File formats", "",
        "Formats that `nacre read`, recipes, targets and fits recognise by content. *Real files* counts files of "
        "instruments and programs with an independent reading, which the tests read or refuse by name; small files of "
        "the same form are tested for each format. *Further files* were tried once and are not in the tests: public "
        "source packages contain them. "
        "{doc}`/howto/read` says how to read and how to add a format.", "",
    ]  # fmt: skip
    for kind, title in KINDS.items():
        entries = [entry for entry in FORMATS if entry.kind == kind]
        if entries:
            lines += [
                f"## {title}",
                "",
                "| format | `--format` | written by | real files | further files |",
                "|---|---|---|---|---|",
            ]
            for entry in sorted(entries, key=lambda entry: entry.title.lower()):
                count = REAL_FILES.get(entry.id, 0)
                cells = entry.title, f"`{entry.id}`", WRITTEN.get(entry.id, ""), count or "", TRIED.get(entry.id, "")
                lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
            lines.append("")
    return "\n".join(lines)
