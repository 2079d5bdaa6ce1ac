//! Where tensors live. The only file that names a backend of Burn.

use anyhow::Result;
use burn::prelude::Device;
use clap::ValueEnum;

/// What `--device` takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum DeviceChoice {
    /// A graphics processor if this build and this machine have one, the CPU otherwise.
    Auto,
    /// The CPU.
    Cpu,
    /// Vulkan, Metal or WebGPU (cargo feature `wgpu`).
    Wgpu,
    /// CUDA (cargo feature `cuda`).
    Cuda,
}

/// A device and how to call it in front of people.
pub(crate) struct Opened {
    /// The device.
    pub(crate) device: Device,
    /// Its name.
    pub(crate) name: String,
}

/// Opens the device that was asked for.
pub(crate) fn open(choice: DeviceChoice) -> Result<Opened> {
    match choice {
        DeviceChoice::Cpu => Ok(cpu()),
        DeviceChoice::Wgpu => wgpu(),
        DeviceChoice::Cuda => cuda(),
        DeviceChoice::Auto => Ok(cuda().or_else(|_| wgpu()).unwrap_or_else(|_| cpu())),
    }
}

fn cpu() -> Opened {
    Opened { device: Device::flex(), name: "CPU".to_owned() }
}

/// The first device of a kind that is a card of its own; a software rasteriser is not.
#[cfg(any(feature = "wgpu", feature = "cuda"))]
fn first_card(kind: burn::tensor::DeviceType, name: &str) -> Result<Opened> {
    let found = Device::enumerate(kind);
    let card = found.iter().find_map(|device| {
        let identity = device.identity()?;
        identity.physical.is_some().then(|| (device.clone(), identity.name.clone()))
    });
    match card {
        Some((device, card)) => Ok(Opened { device, name: format!("{name}: {card}") }),
        None => Err(crate::config::bad_input(anyhow::anyhow!(
            "--device {name}: no such graphics processor on this machine; --device cpu always works"
        ))),
    }
}

#[cfg(feature = "wgpu")]
fn wgpu() -> Result<Opened> {
    first_card(burn::tensor::DeviceType::Wgpu, "wgpu")
}

#[cfg(feature = "cuda")]
fn cuda() -> Result<Opened> {
    first_card(burn::tensor::DeviceType::Cuda, "cuda")
}

#[cfg(not(feature = "wgpu"))]
fn wgpu() -> Result<Opened> {
    not_built("wgpu")
}

#[cfg(not(feature = "cuda"))]
fn cuda() -> Result<Opened> {
    not_built("cuda")
}

#[cfg(any(not(feature = "wgpu"), not(feature = "cuda")))]
fn not_built(name: &str) -> Result<Opened> {
    Err(crate::config::bad_input(anyhow::anyhow!(
        "--device {name}: this program was built without it; build with `cargo build --release --features {name}`, \
         or use --device cpu"
    )))
}
