# `make demo` and `make test` need Python 3.11 or later and nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DOCS_READY := $(VENV)/.docs-ready
NIGHTLY_READY := $(VENV)/.nightly-ready
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
OUT ?= demo

.PHONY: demo test compiled nightly shuffled installed lint docs fuzz mutate recheck lowest pictures loop notebooks bench guards gates pages dist lock release clean

demo: $(READY)
	$(BIN)/energyplan demo --out $(OUT)

# Bytecode is kept even where the environment says otherwise: the tests start many processes.
test: export PYTHONDONTWRITEBYTECODE =
test: $(READY) lint compiled
	$(BIN)/python -m pytest -n 2 --dist worksteal

# Kernels are compiled ahead, by both processors: else both processes of the tests compile each.
compiled: $(READY)
	$(BIN)/energyplan warmup

# Nightly: the larger cases of what the suite tries with smaller ones.
nightly: $(NIGHTLY_READY)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "nightly or hypothesis" \
		--hypothesis-profile=varied

# The suite ROUNDS times, each in another order, with two busy processes beside it.
ROUNDS ?= 10
shuffled: $(READY)
	@for load in 1 2; do $(BIN)/python -c 'while True: pass' & busy="$$busy $$!"; done; \
	trap 'kill $$busy' EXIT; \
	for round in $$(seq $(ROUNDS)); do \
		$(BIN)/python -m pytest -p randomly -n 2 --dist worksteal -q || exit 1; \
	done

# The suite with the oldest releases that pyproject.toml admits; the oldest test client needs httpx.
lowest: $(READY)
	$(PYTHON) -m venv --clear build/lowest
	$(BIN)/uv pip install --quiet --python build/lowest/bin/python --resolution lowest-direct \
		--all-extras --group test -r pyproject.toml 'httpx>=0.27,<0.28'
	$(BIN)/uv pip install --quiet --python build/lowest/bin/python --no-deps .
	build/lowest/bin/python -m pytest -n 2 --dist worksteal tests

# Nightly: every command and block of every page, every example and notebook, in a plain install.
# They run beside copies of the pages, where there is no folder of the library to be imported.
INSTALLED := build/installed
installed:
	$(PYTHON) -m venv --clear $(INSTALLED)
	$(INSTALLED)/bin/python -m pip install --quiet --disable-pip-version-check \
		--require-hashes -r requirements-test.lock
	$(INSTALLED)/bin/python -m pip install --quiet --disable-pip-version-check \
		--no-build-isolation --no-deps .
	mkdir $(INSTALLED)/tree
	cp -r README.md pyproject.toml benchmarks docs examples maps tests $(INSTALLED)/tree
	cd $(INSTALLED)/tree && ../bin/python -m pytest -n 2 --dist worksteal -m "" \
		-k "run or runs or prints or demo" tests/docs/test_docs.py

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy --config-file benchmarks/mypy.ini
	$(BIN)/lint-imports

docs: $(DOCS_READY)
	$(BIN)/sphinx-build -W --keep-going -q -b html docs docs/_build

# Nightly: FUZZ malformed inputs for every reader and every command, drawn by hypothesis.
# Machines share the work by words of the tests' names: FUZZ_ONLY="readers and csv".
FUZZ ?= 100000
FUZZ_JOBS ?= 2
FUZZ_ONLY ?= refuse
fuzz: $(READY)
	ENERGYPLAN_FUZZ=$(FUZZ) $(BIN)/python -m pytest tests/io/test_fuzz.py \
		-n $(FUZZ_JOBS) -k "$(FUZZ_ONLY)"

# Changes each module in ten places, and prints what no test notices.
MUTATE ?= *
mutate: $(NIGHTLY_READY)
	@set -f; $(BIN)/python tests/mutation.py $(MUTATE)

# Nightly: fails where a module is not recorded, or tests notice fewer than eight of its changes.
recheck: $(NIGHTLY_READY)
	@set -f; $(BIN)/python tests/mutation.py --recheck $(MUTATE)

# Nightly: 60 robots with hidden effects in the physics engine, and 40 without.
LOOP ?= 60
loop: $(READY)
	$(BIN)/python benchmarks/loop.py none 40
	$(BIN)/python benchmarks/loop.py hidden $(LOOP)

# The pictures of the README and the documentation, drawn by the demo and the examples.
pictures: demo
	mkdir -p docs/pictures
	cp $(OUT)/routes/demo_driven.json examples/
	cp $(OUT)/mission-charge.png $(OUT)/prediction-quadriga-full-marble.png docs/pictures/
	$(BIN)/python examples/plan_depot.py --goal 20,12,90 --out $(OUT)/plan_depot
	cp $(OUT)/plan_depot/routes.png docs/pictures/
	$(BIN)/python docs/draw.py
	$(BIN)/python docs/figures.py
	$(BIN)/python docs/animate.py

# The notebooks of the documentation, run from top to bottom and stored with their results.
notebooks: $(NIGHTLY_READY)
	$(BIN)/python docs/notebooks/run.py

# Figures that must not get worse, on small samples that every change runs.
guards: $(READY)
	@$(BIN)/python benchmarks/gates.py --guards

# All figures that must not get worse; ONLY="willow*" for some of them.
ONLY ?= *
gates: $(READY)
	@$(BIN)/python benchmarks/gates.py --only "$(ONLY)"

# Nightly: tables of the pages are made anew; fails where a figure differs, times of a CPU apart.
# Those of recorded drives and of many robots wait for who has the data and the hours (`bench`).
pages: $(READY)
	$(BIN)/python benchmarks/pages.py docs/planning.md CONTRIBUTING.md

# What is published: source and wheel; with TAG, only where it names this version.
dist: $(READY)
	rm -rf dist
	@version=$$($(BIN)/python -c 'import energyplan; print(energyplan.__version__)'); \
	[ "v$$version" = "$(or $(TAG),v$$version)" ] || { echo "$(TAG) is not version $$version"; exit 1; }
	$(BIN)/python -m build --no-isolation .

# Every figure of the benchmark pages, measured on this machine. Takes a while.
bench: $(READY)
	@for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

LOCK = $(BIN)/uv pip compile --universal --python-version 3.11 --generate-hashes --all-extras \
	--no-header --quiet pyproject.toml
lock: $(READY)
	$(LOCK) --upgrade --group test -o requirements-test.lock
	$(LOCK) --group test --group docs -c requirements-test.lock -o requirements-docs.lock
	$(LOCK) --group test --group nightly -c requirements-test.lock -o requirements-nightly.lock

# What VERSION needs before it is tagged; prints what to do then, and changes nothing.
RELEASED = energyplan/__init__.py CITATION.cff ros/energyplan_interfaces/package.xml \
	ros/energyplan_ros/package.xml ros/energyplan_ros/setup.py
release:
	@stop() { echo "release: $$1" >&2; exit 1; }; \
	[ "$(VERSION)" ] || stop "give the version, as in make release VERSION=1.2.3"; \
	for file in $(RELEASED); do \
		grep -qE 'version(__ = |: |=|>)"?$(subst .,\.,$(VERSION))(["<]|$$)' $$file \
			|| stop "$$file has another version"; \
	done; \
	grep -q '^## $(VERSION)$$' CHANGELOG.md || stop "CHANGELOG.md has no section $(VERSION)"; \
	! grep -q '^## Unreleased' CHANGELOG.md || stop "CHANGELOG.md has a section Unreleased"; \
	! grep -q 'github.com/OWNER/' pyproject.toml \
		|| stop "pyproject.toml: fill in the owner's name under project.urls"; \
	[ -z "$$(git status --porcelain)" ] || stop "the tree holds what is not committed"; \
	[ -z "$$(git tag --list v$(VERSION))" ] || stop "the tag v$(VERSION) is there already"; \
	echo "Ready. The tag starts the workflow that tests, builds and publishes:"; \
	echo "    git tag --annotate v$(VERSION) --message v$(VERSION) && git push origin v$(VERSION)"

$(READY): requirements-test.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("energyplan needs Python 3.11 or later; set PYTHON=/path/to/python3.11")'
	@echo "creating the environment in $(VENV) (about a minute)"
	$(PYTHON) -m venv --clear $(VENV)
	$(PIP) --require-hashes -r requirements-test.lock
	$(PIP) --no-build-isolation --no-deps -e .
	@touch $(READY)

$(DOCS_READY): requirements-docs.lock $(READY)
	$(PIP) --require-hashes -r requirements-docs.lock
	@touch $@

$(NIGHTLY_READY): requirements-nightly.lock $(READY)
	$(PIP) --require-hashes -r requirements-nightly.lock
	@touch $@

clean:
	rm -rf $(VENV) build dist demo .pytest_cache .mypy_cache .ruff_cache .hypothesis
