# Every target works on a fresh clone: the environment in .venv is made on first
# use, from requirements.lock alone.

PYTHON ?= python3
BIN    := .venv/bin
PY     := $(BIN)/python
# -qq: errors only.
PIP    := $(BIN)/pip -qq --disable-pip-version-check
PARTS  ?=
PYTHON312 ?= python3.12
SOURCES := src tests tools $(wildcard benchmarks examples fuzz)

# The tests start hundreds of Pythons, each of which would compile the whole package.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test long ros check size docs page dist bench crash accuracy heading figures compare fuzz format lock clean

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: .venv/installed ## Map the example drive, draw the map and compare it with the truth
	@mkdir -p build/demo
	$(BIN)/fieldgrid build examples/two_lanes -o build/demo/two_lanes.gpkg --overwrite --gnss gnss_rtk.nmea
	$(BIN)/fieldgrid show build/demo/two_lanes.gpkg -o build/demo/two_lanes.png --overwrite
	$(BIN)/fieldgrid evaluate build/demo/two_lanes.gpkg examples/two_lanes/truth

test: .venv/installed ## Run the tests
	$(PY) -m pytest -n auto --dist worksteal

long: .venv/installed ## Run the tests that take long: more cases, and real drives
	$(PY) -m pytest -n auto --dist worksteal -m "long or hypothesis" --hypothesis-profile=long

# Threads of BLAS order sums otherwise in a busy process: a sigma's last digit would differ.
ros: build/ros/installed ## Test the node of ROS 2 over real DDS (needs Python 3.12 and cmake)
	OPENBLAS_NUM_THREADS=1 build/ros/bin/python -m pytest tests/ros

build/ros/installed: pyproject.toml tests/ros/requirements.txt tests/ros/make_messages.py
	@rm -rf build/ros
	$(PYTHON312) -m venv build/ros
	build/ros/bin/pip -qq --disable-pip-version-check install -e '.[ros]' -r tests/ros/requirements.txt
	build/ros/bin/python tests/ros/make_messages.py build/ros/packages
	@touch $@

check: .venv/installed ## Check style, types, and the code and commands in the documentation
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/mypy --strict src tools
	$(PY) tools/check_docs.py
	$(PY) tools/size.py

size: .venv/installed ## Count the package, room by room, beside its budgets
	$(PY) tools/size.py

docs: .venv/installed ## Build the documentation site into build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	$(PY) tools/docs_site.py build/site

page: page/node_modules/.package-lock.json ## Build the viewer's page (needs npm); what is built is committed
	cd page && npm run --silent build

page/node_modules/.package-lock.json: page/package-lock.json
	cd page && npm ci --silent --no-audit --no-fund

dist: .venv/installed build/uv/bin/uv ## Build the wheel and the sdist, and check them as a stranger meets them
	@rm -rf dist
	$(PY) -m build --no-isolation >build/dist.log || { cat build/dist.log; exit 1; }
	$(BIN)/twine check --strict dist/*
	$(PY) tools/check_dist.py dist/*.whl --uv build/uv/bin/uv
	$(PY) tools/check_dist.py dist/*.whl --uv build/uv/bin/uv --lowest

bench: .venv/installed ## Measure speed and memory
	$(PY) -m benchmarks
	$(PY) -m benchmarks.parsing
	$(PY) -m benchmarks.odometry
	$(PY) -m benchmarks.track_hour
	$(PY) -m benchmarks.reading
	$(PY) -m benchmarks.verifying
	$(PY) -m benchmarks.drives

crash: .venv/installed ## Kill writers, cut the power, damage maps (COUNT=500: some minutes; 10000: hours)
	$(PY) -m tests.crash.kills $(shell expr $(or $(COUNT),500) / 10)
	$(PY) -m tests.crash.failures 40
	$(PY) -m tests.crash.power $(or $(COUNT),500)
	$(PY) -m tests.crash.damages $(or $(COUNT),500) --cells 0::$(shell expr 10000 / $(or $(COUNT),500))
	$(PY) -m tests.crash.exports $(shell expr $(or $(COUNT),500) / 50)
	$(PY) -m tests.crash.writers $(shell expr $(or $(COUNT),500) / 200)
	$(PY) -m tests.crash.builds 20
	$(PY) -m tests.crash.live 100

heading: .venv/installed ## Measure heading and gear on real logs, where they are at hand
	$(PY) -m benchmarks.heading
	$(PY) -m benchmarks.heading_shunts
	$(PY) -m benchmarks.variations
	$(PY) -m benchmarks.transformed
	$(PY) -m benchmarks.stretches
	$(PY) -m benchmarks.damages
	$(PY) -m benchmarks.late_fixes
	$(PY) -m benchmarks.faults

accuracy: .venv/installed ## Measure the accuracy of maps, mounts, clocks, alignment and changes
	$(PY) -m benchmarks.accuracy
	$(PY) -m benchmarks.row_step
	$(PY) -m benchmarks.rectified
	$(PY) -m benchmarks.mounting
	$(PY) -m benchmarks.clock
	$(PY) -m benchmarks.align 100
	$(PY) -m benchmarks.poor_receivers
	$(PY) -m benchmarks.good_receivers
	$(PY) -m benchmarks.changes
	$(PY) -m benchmarks.moved

figures: .venv/installed ## Freeze what the measurements print in benchmarks/frozen.json (PARTS="rows moved"; all: two hours)
	$(PY) -m benchmarks.frozen --write $(PARTS)

compare: .venv/installed ## Measure again and print what moved beyond its tolerance (PARTS="rows moved"; all: two hours)
	$(PY) -m benchmarks.frozen $(PARTS)

fuzz: .venv/installed ## Feed every parser hostile input (SECONDS=30 each); counts go on from run to run
	$(PY) -m fuzz --seconds $(or $(SECONDS),30)

format: .venv/installed ## Format the code and fix what can be fixed
	$(BIN)/ruff check --fix-only $(SOURCES)
	$(BIN)/ruff format $(SOURCES)

lock: build/uv/bin/uv ## Bring requirements.lock up to date with pyproject.toml (UPGRADE=1: newest versions)
	build/uv/bin/uv pip compile --quiet --universal --generate-hashes --no-header --no-annotate \
		--python-version 3.11 --all-extras $(if $(UPGRADE),--upgrade) pyproject.toml -o requirements.lock
	@! grep -n '://' requirements.lock || { echo "requirements.lock must name no host"; exit 1; }

clean: ## Remove everything made here, .venv included
	rm -rf .venv build dist .hypothesis .mypy_cache .pytest_cache .ruff_cache src/*.egg-info
	find src tests tools $(wildcard benchmarks examples fuzz) -name __pycache__ -prune -exec rm -rf {} +

# The environment is remade when the lock changes, so that it holds the lock and no more.
.venv/locked: requirements.lock
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("fieldgrid needs Python 3.11 or newer, not " + sys.version.split()[0] + ": make PYTHON=python3.11")'
	@echo "Installing the locked requirements into .venv (a minute or so)"
	@$(PYTHON) -m venv --clear .venv
	@$(PIP) install --require-hashes -r requirements.lock
	@touch $@

.venv/installed: .venv/locked pyproject.toml
	@echo "Installing fieldgrid into .venv, editable"
	@$(PIP) install --no-deps --no-build-isolation -e .
	@$(BIN)/pip --disable-pip-version-check check >.venv/pip-check || { cat .venv/pip-check; echo "If pyproject.toml has changed: make lock"; exit 1; }
	@touch $@

build/uv/bin/uv:
	@echo "Installing uv into build/uv"
	@$(PYTHON) -m venv build/uv
	@build/uv/bin/pip -qq --disable-pip-version-check install uv
