#!/usr/bin/env python3
"""Build .venv-bench, the environment of the benchmarks' peers (tmm_fast with torch, pyElli), once.

It is apart from .venv because torch is large and nacre must not come to depend on it. A second run returns at
once unless benchmarks/requirements.txt has changed.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = ROOT / ".venv-bench"
REQUIREMENTS = ROOT / "benchmarks" / "requirements.txt"


def main(arguments: list[str] | None = None) -> int:
    """Create the environment; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pip-args", default="", help="more arguments for pip install, in one string")
    options = parser.parse_args(arguments)
    stamp = ENVIRONMENT / ".requirements"
    wanted = REQUIREMENTS.read_text(encoding="utf-8")
    if stamp.exists() and stamp.read_text(encoding="utf-8") == wanted:
        return 0
    if not (ENVIRONMENT / "bin" / "python").exists():
        venv.create(ENVIRONMENT, with_pip=True)
    command = [str(ENVIRONMENT / "bin" / "python"), "-m", "pip", "install", "--quiet", "-r", str(REQUIREMENTS)]
    status = subprocess.run([*command, *shlex.split(options.pip_args)], check=False).returncode
    if status != 0:
        print("bench_env: pip could not install the peers; see its message above", file=sys.stderr)
        return status
    stamp.write_text(wanted, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
