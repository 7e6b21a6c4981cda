#!/usr/bin/env python3
"""Build an environment of peers, once: .venv-bench of the benchmarks (tmm_fast with torch, pyElli, optiland), or
.venv-validate of the validation (fmmax with JAX).

They are apart from .venv because torch and JAX are large and nacre must not come to depend on them. A second run
returns at once unless the folder's requirements.txt has changed.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENTS = {"benchmarks": ROOT / ".venv-bench", "validation": ROOT / ".venv-validate"}


def main(arguments: list[str] | None = None) -> int:
    """Create the environment; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", choices=ENVIRONMENTS, default="benchmarks", help="whose peers")
    parser.add_argument("--pip-args", default="", help="more arguments for pip install, in one string")
    options = parser.parse_args(arguments)
    environment, requirements = ENVIRONMENTS[options.folder], ROOT / options.folder / "requirements.txt"
    stamp = environment / ".requirements"
    wanted = requirements.read_text(encoding="utf-8")
    if stamp.exists() and stamp.read_text(encoding="utf-8") == wanted:
        return 0
    if not (environment / "bin" / "python").exists():
        venv.create(environment, with_pip=True)
    command = [str(environment / "bin" / "python"), "-m", "pip", "install", "--quiet", "-r", str(requirements)]
    status = subprocess.run([*command, *shlex.split(options.pip_args)], check=False).returncode
    if status != 0:
        print("bench_env: pip could not install the peers; see its message above", file=sys.stderr)
        return status
    stamp.write_text(wanted, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
