#!/usr/bin/env bash
# Makes an environment with what the tests need: environment.sh FOLDER. Needs python3 (3.11 or later) with venv.
set -euo pipefail
cd "$(dirname "$0")"
python3 -m venv "$1"
# What is imported is compiled then: most of it never is.
install() { "$1/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile -r "$2"; }
install "$1" tests/requirements.txt
install "$1" tests/programs-requirements.txt || echo "some programs do not install: their tests are skipped"
touch "$1/complete"
