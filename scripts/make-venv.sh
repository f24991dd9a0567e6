#!/bin/sh
# Makes .venv with uv in it. Installs python3-venv where it is missing and may be; else says what to do.
set -eu
python=$1

say() { echo "m3r: $*" >&2; exit 2; }

command -v "$python" >/dev/null 2>&1 || say "$python is not installed: install Python 3.11 or newer, or run make PYTHON=/path/to/python3."
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    say "$("$python" --version) is too old: Python 3.11 or newer is needed; run make PYTHON=/path/to/python3.11."

if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
    package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
    command -v apt-get >/dev/null 2>&1 || say "$python has no venv module: install it with your system's package manager."
    [ "$(id -u)" -eq 0 ] || say "the package $package is missing: run 'sudo apt-get install $package', then make again."
    echo "m3r: installing $package"
    { apt-get -qq update && DEBIAN_FRONTEND=noninteractive apt-get -qq -y install "$package"; } >/dev/null ||
        say "the package $package could not be installed: run 'apt-get install $package' and see why."
fi

echo "m3r: setting up .venv (a few minutes the first time)"
rm -rf .venv
"$python" -m venv .venv
.venv/bin/python -m pip install --quiet --disable-pip-version-check "uv>=0.6,<1"
