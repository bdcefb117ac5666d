# Two commands do everything on a fresh Debian machine:
#   make demo   builds evcal and calibrates a simulated DAVIS346 from its USB stream
#   make test   checks formatting, lints, documentation and runs all tests
.POSIX:
.PHONY: demo test test-report test-usb-guest test-embedded test-embedded-slow compatibility setup readers build check bench

demo: build
	@sh tools/demo.sh

test: setup readers check
	cargo test --workspace --release --locked
	@$(MAKE) test-report
	@$(MAKE) test-usb-guest
	@$(MAKE) test-embedded

# report.html in a headless browser, as a phone and as a desktop; installs the browser.
test-report: build
	@sh tools/report/check.sh

# The emulated camera on a real kernel, in a virtual machine; says so where there cannot be one.
test-usb-guest:
	@sh tools/usb/test-guest.sh

# The core and the detector's firmware on emulated microcontrollers; installs QEMU and compiles core for them.
test-embedded: build
	@sh tools/embedded/test.sh
	@sh tools/embedded/test-calibration.sh

# The core's tests as 32-bit Arm programs, and the example for a real board.
test-embedded-slow: setup
	@sh tools/embedded/test-slow.sh

# A third-party driver must accept the emulated camera. Apart, because it brings its own libusb.
compatibility: setup
	cargo test --manifest-path usb-davis/compatibility/Cargo.toml --release --locked

check: setup
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --release --locked -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --release --locked
	@sh tools/check/no-std.sh

build: setup
	cargo build --release --locked

bench: setup
	cargo bench --workspace

setup:
	@sh tools/setup/build.sh

# The programs that tests read evcal's files with: OpenCV, mrcal, dv-processing, renderers.
readers: setup
	@sh tools/setup/readers.sh
