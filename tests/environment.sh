#!/usr/bin/env bash
# Makes an environment with what a suite in Python needs: environment.sh SUITE FOLDER, of host/SUITE. Needs python3 (3.11
# or later) with venv; for Blender, whose module is for that version alone, python3.11.
set -euo pipefail
cd "$(dirname "$0")/../host/$1"
python=python3
[ "$1" != blender ] || python=python3.11
"$python" -m venv "$2"
# What is imported is compiled then: most of it never is.
install() { "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile -r "$1"; }
venv=$2
install tests/requirements.txt
programs=tests/programs-requirements.txt
[ ! -e "$programs" ] || install "$programs" || echo "some programs do not install: their tests are skipped"
touch "$venv/complete"
