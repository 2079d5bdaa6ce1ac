#!/usr/bin/env bash
# Tests a registry in a bucket against a local S3 server (moto): tests/s3/run.sh [FLOWSERVO]
#
# FLOWSERVO is the program, built with --features s3, by default the most recent build. Needs Python 3.11 or newer with venv
# and, the first time, the Python package index; it installs into target/s3. FLOWSERVO_RACES is the number of rounds of 16
# concurrent publishers, 3 by default.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
. "$here/../environment.sh"
find_flowservo "$@"
case "$("$flowservo" model list --registry s3:// 2>&1)" in
    *"built without S3"*) echo "$flowservo was built without S3; run: cargo build --features s3" >&2; exit 1 ;;
esac
python_environment s3 "$here/requirements.txt"
"$python" "$here/bucket.py" "$flowservo"
