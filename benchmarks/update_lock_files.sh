#!/usr/bin/env bash
# Make the four lock files anew from pyproject.toml; needs `uv` (pip install uv). Then run the tests, and say in the
# changelog what moved. `benchmarks/update_lock_files.sh --keep` moves nothing that is locked: it adds and drops what pyproject.toml does.
#   .requirements.lock         what `make run` installs         .requirements-test.lock   what `make test` installs
#   .requirements-lowest.lock  what `make lowest` installs: the lowest version of all that pyproject.toml names
#   .requirements-docs.lock    what `make docs` installs, which needs nothing of machopt
set -euo pipefail
cd "$(dirname "$0")/.."
keep=${1:-}
made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT
python3 -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"], sep="\n")' \
  > "$made/build.in"  # the build tool is pinned too

python3 -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["docs"], sep="\n")' \
  > "$made/docs.in"

lock() {  # FILE WHAT SOURCES AND OPTIONS…
  local file=$1 what=$2
  shift 2
  test "$keep" != --keep || cp "$file" "$made/lock"  # what stands in the output holds for uv
  uv pip compile --quiet "$@" --universal --python-version 3.11 --generate-hashes \
    --no-header --no-annotate --no-emit-index-url --no-strip-extras --output-file "$made/lock"
  { echo "# $what: versions that were tried together, with hashes. Made by benchmarks/update_lock_files.sh"; cat "$made/lock"; } > "$file"
  rm "$made/lock"
}
lock .requirements-test.lock 'What `make test` installs' pyproject.toml "$made/build.in" --extra dev --extra batch --extra parquet --extra excel
lock .requirements.lock 'What `make run` installs: every command and every format' pyproject.toml "$made/build.in" \
  --extra batch --extra parquet --extra excel --constraint .requirements-test.lock
lock .requirements-lowest.lock 'What `make lowest` installs, nothing above its bound in pyproject.toml' pyproject.toml "$made/build.in" \
  --extra dev --extra batch --extra parquet --extra excel --resolution lowest-direct
lock .requirements-docs.lock 'What `make docs` installs' "$made/docs.in"
