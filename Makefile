# Everything runs from .venv, which `make setup` builds from the locked requirements. PYTHON=... selects another interpreter.

BIN := .venv/bin
DEV := requirements/dev.txt
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
	"$$p" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null && { echo "$$p"; break; }; done)
COMPILE := $(BIN)/uv pip compile --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
	--custom-compile-command "make lock" --quiet
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --no-deps --require-hashes --only-binary :all:
# Files run in the order of their names: by default pytest-xdist starts with the files that have the most tests, and ends with
# one that takes a minute. Three at a time keep two cores busy, because many tests wait for another process.
PYTEST := $(BIN)/pytest --dist loadfile --no-loadscope-reorder
REDOCLY := npx --yes @redocly/cli@2.77.0
SPECTRAL := npx --yes @stoplight/spectral-cli@6.16.3
IMAGES ?= run cluster full
# Otherwise all processes that the tests start would compile the solver at the same time.
WARM_UP = $(BIN)/python -u -c "import solver; solver.warm_up(print)"

# Bytecode is written whatever the environment says, because a process that compiles all its imports takes three times as long to start.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help setup demo serve test test-system test-robustness test-slow test-ci check audit wheel sbom format openapi docs clients bench accuracy load growth call-path soak hostile \
	cluster slider reproduce validate figures screenshots lock clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: .venv/.developing .venv/.installed ## build .venv with everything in it from the locked requirements

# The requirements of the solver come first, so that `make demo` can compile it while the rest is installed.
.venv/.solver: requirements/run.txt
	@test -n "$(PYTHON)" || { echo "no Python 3.11 to 3.14 found; name one: make PYTHON=/path/to/python3"; exit 1; }
	@echo "building .venv with $$($(PYTHON) --version), a quarter of a minute ..."
	@$(PYTHON) -m venv --clear .venv
	@sed -nE '/^(llvmlite|numba|numpy)==/,/[^\\]$$/p' $< >.venv/solver.txt
	@$(INSTALL) -r .venv/solver.txt
	@touch $@

# The requirements of the service come next, so that `make demo` need not wait for the development tools.
.venv/.running: .venv/.solver requirements/build.txt
	@$(INSTALL) -r requirements/run.txt -r requirements/build.txt
	@touch $@

.venv/.developing: .venv/.running $(DEV)
	@echo "installing the development tools, half a minute ..."
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

test-system: setup ## run the tests with clusters, proxies and generated clients, and the commands of the manual
	@$(WARM_UP)
	@$(PYTEST) -n 2 -m "system and not robustness and not slow" $(ARGS)

test-robustness: setup ## test faults, attacks, supply chain, container, compiled code, and the page in Chromium
	@$(WARM_UP)
	@$(PYTEST) -n 2 -m "robustness and not slow" $(ARGS)

test-slow: setup ## run the tests that take minutes each, and record their results in tests/slow.csv
	@$(WARM_UP)
	@$(PYTEST) -n 2 -m slow --junitxml=build/slow.xml $(ARGS); status=$$?; \
		$(BIN)/python -m tests.completeness build/slow.xml --record; exit $$status

test-ci: setup ## run all but the slow tests, repeat failures one by one, and fail if a test was left out
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

audit: setup ## look for known vulnerabilities in all requirements of the service; fails without the database
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

format: setup ## format the code, and apply the fixes that ruff knows
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

openapi: setup ## compute the examples of answers and write the contract, openapi/openapi.json
	$(BIN)/python -m service.api.examples
	$(BIN)/ricochet openapi

docs: setup ## write the tables of docs/operating.md from the code, and build the manual in build/manual
	$(BIN)/python docs/tables.py
	$(BIN)/python -m sphinx --builder html --fresh-env --fail-on-warning --keep-going --quiet \
		--doctree-dir build/doctrees docs build/manual

clients: setup ## build the clients generated from the contract as a wheel and an npm package, into dist
	@$(BIN)/python clients/build.py

bench: setup ## measure the solver: routes, start, accuracy against time, two cores; ARGS="--quick"
	@for script in routes startup work_precision scaling; do $(BIN)/python benchmarks/$$script.py $(ARGS) || exit; done

accuracy: setup ## compare random critical angles with converged ones, and with scans, some minutes
	$(BIN)/python benchmarks/accuracy.py $(ARGS)

load: setup ## measure the overhead of HTTP over the solver alone, ten minutes; ARGS="--quick"
	$(BIN)/python benchmarks/http_load.py $(ARGS)

growth: setup ## measure how the cost grows with cores, Dask workers, queued cases, results and jobs, six minutes; ARGS="--quick"
	$(BIN)/python benchmarks/growth.py $(ARGS)

call-path: setup ## count the files of service that a request touches
	$(BIN)/python benchmarks/call_path.py $(ARGS)

hostile: setup ## measure how long 2,000 hostile requests block the event loop, two minutes
	$(BIN)/python benchmarks/hostile.py $(ARGS)

soak: setup ## load the service through kills and restarts, 20 minutes; ARGS="--minutes 2"
	$(BIN)/python benchmarks/soak.py $(ARGS)

cluster: setup ## compare a Dask cluster with the pool, two minutes; ARGS="--quick"
	$(BIN)/python benchmarks/cluster.py $(ARGS)

slider: setup ## measure a step of a slider in the page, in Chromium
	$(BIN)/python benchmarks/slider.py $(ARGS)

reproduce: setup ## recompute the results of the paper, into build/reproduce; ARGS="--output FOLDER"
	@$(BIN)/python -m validation reproduce $(ARGS)

validate: setup ## compare with published penetration tests, into build/validation; ARGS="--output FOLDER"
	@$(BIN)/python -m validation validate $(ARGS)

figures: setup ## draw the figures of the README
	$(BIN)/python docs/figures/trajectories.py

screenshots: setup ## take screenshots of the page in Chromium, into build/screenshots
	@$(BIN)/python -m docs.figures.screenshots

lock: setup ## pin the newest version of every package; the other locks follow that for development
	$(COMPILE) --upgrade pyproject.toml --group dev --all-extras -o $(DEV)
	$(COMPILE) --no-annotate -c $(DEV) pyproject.toml -o requirements/run.txt
	$(COMPILE) --no-annotate -c $(DEV) --extra dask pyproject.toml -o requirements/cluster.txt
	$(COMPILE) --no-annotate -c $(DEV) --all-extras pyproject.toml -o requirements/full.txt
	$(COMPILE) --no-annotate -c $(DEV) --group build -o requirements/build.txt

clean: ## remove .venv and every cache
	rm -rf .venv dist .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache .schemathesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
