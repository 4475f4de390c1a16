# Two commands do everything on a bare Debian or Ubuntu with Rust, their own set-up included:
#   make map     simulates a car park, maps it into ./map, and says where picture and report are
#   make test    runs every test
# The rest is for work on evermap: lint, docs, bench, peers.

export PATH := $(PATH):$(HOME)/.cargo/bin
EVERMAP := target/release/evermap

# .cargo/config.toml has OpenCV's places on x86-64; elsewhere they are these.
MULTIARCH := $(or $(shell gcc -print-multiarch 2>/dev/null),$(shell uname -m)-linux-gnu)
ifneq ($(MULTIARCH),x86_64-linux-gnu)
export OPENCV_LINK_PATHS ?= /usr/lib/$(MULTIARCH)
export OPENCV_INCLUDE_PATHS ?= /usr/include/opencv4,/usr/include/$(MULTIARCH)/opencv4
endif

.PHONY: map test lint docs bench bench-mosaic peers packages release
.DEFAULT_GOAL := map

map: sessions/.complete
	$(EVERMAP) run car_park --map map --sessions 'sessions/*.mcap'
	$(EVERMAP) layers --map map
	$(EVERMAP) render --map map --out map/map.png
	$(EVERMAP) report --map map --out map/report.html
	@echo "picture: $(CURDIR)/map/map.png"
	@echo "report:  $(CURDIR)/map/report.html"

# Made once. A simulation that was interrupted is begun anew.
sessions/.complete: | release
	$(EVERMAP) simulate car_park --out sessions
	@touch $@

release: packages
	cargo build --release --locked --package evermap

test: packages .venv/complete
	cargo test --workspace --locked

lint: packages
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --locked -- -D warnings

docs: packages
	RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps --locked

# Criterion benches of our own code; `make bench-mosaic` is the one of the overhead image.
bench: packages
	cargo bench --workspace --benches --locked

bench-mosaic: packages
	cargo bench --package evermap-catalog --bench mosaic --locked

# Side by side with other programs, as BENCHMARKS.md tells.
peers: packages .venv/bench
	cargo build --release --locked --package evermap
	cargo build --release --locked --package evermap-datasets --example scan
	.venv/bin/python tests/peers/decode.py
	.venv/bin/python tests/peers/images.py
	.venv/bin/python tests/peers/rerun_convert.py

packages:
	@.ci/packages

# The official Python readers that tests compare decoded values with.
.venv/complete: tests/peers/requirements.txt | packages
	python3 -m venv .venv
	.venv/bin/pip install --quiet --disable-pip-version-check --requirement $<
	@touch $@

.venv/bench: tests/peers/requirements-bench.txt .venv/complete
	.venv/bin/pip install --quiet --disable-pip-version-check --requirement $<
	@touch $@
