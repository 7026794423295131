# The handful of commands that people type. `make demo` and `make test` need nothing but
# python3.11, make and a package registry; everything else happens inside .venv.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
RUNS ?= runs

.PHONY: demo test lint types layers check wheel bench-figures docs study study-thesis study-identification study-diagnosis study-kills study-endurance study-causes study-fuzz study-actuators study-compensation clean help

demo: $(READY)  ## play quick_look on the simulated bench: run, model, figures, ladder, report
	$(BIN)/piezo-rig run quick_look --out $(RUNS)
	@run="$$(ls -t $(RUNS)/quick_look_*.h5 | head -n 1)"; set -x; \
	$(BIN)/piezo-rig diagnose "$$run" --figure "$${run%.h5}_ladder.png" --report "$${run%.h5}.html"

test: $(READY)  ## the test suite
	$(BIN)/python -m pytest -n 2 --dist worksteal

lint: $(READY)  ## style
	$(BIN)/ruff check .

types: $(READY)  ## types
	$(BIN)/mypy

layers: $(READY)  ## who may import whom
	$(BIN)/lint-imports

check: lint types layers test  ## everything that CI looks at, but the wheel

wheel: $(READY)  ## build the wheel, install it elsewhere, run it in an empty folder
	PYTHON=$(PYTHON) BUILD=$(abspath $(BIN))/python tests/wheel/try_wheel.sh

bench-figures: $(READY)  ## speed, as ratios to named references
	$(BIN)/python -m benchmarks $(if $(PEER_PYTHON),--peer-python $(PEER_PYTHON))

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	$(BIN)/python -m piezo_rig.warm_up
	touch $@

study: study-thesis study-identification study-diagnosis study-kills study-endurance study-causes study-fuzz study-actuators study-compensation  ## everything that docs/ claims, measured again

study-identification: $(READY)  ## do the bands of an identification hold? docs/identification.md
	$(BIN)/python -m piezo_rig.studies.identification

HIDDEN = $(BIN)/python -m piezo_rig.studies.diagnosis
ROWS = build/study-diagnosis
ONE = initiation-stage,range-dependence,creep,rate-dependence,amplifier-lag,time-skew,thermal-drift,mains-hum,periodic-nonlinearity,outliers

study-diagnosis: $(READY)  ## hidden effects, nulls and strangers, docs/diagnosis.md; 40 minutes
	mkdir -p $(ROWS)
	$(HIDDEN) run --jobs 2 --kinds null --seeds 0:120 --protocols matrix,rates --noises white,ar,1/f --out $(ROWS)/nulls.jsonl
	$(HIDDEN) run --jobs 2 --kinds $(ONE) --seeds 0:4 --protocols matrix,rates,holds --noises white,1/f --d-prime 40 --out $(ROWS)/effects.jsonl
	$(HIDDEN) run --jobs 2 --kinds stranger --seeds 0:20 --protocols matrix --noises white,1/f --d-prime 40 --out $(ROWS)/strangers.jsonl
	$(HIDDEN) document $(ROWS)/nulls.jsonl $(ROWS)/effects.jsonl $(ROWS)/strangers.jsonl --out docs/diagnosis.md

study-causes: $(READY)  ## which cause is taken for which under which protocol, docs/causes.md
	$(BIN)/python -m piezo_rig.studies.causes

study-thesis: $(READY)  ## plays the thesis on the simulated bench, writes docs/thesis.md
	$(BIN)/python -m piezo_rig.studies.thesis

study-actuators: $(READY)  ## 500 simulated actuators at once, docs/many-actuators.md; 20 minutes
	$(BIN)/python -m piezo_rig.studies.actuators

study-kills: $(READY)  ## kills the runner 200 times, writes docs/kills.md; 10 minutes
	$(BIN)/python -m piezo_rig.studies.kills run --out build/study-kills.jsonl
	$(BIN)/python -m piezo_rig.studies.kills document build/study-kills.jsonl

study-endurance: $(READY)  ## a day of bench time: memory, threads, open files; docs/endurance.md
	$(BIN)/python -m piezo_rig.studies.endurance

study-fuzz: $(READY)  ## a hundred thousand hostile files, docs/hostile-files.md; 30 minutes
	nice -n 10 $(BIN)/python -m piezo_rig.studies.fuzz --inputs 100000 --folder build/study-fuzz

study-compensation: $(READY)  ## targets with and without compensation, docs/compensation.md; 10 minutes
	$(BIN)/python -m piezo_rig.studies.compensation

docs: $(READY)  ## write what the documents take from the program itself
	$(BIN)/python -m tests.docs.write

clean:  ## remove what was made (runs stay)
	rm -rf $(VENV) dist build .mypy_cache .ruff_cache .pytest_cache .hypothesis

help:  ## this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/'
