#!/usr/bin/env bash
# Uses published models without flowservo and compares the results: tests/python/models.sh [FLOWSERVO]
#
# - docs/load_in_pytorch.py and `flowservo model predict` compute the same output for pairs of PNG images, for every trunk.
# - The Python package model-signing verifies signatures of `flowservo model sign`, and the other way around.
# - The Hugging Face Hub library reads the card and the metrics of an exported model.
#
# FLOWSERVO is the program, by default the most recent build. FLOWSERVO_PYTHON is an interpreter with the packages of
# models.txt. Without it the packages, PyTorch among them, are installed into target/python-models; this needs Python 3.11 or
# newer with venv, the Python package index and 12 GiB of free disk space, of which 6 GiB stay in use.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
. "$here/../environment.sh"
find_flowservo "$@"
require openssl
if [ -n "${FLOWSERVO_PYTHON:-}" ]; then
    python="$FLOWSERVO_PYTHON"
else
    mkdir -p "$target"
    free="$(df -Pk "$target" | awk 'NR == 2 { print int($4 / 1048576) }')"
    [ -d "$target/python-models" ] || [ "$free" -ge 12 ] \
        || missing "PyTorch needs 12 GiB of disk space while it is installed; $free GiB are free in $target"
    python_environment python-models "$here/models.txt"
fi

work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"
quietly() { "$@" >errors 2>&1 || { cat errors >&2; exit 1; }; }
flowservo() { quietly "$flowservo" "$@"; }

# Images are twice as large as the input of the networks.
camera=(--set world.camera.width=128 --set world.camera.height=96)
small=(--set network.width=0.1 --set network.head=16 "--set" "network.input=[64,48]" --set optimizer.batch=4 --set validation=0.25
    --set phases.0.epochs=1 --device cpu)
flowservo dataset generate "$repository/configs/datasets/a.toml" --out a --set count=16 "${camera[@]}"
flowservo dataset generate "$repository/configs/datasets/avoid.toml" --out avoid --set count=16 "${camera[@]}"
for row in 0 5; do
    flowservo dataset replay a "$row" --out images
done
train() { # NAME, KIND, DATASET, further arguments
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
"$python" "$here/models.py" "$flowservo" images pulled/*

# The folder for the Hugging Face Hub.
flowservo model export avoid@1 --format huggingface --license apache-2.0 --out hub/avoid
"$python" "$here/hub.py" hub/avoid pulled/avoid

# Signatures: each side verifies those of the other, and neither accepts a changed model.
quietly openssl ecparam -name prime256v1 -genkey -noout -out key.pem
quietly openssl ec -in key.pem -pubout -out pub.pem
quietly openssl pkcs8 -topk8 -nocrypt -in key.pem -out key8.pem
model_signing() { "$python" -m model_signing "$@"; }
refused() { if "$@" >errors 2>&1; then echo "accepted: $*" >&2; exit 1; fi; }
flowservo model sign plain@1 --key key.pem --out ours.sig
flowservo model verify plain@1 --public-key pub.pem
flowservo model sign plain@1 --key key8.pem --out ours8.sig
cmp ours.sig ours8.sig
quietly model_signing verify key pulled/plain --signature ours.sig --public_key pub.pem
quietly model_signing sign key pulled/plain --signature theirs.sig --private_key key.pem
flowservo model verify plain@1 --public-key pub.pem --signature theirs.sig
flowservo model publish pulled/plain theirs
flowservo model attach theirs@1 --signature theirs.sig
flowservo model pull theirs@1 --public-key pub.pem --out pulled-theirs
flowservo model verify pulled/plain --public-key pub.pem --signature theirs.sig
refused "$flowservo" model verify definet@1 --public-key pub.pem --signature theirs.sig
echo "# changed" >>pulled/plain/config.toml
refused "$flowservo" model verify pulled/plain --public-key pub.pem --signature theirs.sig
refused model_signing verify key pulled/plain --signature ours.sig --public_key pub.pem
echo "flowservo and model-signing verify each other's signatures"
