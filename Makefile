# Everything runs in .venv, with the versions of constraints.txt. `make` alone lists the targets.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Whole files to each process, in their order: what a file's tests share is made once.
PARALLEL := -n auto --dist loadfile --no-loadscope-reorder
# One thread each: threads that wait for each other on busy cores take half as long again.
quick core lowest test: export OMP_NUM_THREADS = 1
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.DEFAULT_GOAL := help
.PHONY: help answer bank demo quick core lowest test docs linkcheck lint bench constraints clean

# What needs neither torch nor trimesh; the rest of the tests needs the extras.
CORE_TESTS := tests/geometry tests/bank $(wildcard tests/test_*.py)
QUICK_TESTS := tests/geometry tests/bank $(filter-out tests/test_wheel.py tests/test_readme.py \
	tests/test_plot.py,$(wildcard tests/test_*.py))

help:
	@echo "make bank    build the default bank into masks_cache/ and draw it"
	@echo "make answer  find the camera of a panorama that comes with slicemask, and draw the answer"
	@echo "make demo    generate two cities, train on one, find cameras in the other, draw it"
	@echo "make quick   run the fast tests of geometry, banks and the command (under a minute)"
	@echo "make core    run all tests that need no torch"
	@echo "make test    run all tests"
	@echo "make lowest  run tests with the lowest versions that pyproject.toml allows (needs uv)"
	@echo "make docs    build the documentation's site into build/docs, tutorials run"
	@echo "make linkcheck   follow the links of the site, also those that lead out of it"
	@echo "make lint    ruff and mypy"
	@echo "make bench   print the benchmark tables"
	@echo "make constraints   write constraints.txt with the newest versions (CONTRIBUTING.md)"
	@echo "make clean   remove the environment and the tools' caches; banks, data and runs stay"

$(VENV)/.core: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "slicemask needs Python 3.11 or newer; name one with make PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(PIP) -e .
	@touch $@

$(VENV)/.test: $(VENV)/.core
	$(PIP) -e '.[test]'
	@touch $@

# torch is asked for by its exact version alone, so that the pinned build is the one taken.
$(VENV)/.full: $(VENV)/.core
	$(PIP) "$$(grep '^torch==' constraints.txt)"
	$(PIP) -e '.[model,weights,compiled,cameras,export,maps,drives,dask,synth,app,test,lint,bench]'
	@touch $@

$(VENV)/.docs: $(VENV)/.full
	$(PIP) -e '.[docs]'
	@touch $@

bank: $(VENV)/.core
	$(BIN)/slicemask build --grid 21x21x64 --hfov 360 --cache masks_cache
	$(BIN)/slicemask visualize masks_cache/21x21x64_hfov360_n16_l32.h5 --out masks_cache/default.png

answer: $(VENV)/.full
	@mkdir -p runs
	$(BIN)/slicemask predict generated-city --example 1 --out runs/answer.png

# Cut short, it goes on where it stopped.
demo: $(VENV)/.full
	$(BIN)/slicemask synth --format vigor --cities 2 --panoramas 400 --seed 1 --panorama-size 512x256 --tile-size 320 --out data/demo
	$(BIN)/slicemask train --config examples/demo.yaml --out runs/demo --resume
	$(BIN)/slicemask evaluate runs/demo --grid 21x21x64 --checkpoint last --limit 100 --out runs/demo/unseen --overwrite
	@echo "pictures: runs/demo/unseen/best.png, median.png, worst.png, errors.png"

quick: $(VENV)/.test
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow" --ignore=tests/bank/test_kill.py $(QUICK_TESTS)

core: $(VENV)/.test
	$(BIN)/python -m pytest $(PARALLEL) $(CORE_TESTS)

# In an environment of its own; what only these packages need comes in the newest versions.
lowest:
	uv venv --quiet --python $(PYTHON) build/lowest
	uv pip install --quiet --python build/lowest --resolution lowest-direct -e '.[model,compiled,cameras,export,maps,drives,dask,synth,app,test]'
	build/lowest/bin/python -m pytest $(PARALLEL) -m "not slow"

test: $(VENV)/.full
	$(BIN)/python -m pytest $(PARALLEL)

# A warning ends it. What has not changed since the last time is not run again.
SPHINX := $(BIN)/python -m sphinx -W --keep-going -d build/doctrees

docs: $(VENV)/.docs
	$(SPHINX) -b html docs build/docs
	@echo "the site: build/docs/index.html"

linkcheck: $(VENV)/.docs
	$(SPHINX) -b linkcheck docs build/linkcheck

lint: $(VENV)/.full
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/.full
	$(BIN)/python -m benchmarks

# What only builds of torch with CUDA need is left out: other builds do without.
constraints:
	$(PYTHON) -m venv --clear build/newest
	build/newest/bin/python -m pip install --quiet -e '.[model,weights,compiled,cameras,export,maps,drives,rerun,dask,synth,app,test,docs,lint,bench]'
	build/newest/bin/python -m pip freeze --exclude-editable > build/newest.txt
	(head -n 1 constraints.txt && sed 's/+[a-z0-9.]*$$//' build/newest.txt \
		| grep -v -e '^nvidia' -e '^cuda') > build/constraints.txt
	mv build/constraints.txt constraints.txt

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .hypothesis .mypy_cache .ruff_cache
	rm -rf docs/auto_* docs/reference/generated docs/sg_execution_times.rst docs/tutorials/*/ docs/gallery/*/
