# Sourced by scripts that publish a model.

# checkpoint FOLDER COUNT: writes a checkpoint with this many random weights.
checkpoint() {
    local header length digest
    mkdir "$1"
    # The safetensors format: length of the header in eight bytes, header, numbers.
    header="{\"w\":{\"dtype\":\"F32\",\"shape\":[$2],\"data_offsets\":[0,$(($2 * 4))]}}"
    length="$(printf %02x "${#header}")"
    { printf "\\x$length\\0\\0\\0\\0\\0\\0\\0%s" "$header" && head -c "$(($2 * 4))" /dev/urandom; } >"$1/weights.safetensors"
    digest="$(openssl dgst -sha256 -r "$1/weights.safetensors" | cut -d ' ' -f 1)"
    cat >"$1/model.json" <<END
{"format": 2, "task": {"kind": "avoidance", "network": {"trunk": "flownet_s", "width": 0.1, "input": [32, 24], "head": 8}},
 "standardization": null, "camera": {"width": 32, "height": 24, "horizontal_fov_deg": 60.0, "behind_hand_mm": 100.0},
 "datasets": [], "seed": 5, "epoch": null, "weights_sha256": "$digest"}
END
    echo 'seed = 5' >"$1/config.toml"
}
