# perfbound: one target per habit. `make help` lists them.

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
CAMPAIGN ?= deploy/campaigns/segway-paper.toml
WORKERS ?= 2
RUN_DIR = runs/$(basename $(notdir $(CAMPAIGN)))
# Hashes are checked, and nothing is compiled on the way: what was tested is what runs.
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check

.DEFAULT_GOAL := help
.PHONY: help setup run test test-all smoke announce lint types imports unit explore faults coverage reproduce bench bench-compare schemas names diagrams docs lock clean

help: ## List the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-13s %s\n", $$1, $$2}'

$(VENV)/.installed: requirements.lock pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "perfbound needs $(PYTHON): pybullet has no wheels above 3.11" >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) --require-hashes -r requirements.lock
	$(INSTALL) --no-deps -e .
	touch $@

$(VENV)/.installed-dev: requirements-dev.lock $(VENV)/.installed
	$(INSTALL) --require-hashes -r requirements-dev.lock
	touch $@

setup: $(VENV)/.installed ## Make the virtual environment with the locked versions

run: setup ## Run the Segway campaign with two local workers (CAMPAIGN=..., WORKERS=...); continues where it stopped
	@if test -e $(RUN_DIR)/campaign.db; then $(BIN)/perfbound resume $(RUN_DIR) --workers $(WORKERS); \
	else $(BIN)/perfbound run $(CAMPAIGN) --workers $(WORKERS) --out $(RUN_DIR); fi

test: announce lint types imports unit ## All checks: ruff, mypy, import rules, pytest; about 25 minutes

test-all: announce lint types imports unit ## All checks, and the tests that take longer still

test-all: NOT_SLOW :=

smoke: $(VENV)/.installed-dev ## Two minutes: real workers, kills, the contract of the transports, golden rollouts; no browser
	$(BIN)/python -m pytest -q -m smoke

announce:
	@echo "About 25 minutes on two quiet cores, after the installation; \`make smoke\` takes two."

lint: $(VENV)/.installed-dev ## Style
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-dev ## Types, strict
	$(BIN)/mypy

imports: $(VENV)/.installed-dev ## Which room may import which
	$(BIN)/lint-imports

# Readers of our files in JavaScript; where there is no npm or no network, their tests are skipped.
build/node/.installed: Makefile
	@if command -v npm >/dev/null && npm install --silent --no-save --no-audit --no-fund --prefix build/node \
	  @mcap/core@2.2.2 @mcap/support@1.1.0 fzstd@0.1.1 @foxglove/schemas@2.1.0; then touch $@; fi

# The build backend that pyproject.toml pins, so that the test of the wheel needs no network later on.
build/backend/.installed: pyproject.toml $(VENV)/.installed
	rm -rf build/backend
	$(INSTALL) --target build/backend "$$(sed -n 's/^requires = \["\(.*\)"\]$$/\1/p' pyproject.toml)"
	touch $@

NOT_SLOW := -m "not slow"
# In two processes, but for the tests with real processes and real waiting. A file's tests share what is costly to make.
PROCESSES := tests/end_to_end tests/faults
IN_TWO := -n 2 --dist loadfile tests $(addprefix --ignore=,$(PROCESSES))
OUR_DOCTESTS := tests/architecture/source.py tests/golden/record.py
unit: $(VENV)/.installed-dev build/node/.installed build/backend/.installed ## Tests, with real workers, Zenoh and PyBullet
	$(BIN)/python -m pytest --doctest-modules perfbound/orchestrator perfbound/workers perfbound/schemas $(OUR_DOCTESTS)
	$(BIN)/python -m pytest $(IN_TWO) --durations=10 $(NOT_SLOW)
	$(BIN)/python -m pytest $(PROCESSES) --durations=10 $(NOT_SLOW)

explore: $(VENV)/.installed-dev ## Property tests with new random cases, many of them
	PERFBOUND_EXPLORE=1 $(BIN)/python -m pytest -q tests/unit

MINUTES ?= 10
SEED ?= 1
faults: $(VENV)/.installed-dev ## Campaigns under seeded faults: kill, stop, partition, full disk, ... (MINUTES=10, SEED=1)
	$(BIN)/python -m tests.faults --minutes $(MINUTES) --seed $(SEED)

coverage: $(VENV)/.installed-dev ## How often bounds fail, over thousands of campaigns (half an hour; continues where it stopped)
	$(BIN)/python -m tests.coverage

reproduce: setup ## The paper's tables and figures, into runs/paper (half an hour; continues where it stopped)
	$(BIN)/perfbound reproduce paper --out runs/paper

$(VENV)-bench/.installed: tests/benchmarks/requirements.txt
	test -x $(VENV)-bench/bin/python || $(PYTHON) -m venv $(VENV)-bench
	$(VENV)-bench/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	touch $@

bench: $(VENV)/.installed-dev $(VENV)-bench/.installed ## CPU times beside those of peers, in one table and as JSON
	$(BIN)/python -m tests.benchmarks

bench-compare: $(VENV)/.installed-dev ## Two results side by side: OLD=... NEW=... (JSON files of make bench)
	$(BIN)/python -m tests.benchmarks.compare $(OLD) $(NEW)

schemas: $(VENV)/.installed-dev ## Write schemas/json/v1 anew from the models
	$(BIN)/python -m perfbound.schemas

names: $(VENV)/.installed-dev ## Names that are defined in more than one module
	$(BIN)/python -m tests.architecture.names

diagrams: $(VENV)/.installed-dev ## Draw the diagrams of docs/architecture.md from the legality tables and the imports
	$(BIN)/python -m tests.architecture

$(VENV)/.installed-docs: requirements-docs.lock $(VENV)/.installed
	$(INSTALL) --require-hashes -r requirements-docs.lock
	touch $@

docs: $(VENV)/.installed-docs ## Build the docs site into build/site; a broken link fails the build
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

lock: ## Resolve the dependencies anew (needs pip-tools)
	pip-compile --quiet --generate-hashes --no-header --strip-extras --allow-unsafe --no-emit-index-url \
	  --no-emit-find-links --no-emit-trusted-host -o requirements.lock pyproject.toml
	pip-compile --quiet --generate-hashes --no-header --strip-extras --allow-unsafe --no-emit-index-url \
	  --no-emit-find-links --no-emit-trusted-host --extra dev -c requirements.lock -o requirements-dev.lock pyproject.toml
	pip-compile --quiet --generate-hashes --no-header --strip-extras --allow-unsafe --no-emit-index-url \
	  --no-emit-find-links --no-emit-trusted-host --extra docs -c requirements.lock -c requirements-dev.lock \
	  -o requirements-docs.lock pyproject.toml

clean: ## Remove the environment and caches; runs are kept
	rm -rf $(VENV) $(VENV)-bench .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache build *.egg-info
