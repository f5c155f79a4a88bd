# `make demo` runs the whole way on embedded objects, `make test` passes the checks and tests.
# Both need only Python >= 3.11 with pip and venv.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

# One interpreter of each version at hand: on the path, or pyenv's.
PYTHONS = $(shell for version in 3.11 3.12 3.13 3.14; do \
	for python in python$$version $(HOME)/.pyenv/versions/$$version.*/bin/python$$version; do \
		$$python --version >/dev/null 2>&1 && command -v $$python && break; done; done; true)

.PHONY: demo test check unit test-all test-exports test-release test-browser docs bench bench-full soak lock clean

demo: $(READY)
	$(BIN)/mechsearch demo --out demo

test: check unit

check: $(READY)
	$(BIN)/ruff format --check src tests examples benchmarks soak docs
	$(BIN)/ruff check src tests examples benchmarks soak docs
	$(BIN)/mypy
	$(BIN)/lint-imports

unit: $(READY)
	$(BIN)/python -m pytest -n auto

# Every Python at hand, each with an environment of its own.
test-all:
	@for python in $(PYTHONS); do \
		echo "== $$python"; \
		$(MAKE) --no-print-directory unit PYTHON=$$python VENV=.venv-$${python##*python} || exit 1; \
	done

# LeRobot (Python 3.12 or newer) and Minari, each in an environment of its own, open what is exported for them.
test-exports: $(VENV)-lerobot/.ready $(VENV)-minari/.ready
	MECHSEARCH_LEROBOT=$(VENV)-lerobot/bin/python MECHSEARCH_MINARI=$(VENV)-minari/bin/python \
		$(BIN)/python -m pytest tests/exports

$(VENV)-lerobot/.ready: PACKAGES := lerobot[dataset]==0.6.1
$(VENV)-minari/.ready: PACKAGES := minari[arrow]==0.5.4 pillow
$(VENV)-%/.ready: $(READY)
	$(BIN)/uv venv --quiet --clear --python $(firstword $(filter-out %3.11,$(PYTHONS)) python3) $(@D)
	$(BIN)/uv pip install --quiet --python $(@D)/bin/python $(PACKAGES)
	touch $@

# Wheel and source archive on every Python at hand, each with optional parts in an environment of its own.
test-release: $(READY)
	rm -rf dist
	$(BIN)/hatchling build
	cd packaging/robot && $(abspath $(BIN))/hatchling build -t wheel -d ../../dist/robot
	$(BIN)/mechsearch export policy uncover --out dist/robot/uncover
	tests/release.sh $(BIN)/uv requirements.txt dist $(PYTHONS)

# The pages of `mechsearch show` and `view` in a real browser without a screen.
test-browser: $(VENV)/.browser-ready
	$(BIN)/python -m pytest tests/browser

$(VENV)/.browser-ready: $(READY) tests/browser/requirements.txt
	$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --require-hashes -r tests/browser/requirements.txt
	touch $@

# A site in docs/_build/html that can be opened as a file; it asks nobody outside.
docs: $(VENV)/.docs-ready
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet \
		--doctree-dir docs/_build/doctrees docs docs/_build/html
	$(BIN)/python docs/offline.py docs/_build/html

$(VENV)/.docs-ready: $(READY) docs/requirements.txt
	$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --require-hashes -r docs/requirements.txt
	touch $@

# About twenty minutes on two cores; `bench-full` adds the paper's heap sets and training runs.
bench: $(READY)
	$(BIN)/python -m benchmarks

# Half an hour on two cores: many actions, and processes killed at random times.
soak: $(READY)
	$(BIN)/python -m soak

bench-full: $(READY)
	$(BIN)/python -m benchmarks --full

$(READY): requirements.txt pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("mechsearch needs Python 3.11 or newer, not " + sys.version.split()[0]) if sys.version_info < (3, 11) else 0'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps --editable .
	touch $(READY)

# Versions and hashes of everything, for all supported Pythons.
lock: $(READY)
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-header --python-version 3.11 \
		--all-extras --group dev --group arms --output-file requirements.txt pyproject.toml
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-header --no-annotate --python-version 3.11 \
		--group docs --constraints requirements.txt --output-file docs/requirements.txt \
		$$(sed -n 's/^\([a-z0-9_.-]*\)==.*/--no-emit-package \1/p' requirements.txt)
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-header --no-annotate --python-version 3.11 \
		--group browser --output-file tests/browser/requirements.txt

clean:
	rm -rf $(VENV) demo dist docs/_build
