#!/usr/bin/env bash
# Make the checkout ready: a virtual environment with pinned packages, a libLLVM that Mitsuba can use, and a chromium
# for the tests of the studio's page.
# Safe to run again: it returns at once when nothing has changed.
set -euo pipefail
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
stamp=.venv/.nacre-stamp
wanted=$(cat pyproject.toml constraints.txt tools/setup.sh tools/get_llvm.sh tools/get_chromium.sh | cksum)

if [ ! -f "$stamp" ] || [ "$(cat "$stamp")" != "$wanted" ]; then
    "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
        echo "nacre needs Python 3.11 or newer; $("$python" --version 2>&1) was found. Set PYTHON=python3.11 or newer." >&2
        exit 2
    }
    if [ ! -x .venv/bin/python ] || ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
        echo "setup: making the virtual environment .venv"
        rm -rf .venv
        # Debian packs ensurepip apart: without it, make the environment bare and let the outer pip fill it
        "$python" -m venv .venv >/dev/null 2>&1 || {
            rm -rf .venv
            "$python" -m venv --without-pip .venv
            "$python" -m pip --python .venv/bin/python install -q pip
        }
    fi
    echo "setup: installing the pinned packages (a few minutes the first time)"
    .venv/bin/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[study,test]' \
        2> >(grep -v 'is ignored: it is neither a file' >&2)
    bash tools/get_llvm.sh
    bash tools/get_chromium.sh
    echo "$wanted" > "$stamp"
    echo "setup: ready"
elif [ ! -e .llvm/ok ]; then
    bash tools/get_llvm.sh
fi
