PYTHON ?= .venv/bin/python
WITHOUT_SHARED = $(if $(wildcard ../shared/scenes), , and not shared)# tests of the reference scenes and streams need ../shared
unexport PYTHONDONTWRITEBYTECODE# without bytecode files each process of the tests compiles its sources again, one to two seconds

.PHONY: install test nightly nightly-lockstep nightly-real-time lint safety hostile soak sim results measure measure-long clean

install:
	./install.sh dev

# The gate, as .ci/run runs it: kernels, fast tests, one mission in lockstep, then one short flight in real time.
test:
	$(PYTHON) -m uav_recon compile
	$(PYTHON) -m pytest -n 2 --dist loadfile -m 'not nightly and not real_time$(WITHOUT_SHARED)'
	$(PYTHON) -m pytest -m 'real_time and not nightly' tests/scenarios/test_real_time_flight.py

# Everything: all fault scenarios of the tests, 1,000 maps, real time, mutants of the guard, hostile input, a soak of five minutes.
nightly: nightly-lockstep nightly-real-time safety hostile
	$(MAKE) soak SOAK=G9-5min

nightly-lockstep:
	$(PYTHON) -m pytest -n 2 --dist loadfile -m 'not real_time$(WITHOUT_SHARED)'

nightly-real-time:
	$(PYTHON) -m pytest -m 'real_time$(WITHOUT_SHARED)'

lint:
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m ruff check .
	$(PYTHON) -m mypy

# The guard: every branch of it taken by its own tests, then each of its operators and numbers broken once to see whether they
# notice: some 3500 mutants, about half an hour of one core.
safety: export PYTHONPATH = .:tests/safety
safety:
	$(PYTHON) -m coverage run --branch --include='uav_recon/safety/*,uav_recon/types/polygon.py,uav_recon/types/min_range_grid.py' -m pytest -q tests/safety tests/types
	$(PYTHON) -m coverage report --show-missing --fail-under=100
	rm -f mutation.sqlite
	$(PYTHON) -m cosmic_ray.cli init tests/safety/mutation.toml mutation.sqlite
	$(PYTHON) tests/safety/mutants.py mutation.sqlite $(if $(JSON),--json $(JSON))

# A million hostile proposals to the guard, ten megabytes of garbage and forged frames to the link, two hundred broken configs
# to the pilot; fails for one that has an effect.
hostile: export PYTHONPATH = .:tests/safety
hostile:
	$(PYTHON) tests/autopilot/link/hostile_traffic.py 10000000 500
	$(PYTHON) tests/app/mutated_configs.py 200
	$(PYTHON) tests/safety/hostile_proposals.py 1000000

# One flight of two hours with all processes; memory and descriptors once a second, in soak.svg. SOAK=G9-5min is a shorter one.
SOAK ?= G9-2h
soak:
	$(PYTHON) -m uav_recon faults --only $(SOAK) --real-time --autopilot px4 --seeds 1 --out flights/$(SOAK)

# results/README.md, results/history.csv, docs/hazards.md, docs/limits.md and the figures in README.md, from results/claims.toml,
# results/current/*.json and marked constants. Writes nothing if nothing was measured or changed since.
results:
	$(PYTHON) -m results.generate

# Measures claims: each command of results/claims.toml writes its results/current/*.json. On a machine with nothing else to do
# about one and a half hours, `measure-long` about four hours more. RUNS="planner help" measures these only.
RUNS ?=
measure:
	$(PYTHON) -m results.measure $(RUNS)
	$(PYTHON) -m results.generate

measure-long:
	$(PYTHON) -m results.measure --long $(RUNS)
	$(PYTHON) -m results.generate

sim:
	$(PYTHON) -m uav_recon sim

clean:
	rm -rf .venv flights build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache
