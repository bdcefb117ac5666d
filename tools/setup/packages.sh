# Installs packages of Debian and PyPI for the other scripts, which read this file with `.` and set $script to their name.
# All messages go to standard error.

is_debian() {
    command -v dpkg-query >/dev/null 2>&1 && command -v apt-get >/dev/null 2>&1
}

run_as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    elif command -v sudo >/dev/null 2>&1; then
        sudo "$@"
    else
        echo "$script: please run as root: $*" >&2
        return 1
    fi
}

# Scripts that run at the same time take turns (flock), because apt-get does not wait while another one fetches its lists.

# update_package_lists: fetches the lists of packages.
update_package_lists() {
    run_as_root flock /var/lib/apt apt-get -o DPkg::Lock::Timeout=900 update -q >&2
}

# install_python_packages FOLDER REQUIREMENTS: an environment with the requirements in the file, made again when they change.
install_python_packages() {
    ! cmp -s "$2" "$1/installed.txt" || return 0
    echo "$script: installing the packages of $2 to $1" >&2
    rm -rf "$1"
    mkdir -p "$1"
    /usr/bin/python3 -m venv "$1" &&
        "$1/bin/pip" install --quiet --disable-pip-version-check --only-binary=:all: --requirement "$2" &&
        cp "$2" "$1/installed.txt"
}

# install_packages PACKAGE...: installs those that are not there yet.
install_packages() {
    missing=""
    for package in "$@"; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' ||
            missing="$missing $package"
    done
    [ -n "$missing" ] || return 0
    echo "$script: installing$missing" >&2
    update_package_lists || return 1
    # shellcheck disable=SC2086 # one word a package
    run_as_root env DEBIAN_FRONTEND=noninteractive flock /var/lib/apt \
        apt-get -o DPkg::Lock::Timeout=900 install -q -y --no-install-recommends $missing >&2
}
