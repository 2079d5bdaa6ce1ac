#!/usr/bin/env bash
# Sends an exported model through a container registry and back with other tools: tests/oci/run.sh [FLOWSERVO]
#
# FLOWSERVO is the program, by default the most recent build. Needs openssl, skopeo, docker-registry and Python 3.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
. "$here/../environment.sh"
. "$here/../checkpoint.sh"
find_flowservo "$@"
require openssl skopeo docker-registry
require_python

work="$(mktemp -d)"
server=
trap '[ -z "$server" ] || kill "$server"; rm -rf "$work"' EXIT
cd "$work"

checkpoint run 100

port="$("$python" -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')"
cat >server.yml <<YAML
version: 0.1
log: { level: error, accesslog: { disabled: true } }
storage: { filesystem: { rootdirectory: $work/store } }
http: { addr: 127.0.0.1:$port }
YAML
docker-registry serve server.yml >server.log 2>&1 &
server=$!
for _ in $(seq 600); do
    ! (: <"/dev/tcp/127.0.0.1/$port") 2>/dev/null || break
    kill -0 "$server" 2>/dev/null || { cat server.log >&2; exit 1; }
    sleep 0.1
done

quietly() { "$@" >log 2>&1 || { cat log server.log >&2; exit 1; }; }
quietly "$flowservo" model publish run approach --registry ours
quietly "$flowservo" model export approach@1 --format oci --out layout --registry ours
copy=(skopeo --insecure-policy copy --src-tls-verify=false --dest-tls-verify=false)
there="docker://127.0.0.1:$port/lab/approach:1"
quietly "${copy[@]}" oci:layout:1 "$there"
quietly "${copy[@]}" "$there" oci:back:1
diff -r layout/blobs back/blobs
quietly "$flowservo" model import back approach --registry theirs
digest() { "$flowservo" model show approach@1 --registry "$1" --json | grep -o '"digest":"sha256:[0-9a-f]*"' | head -n 1; }
[ "$(digest ours)" = "$(digest theirs)" ] || { echo "the digest of the imported model differs" >&2; exit 1; }
echo "pushed to a container registry, pulled and imported: the digest is the same"
