# Short names for the commands of every day; the README and .ci/run do not need them.
PYTHON ?= .venv/bin/python

.PHONY: install test lint sim clean

install:
	python3 -m venv .venv
	.venv/bin/pip install -q -e '.[dev]'

test:
	$(PYTHON) -m pytest

lint:
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m ruff check .
	$(PYTHON) -m mypy

sim:
	$(PYTHON) -m uav_recon.cli sim

clean:
	rm -rf .venv flights build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache
