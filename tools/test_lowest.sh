#!/usr/bin/env bash
# Run a part of the tests with the lowest versions of all direct dependencies that pyproject.toml allows.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=.venv-lowest
[ -x "$venv/bin/uv" ] || { python3 -m venv "$venv"; "$venv/bin/pip" install -q uv; }
"$venv/bin/uv" pip install -q --python "$venv/bin/python" --resolution lowest-direct -e '.[study]' \
  'pytest>=8' 'pytest-timeout>=2.3' 'hypothesis>=6.100' 'mpmath>=1.3' 'tmm>=0.1.8' 'colour-science>=0.4.6'
export NUMBA_CACHE_DIR=$PWD/$venv/numba  # kernels of another numba would replace those of .venv
# old releases warn of the newest ones of packages below them
"$venv/bin/python" -m pytest -q -W "ignore::DeprecationWarning" -m "not full and not render" -p no:cacheprovider \
  tests/recipe tests/fingerprint tests/light tests/film tests/bsdf tests/study/test_study_sweep.py \
  tests/study/test_study_fit.py tests/design/test_searches.py tests/stack/test_stack_robust.py \
  tests/metasurface/test_metasurface_ensemble.py --ignore tests/recipe/test_schema.py "$@"
