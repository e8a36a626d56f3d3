# The front door. Every target does the set-up it needs; a second call does no work twice.
#
#   make heartbeat   install what is missing, build, run the main job, say where the pictures are
#   make heartbeat-3d   the same with a left ventricle of 3D tissue on two MPI ranks (installs deal.II and gmsh)
#   make heartbeat-heart   the same with all four chambers and the great arteries of 3D tissue, one body
#   make test        install and build everything, the 3D tissue included, and run all tests
#   make build       install and build; the command is build/wiggers
#   make nightly     the long tests: sanitizers, minimal build, formatting, extremes, kills, fuzzing, benchmarks
#   make fuzz        an hour of fuzzing, guided by coverage, of what reads files; then 2000 changed results (installs clang)
#   make trade       measure the tables of docs/trade.md and docs/extremes.md on this machine
#   make benchmarks-3d  run the published verification problems of the tissue and write docs/benchmarks-3d.md
#   make tissue-tables  measure cost, ranks, main scene and stabilisations of the tissue for docs/tissue-measured.md
#   make trade-3d    measure error against cost of the tissue's settings, for docs/trade-3d.md
#   make cell-cycles   certify the limit cycles of docs/cell-cycles.md
#   make reference   write docs/reference from the models' own fact sheets
#   make format      format the C++ sources
#   make help        these lines
SHELL := /bin/bash
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

PACKAGES := g++ cmake ninja-build git ca-certificates python3-venv python3-dev \
  libeigen3-dev libsundials-dev libhdf5-dev libfmt-dev libboost-dev libtoml11-dev libcli11-dev \
  nlohmann-json3-dev catch2 libbenchmark-dev
TISSUE_PACKAGES := libdeal.ii-dev libgmsh-dev openmpi-bin
NIGHTLY_PACKAGES := clang-format libxsimd-dev openmpi-bin
FUZZ_PACKAGES := clang libclang-rt-14-dev
FUZZ_SECONDS := 900
BUILD := build
PYTHON := .venv/bin/python
JOBS := $(shell nproc)
# Root installs directly, anybody else through sudo.
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)

# $(call install,PACKAGES): apt-get only for what is missing.
define install
	@missing=(); for p in $(1); do dpkg-query -W -f='$${Status}' $$p 2>/dev/null | grep -q 'ok installed' || missing+=($$p); done; \
	if [ $${#missing[@]} -gt 0 ]; then \
	  echo "installing: $${missing[*]}"; \
	  $(SUDO) apt-get update -qq && $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$${missing[@]}" >/dev/null; \
	fi
endef

# Open MPI refuses root, and more ranks than cores, unless told otherwise.
RANKS := 2
MPIRUN := OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1 OMP_NUM_THREADS=1 mpirun -n $(RANKS)

.PHONY: fuzz cell-cycles tissue heartbeat-3d heartbeat-heart benchmarks-3d trade-3d tissue-tables trade help setup packages build test heartbeat nightly format check-format reference clean
help:
	@sed -n 's/^#   //p' Makefile

packages:
	$(call install,$(PACKAGES))

# The virtual environment follows pyproject.toml.
.venv/.ready: pyproject.toml | packages
	@echo "setting up Python in .venv"
	@[ -x $(PYTHON) ] || /usr/bin/python3 -m venv .venv
	@$(PYTHON) -c "import tomllib; d = tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']; print('\n'.join(sum(d.values(), [])))" > .venv/requirements.txt
	@.venv/bin/pip install --quiet --disable-pip-version-check -r .venv/requirements.txt
	@touch $@

setup: packages .venv/.ready

$(BUILD)/build.ninja: CMakeLists.txt cmake/rooms.cmake | setup
	@cmake --preset release -B $(BUILD) -DWIGGERS_PYTHON=$(CURDIR)/$(PYTHON) -DWIGGERS_BINDINGS=ON > $(BUILD).log || { cat $(BUILD).log; rm -f $(BUILD).log; exit 1; }
	@rm -f $(BUILD).log

# deal.II brings its own flavour of HDF5: a build that was configured without it is configured afresh.
tissue: setup $(BUILD)/build.ninja
	$(call install,$(TISSUE_PACKAGES))
	@grep -qs 'WIGGERS_HAS_TISSUE:INTERNAL=ON' $(BUILD)/CMakeCache.txt || { \
	  cmake --fresh --preset release -B $(BUILD) -DWIGGERS_PYTHON=$(CURDIR)/$(PYTHON) -DWIGGERS_BINDINGS=ON -DWIGGERS_TISSUE=ON > $(BUILD).log \
	    || { cat $(BUILD).log; rm -f $(BUILD).log; exit 1; }; rm -f $(BUILD).log; }

build: setup $(BUILD)/build.ninja
	@cmake --build $(BUILD) -j $(JOBS) --target wiggers
	@echo "the command: $(BUILD)/wiggers"

test: tissue
	@cmake --build $(BUILD) -j $(JOBS)
	@ctest --test-dir $(BUILD) --output-on-failure -j $(JOBS) -LE nightly

heartbeat: build
	@mkdir -p heartbeat
	@$(BUILD)/wiggers run scenes/whole_heart.toml -o heartbeat/whole_heart.h5
	@$(BUILD)/wiggers report heartbeat/whole_heart.h5 -o heartbeat/report

heartbeat-3d: tissue
	@cmake --build $(BUILD) -j $(JOBS) --target wiggers wiggers-3d
	@mkdir -p heartbeat-3d
	@$(MPIRUN) $(BUILD)/wiggers-3d run scenes/left_ventricle_3d.toml -o heartbeat-3d/left_ventricle.h5
	@$(BUILD)/wiggers report heartbeat-3d/left_ventricle.h5 -o heartbeat-3d/report
	@echo "fields for ParaView: heartbeat-3d/left_ventricle.LV.fields/index.pvd"

heartbeat-heart: tissue
	@cmake --build $(BUILD) -j $(JOBS) --target wiggers wiggers-3d
	@mkdir -p heartbeat-heart
	@$(MPIRUN) $(BUILD)/wiggers-3d run scenes/whole_heart_3d.toml -o heartbeat-heart/whole_heart.h5
	@$(BUILD)/wiggers report heartbeat-heart/whole_heart.h5 -o heartbeat-heart/report
	@echo "fields for ParaView: heartbeat-heart/whole_heart.heart.fields/index.pvd"

nightly: tissue
	$(call install,$(NIGHTLY_PACKAGES))
	@$(MAKE) --no-print-directory check-format
	@cmake --preset sanitize -DWIGGERS_PYTHON=$(CURDIR)/$(PYTHON) && cmake --build build-sanitize -j $(JOBS)
	@ctest --test-dir build-sanitize --output-on-failure -j $(JOBS)
	@# MPI and gmsh leave memory behind at their end.
	@cmake --preset sanitize-tissue && ASAN_OPTIONS=detect_leaks=0 cmake --build build-sanitize-tissue -j $(JOBS) --target test_tissue
	@ASAN_OPTIONS=detect_leaks=0 OMP_NUM_THREADS=1 build-sanitize-tissue/test_tissue
	@ASAN_OPTIONS=detect_leaks=0 $(MPIRUN) build-sanitize-tissue/test_tissue "[ranks]"
	@cmake --preset minimal && cmake --build build-minimal -j $(JOBS) && ctest --test-dir build-minimal --output-on-failure -j $(JOBS)
	@$(MAKE) --no-print-directory test
	@$(PYTHON) docs/make_cell_cycles.py $(BUILD)/wiggers --check 20
	@for s in $$($(BUILD)/wiggers models --names | grep -v circulation) loop scenes/whole_heart.toml scenes/triseg.toml; do \
	  echo "extremes of $$s"; $(BUILD)/wiggers extremes $$s --quiet > $(BUILD)/extremes.log || { cat $(BUILD)/extremes.log; exit 1; }; done
	@for seed in 2 3 4; do for s in crn ttp06-epi rdq20 loop; do \
	  $(BUILD)/wiggers extremes $$s --quiet --beats 1 --seed $$seed > $(BUILD)/extremes.log || { cat $(BUILD)/extremes.log; exit 1; }; done; done
	@WIGGERS=$(CURDIR)/$(BUILD)/wiggers WIGGERS_ROOT=$(CURDIR) WIGGERS_REFERENCE=none $(PYTHON) -m pytest -q -p no:cacheprovider tests/python/fuzz_scenes.py
	@WIGGERS_KILLS=500 WIGGERS=$(CURDIR)/$(BUILD)/wiggers WIGGERS_ROOT=$(CURDIR) PYTHONPATH=$(CURDIR)/$(BUILD)/python \
	  $(PYTHON) -m pytest -q -p no:cacheprovider tests/python/test_restart.py tests/python/test_tissue_bodies.py -k "random_moments"
	@$(BUILD)/test_heart "[.nightly]"
	@WIGGERS_RANDOM_LOOPS=5000 $(BUILD)/test_heart "random loops*"
	@WIGGERS=$(CURDIR)/$(BUILD)/wiggers WIGGERS_ROOT=$(CURDIR) PYTHONPATH=$(CURDIR)/$(BUILD)/python WIGGERS_RANDOM_HEARTS=1000 \
	  $(PYTHON) -m pytest -q -s -p no:cacheprovider tests/python/random_hearts.py
	@$(BUILD)/test_tissue "[.nightly]"
	@$(MAKE) --no-print-directory fuzz benchmarks-3d tissue-tables heartbeat-3d heartbeat-heart
	@WIGGERS_NIGHTLY=1 WIGGERS=$(CURDIR)/$(BUILD)/wiggers WIGGERS_ROOT=$(CURDIR) PYTHONPATH=$(CURDIR)/$(BUILD)/python \
	  $(PYTHON) -m pytest -q -s -p no:cacheprovider tests/python/test_calibration.py -k intervals
	@$(PYTHON) -m pip install --quiet mpi4py && PYTHONPATH=$(CURDIR)/$(BUILD)/python \
	  mpirun --allow-run-as-root --oversubscribe -n 2 $(PYTHON) -m mpi4py.futures tests/python/batch_over_mpi.py
	@rm -rf $(BUILD)/wheel-test && /usr/bin/python3 -m venv $(BUILD)/wheel-test && $(BUILD)/wheel-test/bin/pip install --quiet . && \
	  cd $(BUILD) && wheel-test/bin/python -c "import wiggers; print(wiggers.Loop().to_limit_cycle())"
	@$(BUILD)/bench_cells
	@$(BUILD)/bench_heart

# Scenes, meshes, results and tables of states, a quarter of an hour each, under address and undefined-behaviour sanitizers.
# A finding is an input in build-fuzz/findings.
fuzz: tissue
	$(call install,$(FUZZ_PACKAGES))
	@cmake --build $(BUILD) -j $(JOBS) --target wiggers
	@cmake --preset fuzz -DWIGGERS_PYTHON=$(CURDIR)/$(PYTHON) && ASAN_OPTIONS=detect_leaks=0 cmake --build build-fuzz -j $(JOBS)
	@mkdir -p build-fuzz/findings && $(PYTHON) tests/fuzz/seeds.py $(BUILD)/wiggers scenes build-fuzz/corpus
	@printf '%s\n' scene mesh result state | xargs -P $(JOBS) -I KIND sh -c 'cd scenes && OMP_NUM_THREADS=1 ASAN_OPTIONS=detect_leaks=0 \
	  ../build-fuzz/fuzz_KIND -max_total_time=$(FUZZ_SECONDS) -timeout=60 -rss_limit_mb=4000 -max_len=300000 -print_final_stats=1 \
	  -artifact_prefix=../build-fuzz/findings/KIND- $$([ -f ../build-fuzz/corpus/KIND.dict ] && echo -dict=../build-fuzz/corpus/KIND.dict) \
	  ../build-fuzz/corpus/KIND > ../build-fuzz/KIND.log 2>&1 || { tail -60 ../build-fuzz/KIND.log; exit 255; }'
	@tail -n 6 build-fuzz/*.log
	@WIGGERS_CHANGED_RESULTS=2000 WIGGERS=$(CURDIR)/build-fuzz/wiggers WIGGERS_ROOT=$(CURDIR) $(PYTHON) -m pytest -q -x -p no:cacheprovider tests/python/fuzz_results.py

# The published verification problems of the tissue, for docs/benchmarks-3d.md (some minutes).
benchmarks-3d: tissue
	@cmake --build $(BUILD) -j $(JOBS) --target wiggers-3d
	@$(PYTHON) docs/make_benchmarks_3d.py $(BUILD)/wiggers-3d docs $(RANKS)

# Cost, ranks, the main scene and stabilisations of the tissue, for docs/tissue-measured.md (twenty minutes).
tissue-tables: tissue
	@cmake --build $(BUILD) -j $(JOBS) --target wiggers-3d
	@$(PYTHON) docs/make_tissue_tables.py $(BUILD)/wiggers-3d docs

# Error against cost of the tissue's settings, for docs/trade-3d.md (some minutes).
trade-3d: tissue
	@cmake --build $(BUILD) -j $(JOBS) --target wiggers wiggers-3d
	@$(BUILD)/wiggers trade heart scenes/left_ventricle_3d.toml -o $(BUILD)/trade-3d && cp $(BUILD)/trade-3d/trade.md docs/trade-3d.md

# The tables of docs/trade.md and docs/extremes.md, measured on this machine (some minutes).
trade: build
	@$(PYTHON) docs/make_tables.py $(BUILD)/wiggers docs

# The limit cycles of the ionic models over rates and current blocks, for docs/cell-cycles.md (half an hour).
cell-cycles: build
	@$(PYTHON) docs/make_cell_cycles.py $(BUILD)/wiggers docs/cell-cycles.md

reference: build
	@mkdir -p docs/reference
	@for m in $$($(BUILD)/wiggers models --names); do \
	  { $(BUILD)/wiggers models $$m; if [ $$m = circulation ]; then $(BUILD)/wiggers models $$m --sets; fi; } > docs/reference/$$m.txt; done

SOURCES := $(shell git ls-files '*.cpp' '*.hpp' 2>/dev/null)
format:
	$(call install,$(NIGHTLY_PACKAGES))
	@clang-format -i $(SOURCES)
check-format:
	@clang-format --dry-run --Werror $(SOURCES)

clean:
	@rm -rf $(BUILD) build-sanitize build-sanitize-tissue build-minimal build-dev heartbeat heartbeat-3d heartbeat-heart
