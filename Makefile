# The handful of commands that people type. `make demo` and `make test` need nothing but
# python3.11, make and a package registry; everything else happens inside .venv.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
READY := $(VENV)/.ready
RUNS ?= runs

.PHONY: demo test lint types layers check wheel bench-figures docs study study-recordings study-thesis study-identification study-diagnosis study-kills study-endurance study-causes study-fuzz study-actuators study-compensation clean help

demo: $(READY)  ## play quick_look on the simulated bench: run, model, figures, ladder, report
	$(BIN)/piezo-rig run quick_look --out $(RUNS)
	@run="$$(ls -t $(RUNS)/quick_look_*.h5 | head -n 1)"; set -x; \
	$(BIN)/piezo-rig diagnose "$$run" --figure "$${run%.h5}_ladder.png" --report "$${run%.h5}.html"

test: $(READY)  ## the test suite
	$(BIN)/python -m pytest -n 2 --dist worksteal

lint: $(INSTALLED)  ## style
	$(BIN)/ruff check .

types: $(INSTALLED)  ## types
	$(BIN)/mypy

layers: $(INSTALLED)  ## who may import whom
	$(BIN)/lint-imports

check: lint types layers test  ## everything that CI looks at, but the wheel

wheel:  ## build the wheel, install it elsewhere, run it in an empty folder
	PYTHON=$(PYTHON) tests/wheel/try_wheel.sh $(WHEEL)

bench-figures: $(READY)  ## speed, as ratios to named references
	$(BIN)/python -m benchmarks $(if $(PEER_PYTHON),--peer-python $(PEER_PYTHON))

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt --upgrade pip
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

$(READY): $(INSTALLED)
	$(BIN)/python -m piezo_rig.warm_up
	touch $@

study: wheel study-recordings study-thesis study-identification study-diagnosis study-kills study-endurance study-causes study-fuzz study-actuators study-compensation  ## everything that docs/ claims, measured again

study-identification: $(READY)  ## do the bands of an identification hold? docs/identification.md
	$(BIN)/python -m piezo_rig.studies.identification

HIDDEN = $(BIN)/python -m piezo_rig.studies.diagnosis
ROWS = build/study-diagnosis
EFFECTS = initiation-stage,range-dependence,extremum-dependence,direction-asymmetry,creep,rate-dependence,cycle-aging,amplifier-lag,slew-limit,drive-clipping,sensor-clipping,time-skew,clock-ratio,thermal-drift,mains-hum,periodic-nonlinearity,outliers,fringe-jump,dropped-samples,remanence
PLAYED = --protocols matrix,rates,holds --jobs 2

study-diagnosis: $(READY)  ## hidden effects, pairs, triples, nulls and strangers, docs/diagnosis.md; an hour
	mkdir -p $(ROWS)
	$(HIDDEN) run $(PLAYED) --kinds null --seeds 9800:9820 --noises white,ar,1/f --out $(ROWS)/nulls.jsonl
	$(HIDDEN) run $(PLAYED) --kinds $(EFFECTS) --seeds 9800 --noises white,ar,1/f --d-prime 40 --out $(ROWS)/effects.jsonl
	$(HIDDEN) run $(PLAYED) --kinds drive-gain,sensor-scale --seeds 9800:9803 --noises white,1/f --d-prime 40 --baseline fixed:classical --out $(ROWS)/fixed.jsonl
	$(HIDDEN) run --protocols matrix,rates,holds,ramps,walk,multisine,one --jobs 2 --kinds pair --seeds 9800:9804 --noises white,1/f --d-prime 40 --out $(ROWS)/pairs.jsonl
	$(HIDDEN) run $(PLAYED) --kinds triple --seeds 9800:9803 --noises white,1/f --d-prime 40 --out $(ROWS)/triples.jsonl
	$(HIDDEN) run $(PLAYED) --kinds stranger --seeds 9800:9806 --noises white --d-prime 60 --out $(ROWS)/strangers.jsonl
	$(HIDDEN) document $(addprefix $(ROWS)/,nulls.jsonl effects.jsonl fixed.jsonl pairs.jsonl triples.jsonl strangers.jsonl) --out docs/diagnosis.md

study-recordings: $(READY)  ## real recordings in full, and tests too slow for every time; about 20 minutes
	$(BIN)/python -m pytest -m study

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
