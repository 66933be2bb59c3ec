#!/bin/sh
# Create a virtual environment with all dependencies of the project on Debian or Ubuntu with python3
# and apt. Usage: sh scripts/setup.sh VENV
set -eu
venv=${1:?usage: setup.sh VENV}

# --- system requirements ----------------------------------------------------------------------
find_python() {
    for name in python3.11 python3.12 python3.13 python3; do
        if command -v "$name" >/dev/null 2>&1 &&
            "$name" -c 'import sys; raise SystemExit(not (3, 11) <= sys.version_info[:2] <= (3, 13))'
        then
            echo "$name"
            return
        fi
    done
}

python=$(find_python)
if [ -z "$python" ]; then
    echo "error: Python must be 3.11, 3.12 or 3.13, got $(python3 --version 2>&1 || echo none)" >&2
    exit 2
fi

missing=""
"$python" -c 'import venv, ensurepip' >/dev/null 2>&1 || missing="$missing python3-venv"
has_library() {
    "$python" -c 'import ctypes, sys; ctypes.CDLL(sys.argv[1])' "$1" >/dev/null 2>&1
}
has_library libEGL.so.1 || missing="$missing libegl1"
has_library libGL.so.1 || missing="$missing libgl1"
# The Mesa vendor library and software renderer are loaded by name at run time.
ls /usr/lib/*/libEGL_mesa.so.0 /usr/lib/*/libEGL_nvidia.so.0 >/dev/null 2>&1 ||
    ls /usr/lib/*/libEGL_mesa.so.0 >/dev/null 2>&1 || missing="$missing libegl-mesa0"
ls /usr/lib/*/dri/swrast_dri.so >/dev/null 2>&1 || ls /usr/lib/*/libgallium*.so >/dev/null 2>&1 ||
    missing="$missing libgl1-mesa-dri"

if [ -n "$missing" ]; then
    root=""
    if [ "$(id -u)" -ne 0 ]; then
        if command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then root="sudo"; else root="none"; fi
    fi
    if [ "$root" = none ] || ! command -v apt-get >/dev/null 2>&1; then
        echo "error: system packages are missing. Run this command, then run make again:" >&2
        echo "    sudo apt-get update && sudo apt-get install -y$missing" >&2
        exit 2
    fi
    echo "Installing system packages:$missing"
    $root apt-get update -qq
    DEBIAN_FRONTEND=noninteractive $root apt-get install -y -qq --no-install-recommends $missing
fi

# --- virtual environment ----------------------------------------------------------------------
if [ ! -x "$venv/bin/python" ] || ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    rm -rf "$venv"
    "$python" -m venv "$venv"
fi
echo "Installing Python packages into $venv (a minute or two)"
# Tested versions, also for the build of the package.
PIP_CONSTRAINT=requirements.lock
export PIP_CONSTRAINT
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
