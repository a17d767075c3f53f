# make demo    train and evaluate recipes/quickstart.yaml
# make test    every test
# make check   what .ci/run checks of the sources: ruff, mypy, tests
# make comparison   the paper's comparison from nothing: says first how long it takes, goes on where it was stopped
# make clean   remove what the above made; runs/ stays

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
WORKERS ?= 2

# Two test workers or environments share the cores: one thread each is faster than both taking all.
export OMP_NUM_THREADS ?= 1

.PHONY: demo test lint check comparison clean

demo: $(READY)
	$(BIN)/me3bev train quickstart
	$(BIN)/me3bev eval --maps T3 --density low --episodes 4

test: $(READY)
	$(BIN)/python -m pytest -n $(WORKERS)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy me3bev_cli plugins

check: lint test

comparison: $(READY)
	$(BIN)/python -m me3bev_cli.bench.comparison --results recipes/results/comparison

# The marker is written last: an installation that was cut short starts again.
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(None if sys.version_info >= (3, 11) else "me3bev needs Python 3.11 or newer: make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --constraint constraints.txt --editable '.[test]'
	touch $(READY)

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
