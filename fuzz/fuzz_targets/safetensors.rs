#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let read = safetensors::SafeTensors::deserialize(data);
    if registry::fuzzing::safetensors(data) {
        assert!(read.is_ok(), "accepted for publication but unreadable: {read:?}");
    }
});
