# perfbound: one target per habit. `make help` lists them.

VERSIONS := 3.11 3.12 3.13
VENV ?= .venv
BIN := $(VENV)/bin
# That of the environment, if there is one; else the first one on PATH that fits.
FITTING = for each in python3.11 python3 python3.12 python3.13; do \
  $$each -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12), (3, 13)))' 2>/dev/null && { echo $$each; break; }; done
PYTHON ?= $(firstword $(wildcard $(BIN)/python) $(shell $(FITTING)) python3)
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
LOCK := locks/$(VERSION)
INSTALLED := $(VENV)/.installed-$(VERSION)
# What the tests need.
READY := $(INSTALLED)-dev build/node/.installed build/backend/.installed
CAMPAIGN ?= deploy/campaigns/segway.toml
WORKERS ?= 2
RUN_DIR = runs/$(basename $(notdir $(CAMPAIGN)))
# Hashes are checked, and nothing is compiled on the way: what was tested is what runs.
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check
LOCKED = $(INSTALL) --only-binary :all: --require-hashes

# The tests start hundreds of processes: compiled modules are kept, also where the environment would not have it.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup dev slurm run test test-all every-test studies touched other-pythons jax smoke announce checks lint types imports doctests unit explore fuzz faults coverage reproduce bench bench-compare mutants schemas texts diagrams docs images lock clean

help: ## List the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-13s %s\n", $$1, $$2}'

$(INSTALLED): $(wildcard $(LOCK).txt) pyproject.toml
	@test -n "$(filter $(VERSION),$(VERSIONS))" || { \
	  echo "perfbound needs Python $(VERSIONS), and $(PYTHON) is $(or $(VERSION),missing): choose one with PYTHON=..." >&2; exit 1; }
	@test -x $(BIN)/python || echo "Installing into $(VENV) with Python $(VERSION): 210 MB to download, 840 MB on the disk;" \
	  "tests need 150 MB more. $(if $(filter 3.11,$(VERSION)),,The Segway needs one more package here: CONTRIBUTING.md, Python versions.)"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -c 'import sys; sys.exit("%d.%d" % sys.version_info[:2] != "$(VERSION)")' || { \
	  echo "$(VENV) has another Python than $(PYTHON): choose VENV=.venv-$(VERSION), or run make clean" >&2; exit 1; }
	$(LOCKED) -r $(LOCK).txt
	$(INSTALL) --no-deps -e .
	touch $@

$(INSTALLED)-%: $(LOCK)-%.txt $(INSTALLED)
	$(LOCKED) -r $<
	touch $@

# Another Python has no locks: the rule above does not apply, and that of $(INSTALLED) says what is wrong.
$(INSTALLED)-%: $(INSTALLED) ;

setup: $(INSTALLED) ## Make the virtual environment with the locked versions (PYTHON=python3.12)

dev: $(READY) ## The same, and what the tests need


jax: $(INSTALLED)-jax ## Add JAX to it, for deploy/examples/satellite

slurm: ## Install Debian's Slurm for the tests with a cluster of one node, which are skipped without it; as root
	apt-get install --yes --no-install-recommends slurmctld slurmd slurm-client

run: setup ## Run the Segway campaign with two local workers (CAMPAIGN=..., WORKERS=...); continues where it stopped
	@if test -e $(RUN_DIR)/campaign.db; then $(BIN)/perfbound resume $(RUN_DIR) --workers $(WORKERS); \
	else $(BIN)/perfbound run $(CAMPAIGN) --workers $(WORKERS) --out $(RUN_DIR); fi

test: announce checks unit ## Lint, types, imports, unit and contract tests, one journey of each capability: 10 minutes

test-all: announce checks jax $(INSTALLED)-docs docs every-test other-pythons ## Everything: kills, browsers, wheel, Slurm, site, fuzz, studies in short, other Pythons

other-pythons:
	@for version in $(filter-out $(VERSION),$(VERSIONS)); do \
	  if python$$version -c '' 2>/dev/null; \
	  then $(MAKE) jax doctests every-test PYTHON=python$$version VENV=.venv-$$version || exit 1; \
	  else missing="$$missing python$$version"; fi; \
	done; test -z "$$missing" || echo "Not tested, because not on PATH:$$missing"

smoke: $(INSTALLED)-dev ## Two minutes: real workers, kills, the contract of the transports, golden rollouts; no browser
	$(BIN)/python -m pytest -q -m smoke

announce:
	@echo "\`make test\` takes about 10 minutes on two quiet cores, after the installation, and \`make test-all\` an hour."

# Side by side: each of them takes one core.
checks: $(INSTALLED)-dev
	@$(MAKE) --no-print-directory --output-sync --jobs 2 types lint imports doctests

lint: $(INSTALLED)-dev ## Style
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED)-dev ## Types, strict
	$(BIN)/mypy

imports: $(INSTALLED)-dev ## Which room may import which
	$(BIN)/lint-imports

# Readers of our files in JavaScript. Where there is no npm, their tests are skipped, and the last line of the tests says so.
READERS := tests/end_to_end/report/node
build/node/.installed: $(READERS)/package.json $(READERS)/package-lock.json
	@mkdir -p build/node
	@if command -v npm >/dev/null; then cp $^ build/node && npm ci --silent --no-audit --no-fund --prefix build/node || { \
	  echo "npm ci failed in build/node; run it again with a network, or without npm on PATH" >&2; exit 1; }; fi
	@touch $@

# The build backend that pyproject.toml pins, so that the test of the wheel needs no network later on.
build/backend/.installed: pyproject.toml $(INSTALLED)
	rm -rf build/backend
	$(INSTALL) --target build/backend "$$(sed -n 's/^requires = \["\(.*\)"\]$$/\1/p' pyproject.toml)"
	touch $@

DOCTESTS := $(addprefix perfbound/,orchestrator workers schemas library) tests/architecture/source.py tests/architecture/prometheus.py tests/golden/record.py tests/facts.py
doctests: $(INSTALLED)-dev ## Examples in docstrings
	$(BIN)/python -m pytest --doctest-modules $(DOCTESTS)

# A file's tests share what is costly to make, so they run in one process. Most tests with processes of their own wait a
# part of their time: three at once keep two cores busy.
AT_ONCE ?= 3
PYTEST = $(BIN)/python -m pytest -n $(AT_ONCE) --dist loadfile --no-loadscope-reorder --durations=10
unit: $(READY) ## The tests of `make test`, without lint and types
	$(PYTEST) -m "not rest and not slow" tests

every-test: $(READY)
	$(PYTEST) -m "not slow" tests

studies: $(READY) ## The long forms of the statistical tests (hours)
	$(PYTEST) -m slow tests

# What else runs after a change of a room: `make touched BASE=main`.
REST_schemas := run/test_bad_input.py systems/test_input_signals.py report/test_mcap_readers.py
REST_orchestrator/cli := run/test_pipes.py run/test_ends.py prepare/test_first_steps.py
REST_orchestrator/prepare := prepare
REST_orchestrator/release := certificate/test_gate.py
REST_orchestrator/report := report
REST_orchestrator/run := run/test_resume.py run/test_stop.py run/test_left_behind.py run/test_robustness.py
REST_orchestrator/hosts := fleet/test_slurm.py fleet/test_router.py
REST_orchestrator/certificate := certificate methods/test_six_campaigns.py
REST_orchestrator/forecast := prepare/test_plan.py methods/test_kriging.py
REST_orchestrator/campaign := methods run/test_extension.py
REST_orchestrator/store := run/test_resume.py run/test_campaign.py
REST_orchestrator/fleet := fleet/test_router.py fleet/test_three_hosts.py run/test_life.py
REST_orchestrator/mathematics := methods
REST_workers := systems run/test_places.py run/test_life.py
REST_perfbound := product/test_library.py product/test_wheel.py
REST_deploy := fleet/test_deployments.py fleet/test_slurm.py
REST_docs := product/test_tutorial.py prepare/test_questions.py
ROOMS := $(patsubst REST_%,%,$(filter REST_%,$(.VARIABLES)))
BASE ?= HEAD~1
CHANGED = $(shell git diff --name-only $(BASE) 2>/dev/null)
TOUCHED = $(sort $(foreach room,$(ROOMS),$(if $(filter $(room)/%,$(CHANGED)),$(REST_$(room)))))
touched: $(READY) ## The tests of test-all that belong to the rooms which differ from BASE (the last commit)
	@test -z "$(TOUCHED)" || $(PYTEST) -m "not slow" $(TOUCHED:%=tests/end_to_end/%)

explore: $(INSTALLED)-dev ## Property tests with new random cases, many of them
	PERFBOUND_EXPLORE=1 $(BIN)/python -m pytest -q tests/unit

FUZZ ?= 100000
fuzz: $(INSTALLED)-dev ## Random and mutated bytes at every border (FUZZ=100000 of each, fewer of costly ones; prints the sum)
	PERFBOUND_FUZZ=$(FUZZ) $(BIN)/python -m pytest -q --timeout 0 tests/fuzz tests/unit/fleet/link/test_fuzz_border.py

MINUTES ?= 10
SEED ?= 1
BATCH ?= 1
faults: $(INSTALLED)-dev ## Campaigns under seeded faults: kill, stop, partition, full disk, ... (MINUTES=10, SEED=1, BATCH=1)
	$(BIN)/python -m tests.faults --minutes $(MINUTES) --seed $(SEED) --batch $(BATCH)

coverage: $(INSTALLED)-dev ## How often bounds fail, over thousands of campaigns (half an hour; continues where it stopped)
	$(BIN)/python -m tests.studies.coverage

reproduce: setup ## The paper's tables and figures, into runs/paper (20 minutes; continues where it stopped)
	$(BIN)/perfbound reproduce paper --out runs/paper

$(VENV)-bench/.installed: tests/studies/benchmarks/requirements.txt
	test -x $(VENV)-bench/bin/python || $(PYTHON) -m venv $(VENV)-bench
	$(VENV)-bench/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	touch $@

bench: $(INSTALLED)-dev $(VENV)-bench/.installed ## CPU times beside those of peers, in one table and as JSON
	$(BIN)/python -m tests.studies.benchmarks

bench-compare: $(INSTALLED)-dev ## Two results side by side: OLD=... NEW=... (JSON files of make bench)
	$(BIN)/python -m tests.studies.benchmarks.compare $(OLD) $(NEW)

$(VENV)-mutants/.installed: tests/studies/mutants/requirements.txt
	test -x $(VENV)-mutants/bin/python || $(PYTHON) -m venv $(VENV)-mutants
	$(VENV)-mutants/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	touch $@

NUMBER ?= 60
mutants: $(READY) $(VENV)-mutants/.installed ## Which small changes of the product the tests notice (hours; NUMBER=60, SEED=1; continues where it stopped)
	$(BIN)/python -m tests.studies.mutants --seed $(SEED) --number $(NUMBER)

schemas: $(INSTALLED)-dev ## Write schemas/json/v1 anew from the models
	$(BIN)/python -m perfbound.schemas

texts: $(INSTALLED)-dev ## Write anew what the product says, tests/texts/*.txt; then review the diff
	$(BIN)/python -m tests.texts

diagrams: $(INSTALLED)-dev ## Draw the diagrams of docs/architecture.md from tables and imports, write the table of metrics
	$(BIN)/python -m tests.architecture

docs: $(INSTALLED)-docs ## Build the docs site into build/site; a broken link fails the build
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

BUILDER ?= $(firstword $(shell command -v docker podman buildah))
images: ## Build both container images (BUILDER=docker, podman or buildah; BASE=... for another base with Python 3.11)
	@test -n "$(BUILDER)" || { echo "no docker, podman or buildah: install one of them" >&2; exit 1; }
	$(BUILDER) build $(if $(BASE),--build-arg BASE=$(BASE)) --file deploy/Dockerfile --target orchestrator --tag perfbound:$(RELEASE) .
	$(BUILDER) build $(if $(BASE),--build-arg BASE=$(BASE)) --file deploy/Dockerfile --target worker --tag perfbound-worker:$(RELEASE) .

RELEASE = $(shell sed -n 's/^version = "\(.*\)"$$/\1/p' pyproject.toml)

lock: ## Resolve the dependencies for every Python of this machine; a version stays while pyproject.toml allows it
	@for version in $(VERSIONS); do \
	  if python$$version -c '' 2>/dev/null; then $(MAKE) lock-$$version || exit 1; \
	  else echo "not resolved, because not on PATH: python$$version"; fi; \
	done

.PRECIOUS: build/pip-tools-%/.installed
build/pip-tools-%/.installed:
	python$* -m venv build/pip-tools-$*
	build/pip-tools-$*/bin/python -m pip install --quiet --disable-pip-version-check pip-tools==7.6.2
	touch $@

# Every Python gets the versions of 3.11, as far as they have wheels for it; the additions, those of the base.
RESOLVE = build/pip-tools-$*/bin/pip-compile --quiet --generate-hashes --no-header --strip-extras --allow-unsafe \
  --no-emit-index-url --no-emit-find-links --no-emit-trusted-host $(if $(filter-out 3.11,$*),-c locks/3.11$(1).txt)
lock-%: build/pip-tools-%/.installed
	$(call RESOLVE) -o locks/$*.txt pyproject.toml
	$(call RESOLVE,-dev) --extra dev -c locks/$*.txt -o locks/$*-dev.txt pyproject.toml
	$(call RESOLVE,-docs) --extra docs -c locks/$*.txt -c locks/$*-dev.txt -o locks/$*-docs.txt pyproject.toml
	$(call RESOLVE,-jax) --extra jax -c locks/$*.txt -o locks/$*-jax.txt pyproject.toml

clean: ## Remove the environment and caches; runs are kept
	rm -rf $(VENV) $(VENV)-bench $(VENV)-mutants $(addprefix .venv-,$(VERSIONS)) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache build *.egg-info
