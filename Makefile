# Two commands do everything on a fresh Debian machine:
#   make demo   builds evcal and calibrates a simulated DAVIS346 from its USB stream; OPENCV=0 builds it without OpenCV
#   make test   checks formatting, lints, documentation and runs the tests
# A third one runs each night and before a release:
#   make test-all   also tests packages in bare roots, builds without OpenCV, the oldest Rust, a kernel and all emulated processors
.PHONY: demo test test-all test-workspace test-crossings test-beside test-without-opencv test-report test-python test-packages test-usb-guest \
    test-embedded test-embedded-slow compatibility setup readers build programs wheel packages rooms bench fuzz check check-format \
    check-lints check-lints-without-opencv check-documentation check-no-std check-dependencies check-oldest-rust \
    check-crates findings

# What `make test` runs, in this order, and what `make test-all` runs after it. test-without-opencv is the last one, because it replaces
# the program that the others test.
CHECKS = check-format check-lints check-documentation check-no-std check-dependencies check-crates
TESTS = setup readers $(CHECKS) test-workspace test-report test-beside
MORE_TESTS = test-crossings check-lints-without-opencv check-oldest-rust test-packages test-usb-guest test-embedded-slow compatibility \
    test-without-opencv

# Incremental builds serve those who change code; without, the program is faster, and all tests need several GB less of disk.
demo build test test-all: export CARGO_INCREMENTAL = 0

demo: build
	@sh tools/demo.sh

test: STEPS = $(TESTS)
test-all: STEPS = $(TESTS) $(MORE_TESTS)
test test-all:
	@for step in $(STEPS); do \
	    start=$$(date +%s); $(MAKE) $$step || exit 1; echo "== make $$step: $$(($$(date +%s) - start)) s"; done

# All tests that cargo runs. Of the examples only those are built that a test runs; clippy checks the others.
test-workspace: programs readers
	cargo test --workspace --release --locked $(TESTED)
	cargo test --workspace --release --locked --doc

# Every kind of board with every device and source; test-workspace tests each at least once.
test-crossings: programs
	cargo test --workspace --release --locked --test crossings -- --ignored

# The same with a build without OpenCV. The end-to-end tests run the program that the tests before them built.
test-without-opencv: setup readers
	cargo test -p evcal --release --locked --no-default-features --features cli
	@! ldd "$${CARGO_TARGET_DIR:-target}/release/evcal" | grep opencv
	cargo test -p evcal-tests --release --locked --tests

# report.html and the page of evcal live in a headless browser, as a phone and as a desktop; installs the browser.
test-report: programs
	@sh tools/report/check.sh

# Two at a time, because much of each step uses one processor only. The output of a step is printed when it is done.
test-beside: programs
	@$(MAKE) -j2 --output-sync=target test-embedded test-python

# The Python package: its wheel, built, installed and tested; installs its requirements below target.
wheel: setup
	@sh tools/python/wheel.sh

test-python: wheel
	@sh tools/python/test.sh

# Packages for users who do not build evcal: a static program in a tarball, and a .deb; in target/packages.
packages: setup
	@sh tools/package/build.sh

# Installs the packages in a bare Debian root and calibrates there; then the wheel, in another root.
test-packages: packages wheel
	@sh tools/package/test.sh

# The emulated camera on a real kernel, in a virtual machine; prints a message if there cannot be one.
test-usb-guest: setup
	@sh tools/usb/test-guest.sh

# The core and the detector's firmware on an emulated microcontroller; installs QEMU and compiles core for it.
test-embedded: setup
	@sh tools/embedded/test.sh

# The same on all emulated processors, with a calibration from the circles of one; the core's tests as 32-bit Arm programs, and the
# example for a real board.
test-embedded-slow: programs
	@sh tools/embedded/test.sh --all
	@sh tools/embedded/test-calibration.sh
	@sh tools/embedded/test-slow.sh

# A third-party driver must accept the emulated camera; it is not a part of the workspace, because it brings its own libusb. Other
# programs must exchange recordings with evcal as the table in docs/formats.md shows; needs the network.
compatibility: programs
	cargo test --manifest-path usb-davis/compatibility/Cargo.toml --release --locked
	@sh tools/interchange/run.sh

# Surprises about other programs: each script installs them anew and fails if they behave differently.
findings:
	@for script in findings/*.sh; do echo "== $$script"; sh $$script || failed="$$failed $$script"; done; \
	    [ -z "$$failed" ] || { echo "findings: changed:$$failed" >&2; exit 1; }

# Dependencies between crates and between the modules of host/detection, host/solve and host/calibrate, and import cycles in all
# crates.
rooms: setup
	cargo test -p evcal-sources --test rooms --release --locked -- --nocapture

check: $(CHECKS)

check-format: setup
	@for part in . firmware fuzz python usb-davis/compatibility; do \
	    cargo fmt --manifest-path $$part/Cargo.toml --all --check || exit 1; done

check-lints: setup
	cargo clippy --workspace --all-targets --release --locked -- -D warnings

# Without OpenCV only the program differs; usb-davis gives the others the features that they have in the workspace.
check-lints-without-opencv: setup
	cargo clippy -p evcal -p usb-davis --all-targets --release --locked --no-default-features \
	    --features evcal/cli,usb-davis/default -- -D warnings

check-documentation: setup
	RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --release --locked

check-no-std: setup
	@sh tools/check/no-std.sh

# Licences, sources and known vulnerabilities of dependencies, if cargo-deny is installed.
check-dependencies: setup
	@sh tools/check/dependencies.sh

# The packages for crates.io: their content, and whether they can be published together.
check-crates: setup
	@sh tools/check/crates.sh

# The oldest supported Rust, if it is installed.
check-oldest-rust: setup
	@sh tools/check/oldest-rust.sh

# OPENCV=0 builds without OpenCV: less to install, the same results.
OPENCV = 1

build: setup
	@OPENCV=$(OPENCV) sh tools/setup/program.sh

# The programs as the tests build them: tests enable features of dependencies, and another build would compile most of evcal a second
# time.
TESTED = --lib --bins --tests
TESTED_EXAMPLES = --example calibrate --example detect --example simulate --example undistort
programs: setup
	cargo test --workspace --release --locked --no-run $(TESTED)
	cargo build --workspace --release --locked $(TESTED_EXAMPLES)

bench: setup
	cargo bench --workspace

# Fuzzes everything that reads untrusted input, each target for SECONDS; findings are below target/fuzz/findings. `make test` reads the
# corpus in fuzz/corpus again.
SECONDS = 60
fuzz: setup
	@SECONDS_EACH=$(SECONDS) sh tools/fuzz.sh

setup:
	@OPENCV=$(OPENCV) sh tools/setup/build.sh

# Programs with which tests read evcal's files or write recordings: OpenCV, mrcal, dv-processing, rosbags, mcap, faery, renderers.
readers: setup
	@sh tools/setup/readers.sh
