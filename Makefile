# Python >= 3.11 and make are all that a fresh clone needs; everything else goes into .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# Touched once the extras are installed; a change of pyproject.toml installs them again.
DEMO_STAMP := $(VENV)/.stamp-core
TEST_STAMP := $(VENV)/.stamp-test
LINT_STAMP := $(VENV)/.stamp-lint
BENCH_STAMP := $(VENV)/.stamp-bench
BROWSER_STAMP := $(VENV)/.stamp-browser
DASK_STAMP := $(VENV)/.stamp-dask
MITSUBA_STAMP := $(VENV)/.stamp-mitsuba
SCANS_STAMP := $(VENV)/.stamp-scans
RELEASE_STAMP := $(VENV)/.stamp-release
DOCS_STAMP := $(VENV)/.stamp-docs
MINUTES ?= 60
# Workers share the cores: threads of linear algebra would wait for those of other workers, busily.
PYTEST_WORKERS := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile

export PIP_DISABLE_PIP_VERSION_CHECK := 1

.DEFAULT_GOAL := help
.PHONY: help demo env test test-slow test-browser test-dask test-mitsuba test-scans soak fuzz test-lowest test-newest test-prerelease release-check lint bench docs clean
# A stamp must not outlive an installation that failed.
.DELETE_ON_ERROR:

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-15s  %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(DEMO_STAMP) ## render the example pictures into demo/
	$(BIN)/warpdiff demo --output demo

env: $(TEST_STAMP) $(LINT_STAMP) ## install what tests and checks need into .venv, and run nothing

test: $(TEST_STAMP) ## run the tests
	$(PYTEST_WORKERS)

test-slow: $(TEST_STAMP) ## run the cases that take too long for make test
	$(PYTEST_WORKERS) -m slow

test-browser: $(BROWSER_STAMP) ## test pages; needs Chromium (Debian: apt-get install chromium)
	@test -n "$$CHROMIUM" || command -v chromium google-chrome >/dev/null || { echo "error: there is no Chromium: apt-get install chromium, or name one: make test-browser CHROMIUM=/path/to/chrome" >&2; exit 1; }
	$(BIN)/python -m pytest -m browser tests/apps

test-dask: $(DASK_STAMP) ## test frames drawn by the workers of a cluster
	$(BIN)/python -m pytest -m dask tests/apps/sequences

test-mitsuba: $(MITSUBA_STAMP) ## test the bridge to Mitsuba; needs LLVM, 17 or newer (Debian: libllvm19)
	$(BIN)/python -m pytest -m mitsuba tests/apps/mitsuba

test-scans: $(SCANS_STAMP) ## test files of instruments, which another library reads
	$(BIN)/python -m pytest -m scans tests/heightfield

soak: $(TEST_STAMP) ## try what may go wrong for an hour; MINUTES=5 for less
	$(BIN)/python -m bench.dev.soak --minutes $(MINUTES)

fuzz: $(TEST_STAMP) ## read damaged files for an hour; MINUTES=5 for less
	$(BIN)/python -m bench.dev.fuzz --minutes $(MINUTES)

test-lowest: ## run the tests with the lowest versions that are allowed, in an environment of their own
	$(call test_in,lowest,--resolution lowest-direct)

test-newest: ## run the tests with the newest versions that are allowed, in an environment of their own
	$(call test_in,newest,--resolution highest)

test-prerelease: ## run the tests with pre-releases of the dependencies, in an environment of their own
	$(call test_in,prerelease,--resolution highest --prerelease allow)

release-check: $(RELEASE_STAMP) $(LINT_STAMP) ## run all checks before a release; STEPS="build wheel" for some
	$(BIN)/python -m bench.dev.release_check $(if $(STEPS),--steps $(STEPS)) $(if $(KEEP),--keep $(KEEP))

lint: $(LINT_STAMP) ## check style, types and the layers of imports
	$(BIN)/python -m ruff check
	$(BIN)/python -m ruff format --check
	$(BIN)/python -m mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/clang-format --dry-run --Werror kernels/native/*.h
	$(BIN)/clang-tidy --quiet kernels/native/*.h -- -x c++ -std=c++17 -include builtin.h \
	    -isystem "$$($(BIN)/python -c 'import warp; print(warp.__path__[0])')/native"

bench: $(BENCH_STAMP) ## chart speed against accuracy into bench_results/, in a quarter of an hour
	$(BIN)/python -m bench --output bench_results

docs: $(DOCS_STAMP) ## build the documentation site into docs/_build/html
	$(BIN)/python -m sphinx -b html -W --keep-going docs docs/_build/html
	@echo "the site is docs/_build/html/index.html"

clean: ## remove the environment, caches, builds and the demonstration's pictures
	rm -rf $(VENV) $(VENV)-lowest $(VENV)-newest $(VENV)-prerelease fuzz_failures build dist demo bench_results docs/_build docs/gallery docs/reference docs/tutorials/*.npy docs/tutorials/*.png docs/tutorials/*.exr docs/tutorials/*.glb docs/tutorials/*.html docs/tutorials/results.json *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find warpdiff kernels tests bench -name __pycache__ -type d -prune -exec rm -rf {} +

define test_in
rm -rf $(VENV)-$(1)
$(PYTHON) -m venv $(VENV)-$(1)
$(VENV)-$(1)/bin/python -m pip install uv
$(VENV)-$(1)/bin/uv pip install --python $(VENV)-$(1)/bin/python $(2) -e '.[test]'
$(subst $(BIN)/,$(VENV)-$(1)/bin/,$(PYTEST_WORKERS))
endef

# An environment made by hand is kept; only its version is checked.
$(BIN)/python:
	@command -v $(PYTHON) >/dev/null || { echo "error: $(PYTHON) is not installed; name another one: make PYTHON=python3.12" >&2; exit 1; }
	@$(call check_version,$(PYTHON))
	$(PYTHON) -m venv $(VENV)

define check_version
$(1) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "error: warpdiff needs Python 3.11 or newer, but $(1) is " + sys.version.split()[0] + "; name another one: make PYTHON=python3.12")'
endef

# Within a call's argument.
COMMA := ,

# Some tools make environments without pip.
define install
@$(call check_version,$(BIN)/python)
@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(BIN)/python -m ensurepip
$(BIN)/python -m pip install -e '$(1)'
endef

# Order-only: what is in the environment is newer than the interpreter that it links to.
$(DEMO_STAMP): pyproject.toml | $(BIN)/python
	$(call install,.)
	@touch $@

$(TEST_STAMP): pyproject.toml | $(BIN)/python
	$(call install,.[test])
	@touch $@ $(DEMO_STAMP)

$(BROWSER_STAMP): pyproject.toml | $(BIN)/python
	$(call install,.[browser])
	@touch $@ $(TEST_STAMP)

$(DASK_STAMP): pyproject.toml | $(BIN)/python
	$(call install,.[test$(COMMA)dask])
	@touch $@ $(TEST_STAMP)

$(BENCH_STAMP): pyproject.toml | $(BIN)/python
	$(call install,.[bench])
	@touch $@ $(DEMO_STAMP)

$(DOCS_STAMP): pyproject.toml | $(BIN)/python
	$(call install,.[docs])
	@touch $@ $(DEMO_STAMP)

$(MITSUBA_STAMP): pyproject.toml | $(BIN)/python
	$(call install,.[test$(COMMA)mitsuba])
	@touch $@ $(TEST_STAMP)

$(SCANS_STAMP): pyproject.toml | $(BIN)/python
	$(call install,.[test$(COMMA)scans])
	@touch $@ $(TEST_STAMP)

$(RELEASE_STAMP): pyproject.toml | $(BIN)/python
	$(call install,.[test$(COMMA)release])
	@touch $@ $(TEST_STAMP)

$(LINT_STAMP): pyproject.toml | $(BIN)/python
	$(call install,.[lint])
	@touch $@ $(DEMO_STAMP)
