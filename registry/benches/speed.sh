#!/usr/bin/env bash
# Measures how fast 100 MB are published into a folder and pulled, compared with SHA-256 and the disk alone:
# registry/benches/speed.sh [--rounds N] [FLOWSERVO]
#
# FLOWSERVO is the program, a release build; by default target/release/flowservo. Each round measures SHA-256 by openssl, a copy
# by dd including the flush to disk, `model publish` into a new registry, and `model pull`. The script prints the medians, and the
# speed of publishing and pulling relative to SHA-256 and to the disk. Run it on an idle machine. It needs 500 MB of disk space in
# TMPDIR.
set -euo pipefail
rounds=9
[ "${1:-}" != --rounds ] || { rounds="$2"; shift 2; }
repository="$(dirname "${BASH_SOURCE[0]}")/../.."
. "$repository/tests/checkpoint.sh"
target="${CARGO_TARGET_DIR:-$repository/target}"
flowservo="$(realpath "${1:-$target/release/flowservo}")"
[ -x "$flowservo" ] || { echo "build it first: cargo build --release" >&2; exit 1; }

work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"
checkpoint run 25000000

measure() { # NAME, COMMAND
    local begun
    sync
    begun="$(date +%s%N)"
    "${@:2}" >log 2>&1 || { cat log >&2; exit 1; }
    echo $((($(date +%s%N) - begun) / 1000000)) >>"$1.ms"
}
for _ in $(seq "$rounds"); do
    rm -rf registry pulled copy
    measure digest openssl dgst -sha256 run/weights.safetensors
    measure disk dd if=run/weights.safetensors of=copy bs=1M conv=fsync
    measure publish "$flowservo" model publish run big --registry registry
    measure pull "$flowservo" model pull big@1 --registry registry --out pulled
done

median() { sort -n "$1.ms" | sed -n "$(((rounds + 1) / 2))p"; }
digest="$(median digest)" disk="$(median disk)"
echo "100 MB, medians of $rounds rounds: digest $digest ms, disk $disk ms"
for what in publish pull; do
    took="$(median $what)"
    awk -v what=$what -v took="$took" -v digest="$digest" -v disk="$disk" \
        'BEGIN { printf "%-8s %4d ms, %.2f of the digest'\''s speed, %.2f of the disk'\''s\n", what, took, digest / took, disk / took }'
done
