# Shared by the scripts in this folder; read with `.` at the top of the workspace.
target=x86_64-unknown-linux-gnu
version=$(sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' Cargo.toml)
target_folder=${CARGO_TARGET_DIR:-target}
packages=$target_folder/packages
name=evcal-$version-$target
archive=$packages/$name.tar.gz
deb=$packages/evcal_${version}_amd64.deb

# The recording that packages are used for, and its board.
session=fixtures/board
board=acircles:9x4:55mm:r17.5mm

fail() {
    echo "packages: $*" >&2
    exit 1
}

# bare_root FOLDER PACKAGES: makes a bare Debian root with these packages (one after the other, with commas), unless it is there.
bare_root() {
    [ ! -f "$1/made" ] || return 0
    install_packages debootstrap
    run_as_root rm -rf "$1"
    run_as_root timeout 1800 debootstrap --variant=minbase ${2:+--include="$2"} bookworm "$1" >"$packages/debootstrap.log" 2>&1 ||
        { tail -n 5 "$packages/debootstrap.log" >&2; fail "no bare Debian root"; }
    run_as_root touch "$1/made"
}
