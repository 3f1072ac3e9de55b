# make run     build .venv from python3 alone, install machopt, do the main job on the shipped cell
# make quick   unit tests, a minute  make test    tests of up to 5 s of processor time each   (JOBS=n processes; the cores of this machine)
# make proofs  longer tests (tests/long_tests.txt), statistics over many records, torture by kills: as long again
# make suite   tests and proofs in one run: modules are imported and shared plans made once
# make lint    format, lint, imports, types
# make check   lint, suite   make clean   remove .venv, .venv-lowest, .venv-docs and out/
# make coverage  all tests, counting branches: fails where a package of tests/branch_coverage.py falls below its floor
# make lowest  the quick tests on the lowest versions that pyproject.toml allows, in .venv-lowest
# make docs    the documentation as pages in out/docs, every link checked; built in .venv-docs, without machopt
# make nightly all tests with twenty times as many examples of each property, drawn anew; more random jobs of the proofs
# make slow    all tests once, to write tests/slow_tests.txt, long_tests.txt and module_durations.txt anew: what `quick` and `test`
#              leave out, what goes first
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
CELL   ?= cells/kr500_milling
PATHS  ?= toolpaths/cylinder_head_face.cls
OUT    ?= out/cylinder_head
JOBS   ?= auto
TEST_LOCK ?= .requirements-test.lock
SOURCES := pyproject.toml $(shell find machopt -name '*.py')

# one module, one process: its fixtures are made once; conftest.py says which modules come first
PYTEST := $(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder --strict-skips

# the tests start hundreds of processes; each would compile the package anew
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run quick test proofs suite coverage lowest docs nightly slow lint check clean
.DELETE_ON_ERROR:

run: $(VENV)/.installed
	$(BIN)/machopt optimize $(CELL) $(PATHS) -o $(OUT)

quick: $(VENV)/.compiled
	$(PYTEST) -m 'not slow and not proof'

test: $(VENV)/.compiled
	$(PYTEST) -m 'not proof'

proofs: $(VENV)/.compiled
	$(PYTEST) -m proof $$({ grep -l 'mark\.proof' tests/test_*.py tests/*/test_*.py; sed 's/::.*//' tests/long_tests.txt; } | sort -u)  # others need no import

suite: $(VENV)/.compiled
	$(PYTEST)

coverage: $(VENV)/.compiled
	$(PYTEST) --cov --cov-report=
	$(BIN)/python tests/branch_coverage.py

nightly: $(VENV)/.compiled
	HYPOTHESIS_PROFILE=nightly $(PYTEST)

slow: $(VENV)/.compiled
	$(PYTEST) --record-slow

lowest:
	$(MAKE) quick VENV=.venv-lowest TEST_LOCK=.requirements-lowest.lock

docs: .venv-docs/.installed
	.venv-docs/bin/sphinx-build --quiet --nitpicky --fail-on-warning --keep-going -c docs/site . out/docs
	@echo "out/docs/index.html"

lint: $(VENV)/.installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/mypy
	$(BIN)/mypy --config-file benchmarks/mypy.ini

check: lint suite

clean:
	rm -rf $(VENV) .venv-lowest .venv-docs out .coverage

$(VENV)/.python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is older than 3.11; name a newer one: make PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@touch $@

# Packages come from the lock files, each by version and hash; benchmarks/update_lock_files.sh makes these anew. Then machopt itself.
PIP  := $(BIN)/python -m pip install --quiet --disable-pip-version-check
SELF := $(PIP) --no-deps --no-build-isolation

# the development install is editable and serves `run` too, so nothing is installed over it
$(VENV)/.installed: $(VENV)/.python .requirements.lock $(SOURCES)
	test -e $(VENV)/.installed-dev || { $(PIP) --require-hashes -r .requirements.lock && $(SELF) .; }
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.python $(TEST_LOCK) pyproject.toml
	$(PIP) --require-hashes -r $(TEST_LOCK)
	$(SELF) -e .
	@touch $@

.venv-docs/.installed: .requirements-docs.lock
	$(PYTHON) -m venv .venv-docs
	.venv-docs/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r $<
	@touch $@

# Kernels, once: two processes begin at either end and find what the other one stored. Left to the tests, each of their
# processes would compile nearly all.
COMPILE = $(BIN)/python -c 'from machopt.planning.kernel_precompilation import KERNELS, MORE, compile_all; compile_all((KERNELS + MORE)[::$(1)])'

$(VENV)/.compiled: $(VENV)/.installed-dev $(SOURCES)
	@$(call COMPILE,1) & one=$$!; $(call COMPILE,-1) && wait $$one
	@touch $@
