# `make demo` and `make test` need Python 3.11 or later and nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
OUT ?= demo

.PHONY: demo test lint docs fuzz pictures bench lock clean

demo: $(READY)
	$(BIN)/energyplan demo --out $(OUT)

test: $(READY) lint
	$(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(READY)
	$(BIN)/sphinx-build -W --keep-going -q -b html docs docs/_build

# Nightly: FUZZ malformed inputs for every reader, by two fuzzers, and for every command.
# Machines share the work by FUZZ_ONLY="atheris:*.csv command:plan"; FUZZ_ONLY=--list names all.
FUZZ ?= 100000
FUZZ_JOBS ?= 2
FUZZ_ONLY ?= *
fuzz: $(READY)
	@set -f; $(BIN)/python tests/fuzz/nightly.py --runs $(FUZZ) --jobs $(FUZZ_JOBS) $(FUZZ_ONLY)

# The pictures of the README and the documentation, drawn by the demo and the examples.
pictures: demo
	mkdir -p docs/pictures
	cp $(OUT)/*.png docs/pictures/
	$(BIN)/python examples/plan_depot.py --goal 20,12,90 --out $(OUT)/plan_depot
	cp $(OUT)/plan_depot/pareto.png docs/pictures/
	$(BIN)/python docs/draw.py

# Every figure of the benchmark pages, measured on this machine. Takes a while.
bench: $(READY)
	@for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

lock: $(READY)
	$(BIN)/uv pip compile --universal --python-version 3.11 --generate-hashes --group dev \
		--all-extras --no-header --quiet --upgrade pyproject.toml -o requirements-dev.lock

$(READY): requirements-dev.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("energyplan needs Python 3.11 or later; set PYTHON=/path/to/python3.11")'
	@echo "creating the environment in $(VENV) (about a minute)"
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	@touch $(READY)

clean:
	rm -rf $(VENV) build dist demo .pytest_cache .mypy_cache .ruff_cache .hypothesis
