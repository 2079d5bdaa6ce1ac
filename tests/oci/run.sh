#!/usr/bin/env bash
# An exported model through a container registry and back, by the tools of others: tests/oci/run.sh [FLOWSERVO]
#
# FLOWSERVO is the program; by default the one that was built last. Needs `skopeo` and `docker-registry` (packages of these names
# in Debian and Ubuntu). Where they are not to be had it says "skipped: ..." and succeeds, unless FLOWSERVO_REQUIRE_OCI=1.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
target="${CARGO_TARGET_DIR:-$here/../../target}"
. "$here/../python/environment.sh"
. "$here/../checkpoint.sh"

for tool in openssl skopeo docker-registry; do
    command -v "$tool" >/dev/null || skip "${FLOWSERVO_REQUIRE_OCI:-0}" "no $tool; apt-get install skopeo docker-registry"
done
flowservo="${1:-$(ls -t "$target"/{debug,release}/flowservo 2>/dev/null | head -n 1)}" || true
[ -n "$flowservo" ] || { echo "build flowservo first, or name it" >&2; exit 1; }
flowservo="$(realpath "$flowservo")"

work="$(mktemp -d)"
server=
trap '[ -z "$server" ] || kill "$server"; rm -rf "$work"' EXIT
cd "$work"

checkpoint run 100

port="$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])' 2>/dev/null || echo 5117)"
cat >server.yml <<END
version: 0.1
log: { level: error, accesslog: { disabled: true } }
storage: { filesystem: { rootdirectory: $work/store } }
http: { addr: 127.0.0.1:$port }
END
docker-registry serve server.yml >server.log 2>&1 &
server=$!

quietly() { "$@" >log 2>&1 || { cat log server.log >&2; exit 1; }; }
quietly "$flowservo" model publish run approach --registry ours
quietly "$flowservo" model export approach@1 --format oci --out layout --registry ours
copy=(skopeo --insecure-policy copy --src-tls-verify=false --dest-tls-verify=false)
there="docker://127.0.0.1:$port/lab/approach:1"
quietly "${copy[@]}" --retry-times 5 oci:layout:1 "$there"
quietly "${copy[@]}" "$there" oci:back:1
diff -r layout/blobs back/blobs
quietly "$flowservo" model import back approach --registry theirs
digest() { "$flowservo" model show approach@1 --registry "$1" --json | grep -o '"digest":"sha256:[0-9a-f]*"' | head -n 1; }
[ "$(digest ours)" = "$(digest theirs)" ] || { echo "another digest came back" >&2; exit 1; }
echo "pushed to a container registry, pulled and imported: the same digest"
