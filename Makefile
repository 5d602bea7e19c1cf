# Everything runs from .venv, which `make setup` builds from the lock. PYTHON=... picks another interpreter.

BIN := .venv/bin
DEV := requirements/dev.txt
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
	"$$p" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null && { echo "$$p"; break; }; done)
COMPILE := $(BIN)/uv pip compile --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
	--custom-compile-command "make lock" --quiet
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --no-deps --require-hashes --only-binary :all:
# In the order of the files: the default begins with those of many tests, and ends with one that takes a minute. Three at
# a time keep two cores busy: many tests wait for what another process does.
PYTEST := $(BIN)/pytest --dist loadfile --no-loadscope-reorder
REDOCLY := npx --yes @redocly/cli@2.77.0
SPECTRAL := npx --yes @stoplight/spectral-cli@6.16.3
IMAGES ?= run cluster full
# Else all that the tests start would compile it at the same time.
WARM_UP = $(BIN)/python -u -c "import solver; solver.warm_up(print)"

# Bytecode is kept, whatever the environment says: a process that compiles all it imports takes three times as long to start.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help setup demo serve test test-system test-robustness test-slow test-ci check audit wheel sbom format openapi docs clients bench accuracy load growth call-path soak hostile \
	cluster slider reproduce validate figures screenshots lock clean

help: ## list what can be made
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: .venv/.developing .venv/.installed ## build .venv from the lock, with everything in it

# What the solver runs on comes first: `make demo` compiles it while the rest is installed.
.venv/.solver: requirements/run.txt
	@test -n "$(PYTHON)" || { echo "no Python 3.11 to 3.14 found; name one: make PYTHON=/path/to/python3"; exit 1; }
	@echo "building .venv with $$($(PYTHON) --version), a quarter of a minute ..."
	@$(PYTHON) -m venv --clear .venv
	@sed -nE '/^(llvmlite|numba|numpy)==/,/[^\\]$$/p' $< >.venv/solver.txt
	@$(INSTALL) -r .venv/solver.txt
	@touch $@

# Then what the service runs on, so that `make demo` need not wait for the tools of its developers.
.venv/.running: .venv/.solver requirements/build.txt
	@$(INSTALL) -r requirements/run.txt -r requirements/build.txt
	@touch $@

.venv/.developing: .venv/.running $(DEV)
	@echo "installing the tools of developers, half a minute ..."
	@$(INSTALL) -r $(DEV)
	@touch $@

.venv/.installed: .venv/.running pyproject.toml
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-index --no-deps --no-build-isolation -e .
	@touch $@

demo: .venv/.solver ## compute the paper's critical ricochet angle with a fresh service
	@$(WARM_UP) & $(MAKE) --no-print-directory .venv/.installed; installed=$$?; wait; exit $$installed
	@$(BIN)/python examples/demo.py

serve: setup ## run the service; RICOCHET_HOST, RICOCHET_PORT, RICOCHET_DATA_DIR, RICOCHET_WORKERS
	@$(BIN)/ricochet serve

test: setup ## run the tests of behaviour, three files at a time; ARGS="..." goes to pytest
	@$(WARM_UP)
	@$(PYTEST) -n 3 $(ARGS)

test-system: setup ## run those with a cluster or a proxy, those of generated clients, and the commands of the documentation
	@$(WARM_UP)
	@$(PYTEST) -n 2 -m "system and not robustness and not slow" $(ARGS)

test-robustness: setup ## study faults, attacks, supply chain, container, compiled code, and the page in Chromium
	@$(WARM_UP)
	@$(PYTEST) -n 2 -m "robustness and not slow" $(ARGS)

test-slow: setup ## run the tests that take minutes each, and enter their results in tests/slow.csv
	@$(WARM_UP)
	@$(PYTEST) -n 2 -m slow --junitxml=build/slow.xml $(ARGS); status=$$?; \
		$(BIN)/python -m tests.completeness build/slow.xml --record; exit $$status

test-ci: setup ## run all tests but the slow ones, those that fail once more alone, and fail if any was left out
	@$(WARM_UP)
	@$(PYTEST) -n 3 -m "not slow" --junitxml=build/tests.xml $(ARGS) || { \
		echo "== the tests that failed above, once more without others beside them"; \
		$(PYTEST) -n 0 -m "not slow" --last-failed --last-failed-no-failures none; }
	@$(BIN)/python -m tests.completeness build/tests.xml

check: setup ## lint, format, types, layers, committed contract and tables, Dockerfile, known vulnerabilities; with npm the contract's rules
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python requirements/public_names.py
	$(BIN)/ricochet openapi --check
	$(BIN)/python docs/tables.py --check
	$(BIN)/hadolint Dockerfile
	$(BIN)/python requirements/audit.py
	@if $(REDOCLY) --version >/dev/null 2>&1; then \
		$(REDOCLY) lint openapi/openapi.json && $(SPECTRAL) lint --ruleset openapi/spectral.json openapi/openapi.json; \
	else echo "npm is not here, or cannot reach its registry: the contract is not linted"; fi

audit: setup ## look for known vulnerabilities in what the service can run on; fails if it cannot look
	@$(BIN)/python requirements/audit.py --strict

wheel: setup ## build a wheel and a source distribution into dist
	@$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-index --no-deps --no-build-isolation --no-cache-dir \
		--wheel-dir dist .
	@$(BIN)/hatchling build --target sdist --directory dist

sbom: setup ## list the packages of each image as CycloneDX, into build/sbom-run.cdx.json, -cluster and -full
	@mkdir -p build
	@for image in $(IMAGES); do \
		PYTHONWARNINGS=ignore $(BIN)/cyclonedx-py requirements requirements/$$image.txt --pyproject pyproject.toml --mc-type application \
			--output-reproducible --output-format JSON --output-file build/sbom-$$image.cdx.json || exit; \
		echo "wrote build/sbom-$$image.cdx.json"; \
	done

format: setup ## format the code and mend what ruff can
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

openapi: setup ## compute the examples of answers and write the contract, openapi/openapi.json
	$(BIN)/python -m service.api.examples
	$(BIN)/ricochet openapi

docs: setup ## write the tables of docs/operating.md that the code says, and build the manual into build/manual
	$(BIN)/python docs/tables.py
	$(BIN)/python -m sphinx --builder html --fresh-env --fail-on-warning --keep-going --quiet \
		--doctree-dir build/doctrees docs build/manual

clients: setup ## build a Python wheel and an npm package of clients made from the contract, into dist
	@$(BIN)/python clients/build.py

bench: setup ## measure the solver: routes, start, accuracy against time, two cores; ARGS="--quick"
	@for script in routes startup work_precision scaling; do $(BIN)/python benchmarks/$$script.py $(ARGS) || exit; done

accuracy: setup ## compare random critical angles with converged ones, and with scans, some minutes
	$(BIN)/python benchmarks/accuracy.py $(ARGS)

load: setup ## measure what HTTP costs beside the bare solver, ten minutes; ARGS="--quick"
	$(BIN)/python benchmarks/http_load.py $(ARGS)

growth: setup ## measure how the cost grows with cores, Dask workers, queued cases, results and jobs, six minutes; ARGS="--quick"
	$(BIN)/python benchmarks/growth.py $(ARGS)

call-path: setup ## count the files of service that a request touches
	$(BIN)/python benchmarks/call_path.py $(ARGS)

hostile: setup ## measure how long 2,000 hostile requests make the event loop stand still, two minutes
	$(BIN)/python benchmarks/hostile.py $(ARGS)

soak: setup ## load the service through kills and restarts, 20 minutes; ARGS="--minutes 2"
	$(BIN)/python benchmarks/soak.py $(ARGS)

cluster: setup ## compare a Dask cluster with the pool, two minutes; ARGS="--quick"
	$(BIN)/python benchmarks/cluster.py $(ARGS)

slider: setup ## measure a step of a slider in the page, in Chromium
	$(BIN)/python benchmarks/slider.py $(ARGS)

reproduce: setup ## compute the paper anew, into build/reproduce; ARGS="--output FOLDER"
	@$(BIN)/python -m validation reproduce $(ARGS)

validate: setup ## compare with published penetration tests, into build/validation; ARGS="--output FOLDER"
	@$(BIN)/python -m validation validate $(ARGS)

figures: setup ## draw the pictures of the README
	$(BIN)/python docs/figures/trajectories.py

screenshots: setup ## take pictures of the page in Chromium, into build/screenshots
	@$(BIN)/python -m docs.figures.screenshots

lock: setup ## pin the newest version of every package; the other locks follow the one of the developers
	$(COMPILE) --upgrade pyproject.toml --group dev --all-extras -o $(DEV)
	$(COMPILE) --no-annotate -c $(DEV) pyproject.toml -o requirements/run.txt
	$(COMPILE) --no-annotate -c $(DEV) --extra dask pyproject.toml -o requirements/cluster.txt
	$(COMPILE) --no-annotate -c $(DEV) --all-extras pyproject.toml -o requirements/full.txt
	$(COMPILE) --no-annotate -c $(DEV) --group build -o requirements/build.txt

clean: ## remove .venv and every cache
	rm -rf .venv dist .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache .schemathesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
