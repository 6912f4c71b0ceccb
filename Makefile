# make demo   installs what the build needs, builds, replays the bundled recording, prints its pitches
# make test   every test
# make bench  every benchmark (ratios against a named baseline of the same run)
.PHONY: demo test bench packages lint

CARGO_TARGET_DIR ?= target
export CARGO_TARGET_DIR
DEMO_OUT ?= target/demo

demo: packages
	cargo build --locked --release
	$(CARGO_TARGET_DIR)/release/pitchd replay recordings/bullpen --out $(DEMO_OUT)

test: packages
	cargo test --locked

bench: packages
	cargo bench --locked

lint: packages
	cargo fmt --check
	cargo clippy --locked --all-targets -- -D warnings

packages:
	@.ci/install-packages
