# Every target does its own set-up: a virtual environment in .venv with the locked versions.
#   make reproduce-table5 [DATA=synthetic|open_mocap|humanml3d|kit_ml] [SCALE=smoke|tiny|paper] [LAUNCHER=none|joblib|slurm]
PYTHON ?= python3
VENV   ?= .venv
DATA   ?= synthetic
SCALE  ?= smoke
LAUNCHER ?= none
ARGS   ?=
PY     := $(VENV)/bin/python
STAMP  := $(VENV)/.installed

.PHONY: install test lint bench demo doctor reproduce-all reproduce-bad-figure2 clean-reports
install: $(STAMP)

# torch first and pinned: an open range would pull gigabytes of CUDA wheels onto a CPU machine.
$(STAMP): pyproject.toml requirements.lock
	test -x $(PY) || $(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check "$$(grep '^torch==' requirements.lock)"
	$(PY) -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(PY) -m pip install --quiet --disable-pip-version-check --no-deps -e .
	touch $@

test: $(STAMP)
	$(PY) -m pytest $(ARGS)

lint: $(STAMP)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

bench: $(STAMP)
	for script in benchmarks/*.py; do echo "== $$script"; $(PY) $$script || exit 1; done

doctor: $(STAMP)
	$(PY) -m kinema.experiments.doctor data=$(DATA) $(ARGS)

# make reproduce-table5, ...: one file of conf/table each.
reproduce-%: $(STAMP)
	$(PY) -m kinema.experiments.reproduce $* data=$(DATA) scale=$(SCALE) launcher=$(LAUNCHER) $(ARGS)

# Figure 2 of the BAD paper, drawn from the masks in use.
reproduce-bad-figure2: $(STAMP)
	$(PY) -m kinema.experiments.figures.bad_masks --out reports/bad-figure2

reproduce-all: $(patsubst conf/table/%.yaml,reproduce-%,$(wildcard conf/table/*.yaml))

# A motion from a sentence, with the generator of the last table at this scale.
demo: reproduce-table5
	$(VENV)/bin/kinema generate "a person waves with the left hand" \
	  --run $$(dirname $$(ls -t runs/generator/mardm_sit-*/weights.safetensors | head -1)) --seconds 4 --out reports/demo.html

clean-reports:
	rm -rf reports
