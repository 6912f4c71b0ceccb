# make demo   installs what the build needs, builds, replays the bundled recording, prints its pitches
# make test   every test; one that this machine lacks something for says "skipped: what" (PITCHD_TESTS_MUST_RUN=1: it fails)
# make install   program, unit, sysctl, udev, sysusers, tmpfiles, manual pages and completions below DESTDIR
# make deb    the same as a Debian package, in target/deb (`cargo deb` makes it too)
# make bench  every benchmark (ratios against a named baseline of the same run)
# make bench-live   the daemon at full rate, as root: SECONDS_LIVE=300 CAMERAS=2 (or 3, or 4 smaller ones)
.PHONY: demo test bench bench-live packages lint install deb

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

SECONDS_LIVE ?= 300
CAMERAS ?= 2
bench-live: packages
	cargo bench --locked --bench full_rate -- --seconds $(SECONDS_LIVE) --cameras $(CAMERAS)

lint: packages
	cargo fmt --check
	cargo clippy --locked --all-targets -- -D warnings

packages:
	@.ci/install-packages

DESTDIR ?=
# Another program than a release build: make deb PROGRAM=path
PROGRAM ?= $(CARGO_TARGET_DIR)/release/pitchd
install:
	test "$(origin PROGRAM)" = "command line" || cargo build --locked --release
	install -D -m 755 $(PROGRAM) $(DESTDIR)/usr/bin/pitchd
	install -D -m 644 systemd/pitchd.service $(DESTDIR)/usr/lib/systemd/system/pitchd.service
	install -D -m 644 systemd/60-pitchd.sysctl.conf $(DESTDIR)/usr/lib/sysctl.d/60-pitchd.conf
	install -D -m 644 systemd/70-pitchd-usb3vision.rules $(DESTDIR)/usr/lib/udev/rules.d/70-pitchd-usb3vision.rules
	install -D -m 644 systemd/pitchd.sysusers.conf $(DESTDIR)/usr/lib/sysusers.d/pitchd.conf
	install -D -m 644 systemd/pitchd.tmpfiles.conf $(DESTDIR)/usr/lib/tmpfiles.d/pitchd.conf
	install -d $(DESTDIR)/usr/share/man/man1 $(DESTDIR)/usr/share/bash-completion/completions $(DESTDIR)/usr/share/zsh/vendor-completions
	$(DESTDIR)/usr/bin/pitchd man --out $(DESTDIR)/usr/share/man/man1
	$(DESTDIR)/usr/bin/pitchd completions bash > $(DESTDIR)/usr/share/bash-completion/completions/pitchd
	$(DESTDIR)/usr/bin/pitchd completions zsh > $(DESTDIR)/usr/share/zsh/vendor-completions/_pitchd

DEB ?= $(CARGO_TARGET_DIR)/deb
deb:
	rm -rf $(DEB)/root
	$(MAKE) install DESTDIR=$(DEB)/root $(if $(filter command line,$(origin PROGRAM)),PROGRAM=$(PROGRAM))
	strip $(DEB)/root/usr/bin/pitchd
	install -D -m 644 README.md $(DEB)/root/usr/share/doc/pitchd/README.md
	cat LICENSE LICENSE-MIT LICENSE-APACHE > $(DEB)/root/usr/share/doc/pitchd/copyright
	systemd/debian/pack $(DEB)
