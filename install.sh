#!/bin/sh
# Set up uav_recon on this machine: Debian packages, virtual environment .venv, Python packages.
#   ./install.sh        what `uav-recon` needs
#   ./install.sh dev    what the tests need, too
set -eu
cd "$(dirname "$0")"

packages="python3 python3-venv libgomp1 libegl1 libgl1 libx11-6 libidn2-0 libusb-1.0-0" # Open3D and torch load the libraries
target="-e ."  # from this folder: a copy in .venv would hide a later installation with the tests
if [ "${1:-}" = dev ]; then
    packages="$packages libudev1 make systemd"
    target="-e .[dev]"
elif [ -n "${1:-}" ]; then
    echo "install.sh: unknown argument '$1'; the only one is 'dev'" >&2
    exit 2
fi

if command -v dpkg-query >/dev/null; then
    missing=""
    for package in $packages; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q "ok installed" || missing="$missing $package"
    done
    if [ -n "$missing" ]; then
        echo "Debian packages to install:$missing"
        root=""
        [ "$(id -u)" = 0 ] || root="sudo"
        $root apt-get update -qq
        # shellcheck disable=SC2086
        $root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing
    fi
else
    echo "This is not a Debian-like system. Install the equivalents of: $packages" >&2
fi

[ -x .venv/bin/python ] || python3 -m venv .venv
# shellcheck disable=SC2086
.venv/bin/pip install $target

# bytecode: a service that may not write here, or an environment with PYTHONDONTWRITEBYTECODE, would compile at each start
.venv/bin/python -m compileall -q uav_recon sitl

# numerical kernels, once; without this step the first flight compiles them
.venv/bin/uav-recon compile
