# Two commands set everything up on a machine with Python 3.11 or newer: `make demo`, `make test`.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo check pytest test docs wheel clean

demo: $(VENV)/installed
	$(BIN)/stylesplat demo -o demo-output

check: $(VENV)/installed-dev
	$(BIN)/ruff check --no-cache .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright

# Processes that tests start import what the first of them has compiled
pytest: $(VENV)/installed-dev
	PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -q -n 2 --dist worksteal

# Both at once: basedpyright has one thread
test: $(VENV)/installed-dev
	+$(MAKE) --no-print-directory --jobs=2 check pytest

# Builds the documentation site into site/: a dead link or an unknown name fails, and nothing is downloaded
docs: $(VENV)/installed-docs
	$(BIN)/mkdocs build --strict

# Builds sdist and wheel into dist/, and runs the demo of the wheel in an environment without the checkout
wheel:
	$(PYTHON) scripts/check_wheel.py

clean:
	rm -rf $(VENV) demo-output dist site

# Of what is installed Python compiles, later, what is imported: that is sooner than all of it
$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --no-compile --editable '.[photos,view]' --constraint constraints.txt
	touch $@

$(VENV)/installed-dev: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --editable '.[dev]' --constraint constraints.txt
	touch $(VENV)/installed $@

$(VENV)/installed-docs: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --no-compile --editable '.[docs]' --constraint constraints.txt
	touch $(VENV)/installed $@
