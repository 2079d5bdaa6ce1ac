#!/usr/bin/env bash
# Uses published models without flowservo, and compares: tests/python/models.sh [FLOWSERVO]
#
# - docs/load_in_pytorch.py gives the same output as `flowservo model predict` for pairs of PNG images, with every trunk.
# - A signature of `flowservo model sign` is verified by the Python package model-signing, and the other way.
# - The library of the Hugging Face Hub reads card and metrics of an exported model.
#
# FLOWSERVO is the program; by default the one that was built last. FLOWSERVO_PYTHON names an interpreter that has the packages
# of models.txt. Without it they are installed, PyTorch among them, into target/python-models, with Python 3.11 or newer and the
# Python package index. Where that is not to be had it says "skipped: ..." and succeeds, unless FLOWSERVO_REQUIRE_PYTHON=1.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
repository="$here/../.."
target="${CARGO_TARGET_DIR:-$repository/target}"

. "$here/environment.sh"
python="${FLOWSERVO_PYTHON:-$target/python-models/bin/python}"
if [ -z "${FLOWSERVO_PYTHON:-}" ]; then
    mkdir -p "$target"
    free="$(df -Pk "$target" | awk 'NR == 2 { print int($4 / 1048576) }')"
    [ -x "$python" ] || [ "$free" -ge 12 ] \
        || skip "${FLOWSERVO_REQUIRE_PYTHON:-0}" "PyTorch takes 6 GiB, twice that while it is installed; $free GiB are free"
    environment "$target/python-models" "$here/models.txt" "${FLOWSERVO_REQUIRE_PYTHON:-0}"
fi

program="${1:-$(ls -t "$target"/{debug,release}/flowservo 2>/dev/null | head -n 1)}" || true
[ -n "$program" ] || { echo "build flowservo first, or name it" >&2; exit 1; }
program="$(realpath "$program")"

work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"
quietly() { "$@" >errors 2>&1 || { cat errors >&2; exit 1; }; }
flowservo() { quietly "$program" "$@"; }
export PYTHONDONTWRITEBYTECODE=1

# Images twice as large as the networks' input.
camera=(--set world.camera.width=128 --set world.camera.height=96)
small=(--set network.width=0.1 --set network.head=16 "--set" "network.input=[64,48]" --set optimizer.batch=4 --set validation=0.25
    --set phases.0.epochs=1 --device cpu)
flowservo dataset generate "$repository/configs/datasets/a.toml" --out a --set count=16 "${camera[@]}"
flowservo dataset generate "$repository/configs/datasets/avoid.toml" --out avoid --set count=16 "${camera[@]}"
for row in 0 5; do
    flowservo dataset replay a "$row" --out images
done
train() { # NAME, KIND, DATASET, further settings
    flowservo train "$repository/configs/train/$2.toml" --data "$3" --out "runs/$1" "${small[@]}" "${@:4}"
    flowservo model publish "runs/$1/best" "$1"
    flowservo model pull "$1@1" --out "pulled/$1"
}
train flownet_s approach a
train plain approach a --set network.symmetry=none --set network.label=difference
train flownet_c approach a --set network.trunk=flownet_c
train definet approach a --set network.trunk=definet
train definet_gap approach a --set network.trunk=definet_gap
train avoid avoid avoid
train avoid_gap avoid avoid --set network.trunk=definet_gap
"$python" "$here/models.py" "$program" images pulled/*

# The folder for the Hugging Face Hub, by its own library and by the example.
flowservo model export avoid@1 --format huggingface --license apache-2.0 --out hub/avoid
"$python" "$here/hub.py" hub/avoid pulled/avoid

# Signatures: ours are verified by the Python package, its by us; of what was changed by neither.
command -v openssl >/dev/null || skip "no openssl to make keys"
quietly openssl ecparam -name prime256v1 -genkey -noout -out key.pem
quietly openssl ec -in key.pem -pubout -out pub.pem
quietly openssl pkcs8 -topk8 -nocrypt -in key.pem -out key8.pem
theirs() { "$python" -m model_signing "$@"; }
refused() { if "$@" >errors 2>&1; then echo "not refused: $*" >&2; exit 1; fi; }
flowservo model sign plain@1 --key key.pem --out ours.sig
flowservo model verify plain@1 --public-key pub.pem
flowservo model sign plain@1 --key key8.pem --out ours8.sig
cmp ours.sig ours8.sig
quietly theirs verify key pulled/plain --signature ours.sig --public_key pub.pem
quietly theirs sign key pulled/plain --signature theirs.sig --private_key key.pem
flowservo model verify plain@1 --public-key pub.pem --signature theirs.sig
flowservo model publish pulled/plain theirs
flowservo model attach theirs@1 --signature theirs.sig
flowservo model pull theirs@1 --public-key pub.pem --out pulled-theirs
flowservo model verify pulled/plain --public-key pub.pem --signature theirs.sig
refused "$program" model verify definet@1 --public-key pub.pem --signature theirs.sig
echo "# changed" >>pulled/plain/config.toml
refused "$program" model verify pulled/plain --public-key pub.pem --signature theirs.sig
refused theirs verify key pulled/plain --signature ours.sig --public_key pub.pem
echo "signatures of either side are verified by the other"
