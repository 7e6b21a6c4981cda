# Everything a checkout needs; each target sets up what it uses.
SHELL := /bin/bash
PY := .venv/bin/python
export NACRE_PROJECT := $(CURDIR)

.PHONY: setup demo test test-full test-gpu test-lowest coverage mutants fuzz lint style docs bench validate wheel release clean

setup:
	@bash tools/setup.sh

demo: setup
	@$(PY) -m nacre demo $(if $(QUICK),--quick) $(if $(OUT),--out $(OUT))

# types are checked beside the tests; both must pass
test: setup style
	@log=$$(mktemp); $(PY) -m mypy >$$log 2>&1 & types=$$!; \
	$(PY) -m pytest -q -m "not full and not gpu" -n 2 --dist worksteal; tests=$$?; \
	wait $$types; types=$$?; cat $$log; rm -f $$log; exit $$((tests | types))

test-full: setup
	@$(PY) -m pytest -q -m "full and not gpu" -n 2 --dist worksteal --durations=25

# a part of the tests with the lowest allowed versions of all dependencies, in an environment of its own
test-lowest:
	@bash tools/test_lowest.sh

# the tests of the device on an NVIDIA GPU, those of single families too; `make test-gpu WORKERS=12`
test-gpu: setup
	@NACRE_VARIANT=cuda_ad_spectral $(PY) -m pytest -q -m "(render or gpu) and not full" -n $(or $(WORKERS),2) --dist worksteal \
	  tests/render_plugins tests/film tests/blend tests/pearl tests/metasurface tests/relief tests/glass tests/grating \
	  tests/render_scenes/test_pictures.py tests/render_scenes/test_polarised_pictures.py tests/render_scenes/test_paths.py

# lines of src/nacre that the quick suite reaches, in all its processes; fails below the bar of pyproject.toml
coverage: setup
	@rm -rf build/coverage && mkdir -p build/coverage
	@$(PY) -W ignore -m coverage run -m pytest -q -m "not full and not gpu" -n 2 --dist worksteal
	@$(PY) -m coverage combine -q
	@$(PY) -m coverage report --skip-covered --sort=cover

# small errors in the physics, and how many the tests notice: an hour of one core; a second run goes on where one stopped
mutants: setup
	@$(PY) -m tools.mutants $(if $(AGAIN),--again)

# 20,000 broken and random inputs, an hour or less on 2 cores; a second run goes on where one stopped
fuzz: setup
	@$(PY) -m tools.fuzz $(if $(COUNT),--count $(COUNT)) $(if $(SEED),--seed $(SEED)) $(if $(AGAIN),--again)

lint: style
	@$(PY) -m mypy

style: setup
	@$(PY) -m ruff check src tests benchmarks validation tools examples
	@$(PY) -m ruff check --select C901,PLR0913 src
	@$(PY) -m ruff format --check src tests benchmarks validation tools examples

bench validate: export NACRE_CACHE = off
# what validation measures is raw; a benchmark takes pictures as users get them
validate: export NACRE_DENOISE = 0

bench: setup
	@$(PY) tools/bench_env.py
	@$(PY) -m benchmarks $(if $(ALL),--all)

validate: setup
	@$(PY) tools/bench_env.py validation || true
	@$(PY) -m validation

wheel: setup
	@$(PY) -m build --wheel --no-isolation

# sdist and wheel in dist/, the same bytes from two builds, checked, installed and run in empty environments
release: setup
	@$(PY) -m tools.release $(if $(SIZES),--sizes)

docs: setup
	@$(PY) -c 'import furo, myst_nb' 2>/dev/null || \
		$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@$(PY) -m sphinx -W --keep-going -b html docs docs/_build/html

clean:
	rm -rf .venv .venv-lowest .llvm .venv-bench .venv-validate .venv-mutants .venv-cycles build dist docs/_build
