# Every target does its own set-up: a virtual environment in .venv with the locked versions.
#   make reproduce-table5 [DATA=synthetic|open_mocap|humanml3d|kit_ml] [SCALE=smoke|tiny|paper] [SEEDS=3] [PLAN=1]
#     [LAUNCHER=local|joblib|submitit_local|slurm]
PYTHON ?= python3
VENV   ?= .venv
DATA   ?= synthetic
SCALE  ?= smoke
LAUNCHER ?= local
SEEDS  ?=
PLAN   ?=
ARGS   ?=
PY     := $(VENV)/bin/python
KINEMA := $(VENV)/bin/kinema
PIP    := $(PY) -m pip install --quiet --disable-pip-version-check
STAMP  := $(VENV)/.installed
DOCS   := $(VENV)/.docs
GRADIO := $(abspath $(VENV)/demo)
TABLES := $(patsubst conf/table/%.yaml,%,$(wildcard conf/table/*.yaml))
PAGES  := $(patsubst conf/page/%.yaml,%,$(wildcard conf/page/*.yaml))
# The tables that have a panel of KIT-ML, and the corpus that it is of beside DATA.
PANELS := $(patsubst conf/table/%.yaml,%,$(shell grep -l '^  kit_ml:' conf/table/*.yaml))
KIT_OF_synthetic := synthetic_kit
KIT_OF_humanml3d := kit_ml
KIT    := $(KIT_OF_$(DATA))
# Pages say themselves how often they train; a plan runs nothing.
FLAGS   = $(if $(filter $*,$(TABLES)),$(if $(SEEDS),--seeds $(SEEDS))) $(if $(PLAN),--plan)

.PHONY: help install test test-demo lint docs bench demo doctor readers site reproduce-all reproduce-bad-figure2 clean-reports

# `target: needs  ## what it does` is what is listed; tables and pages are listed by their titles.
help:  ## list the targets
	@sed -nE 's/^([a-z][a-z0-9-]*):.*  ## (.*)/\1\t\2/p' Makefile | while IFS="$$(printf '\t')" read -r name what; do \
	  printf '  %-30s %s\n' "$$name" "$$what"; done
	@for file in $(TABLES:%=conf/table/%.yaml) $(PAGES:%=conf/page/%.yaml); do \
	  printf '  %-30s %s\n' "reproduce-$$(basename $$file .yaml)" "$$(sed -n 's/^title: //p' $$file)"; done
	@echo 'Variables: DATA=$(DATA) SCALE=$(SCALE) LAUNCHER=$(LAUNCHER) SEEDS= PLAN= ARGS= (any overrides) VENV=$(VENV) PYTHON=$(PYTHON)'

install: $(STAMP)  ## make .venv with the locked versions and this package, editable

# torch first and pinned: an open range would pull gigabytes of CUDA wheels onto a CPU machine.
$(STAMP): pyproject.toml setup.py requirements.lock
	test -x $(PY) || $(PYTHON) -m venv $(VENV)
	$(PIP) "$$(grep '^torch==' requirements.lock)"
	$(PIP) -r requirements.lock
	$(PIP) --no-deps --no-build-isolation -e .
	touch $@

$(DOCS): $(STAMP) requirements-docs.lock
	$(PIP) -r requirements-docs.lock
	touch $@

# Beside the environment, not in it: gradio is large, and holds other packages back (pillow).
$(GRADIO)/.installed: $(STAMP) requirements-demo.lock
	rm -rf $(GRADIO)
	$(PIP) --no-deps --target $(GRADIO) -r requirements-demo.lock
	touch $@

test: $(STAMP)  ## run the tests, on all cores (ARGS="-k word", ARGS="-m 'not slow'", ARGS="-n 0")
	OMP_NUM_THREADS=1 $(PY) -m pytest -n auto --dist loadfile $(ARGS)

test-demo: $(GRADIO)/.installed  ## run the tests of `kinema demo`, with gradio (ARGS as above)
	PYTHONPATH=$(GRADIO) OMP_NUM_THREADS=1 $(PY) -m pytest -n 0 tests/demo $(ARGS)

readers:  ## fetch three.js and gltf-validator, pinned, which tests/readback reads exports with (npm)
	npm --prefix tests/readback install --ignore-scripts --no-audit --no-fund --no-package-lock
	npm --prefix tests/readback run build

lint: $(STAMP)  ## check style and format
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

docs: $(DOCS)  ## build the documentation as a site, in site/; any warning fails
	PATH="$(abspath $(VENV))/bin:$$PATH" NO_MKDOCS_2_WARNING=1 mkdocs build

bench: $(STAMP)  ## run every benchmark
	for script in benchmarks/*.py; do echo "== $$script"; $(PY) $$script || exit 1; done

doctor: $(STAMP)  ## examine the corpus DATA
	$(KINEMA) doctor data=$(DATA) $(ARGS)

# One file of conf/table or conf/page each.
reproduce-%: $(STAMP)
	$(KINEMA) reproduce $* data=$(DATA) scale=$(SCALE) launcher=$(LAUNCHER) $(FLAGS) $(ARGS)

reproduce-bad-figure2: $(STAMP)  ## draw Figure 2 of the BAD paper from the masks in use
	$(KINEMA) figures bad_masks --out reports/bad-figure2

# The KIT panel of a table, beside the other one.
reproduce-%-kit: $(STAMP)
	$(KINEMA) reproduce $* data=$(KIT) scale=$(SCALE) launcher=$(LAUNCHER) $(FLAGS) $(ARGS) --out reports/$*-kit

reproduce-all: $(STAMP)  ## reproduce every table, figure and page, and the panels of KIT-ML beside them
	$(KINEMA) reproduce $(TABLES) $(PAGES) data=$(DATA) scale=$(SCALE) launcher=$(LAUNCHER) $(if $(SEEDS),--seeds $(SEEDS)) $(if $(PLAN),--plan) $(ARGS)
	$(MAKE) reproduce-bad-figure2 $(if $(KIT),$(PANELS:%=reproduce-%-kit))
	$(KINEMA) site

site: $(STAMP)  ## write reports/index.html, a site over all that lies under reports/
	$(KINEMA) site

demo: $(GRADIO)/.installed  ## open a page to try the package's model in the browser (ARGS="--run RUN": another)
	PYTHONPATH=$(GRADIO) $(KINEMA) demo $(ARGS)

clean-reports:  ## delete reports/ (runs, stores and cache are kept)
	rm -rf reports
