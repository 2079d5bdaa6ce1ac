//! Devices for tensors. This is the only file that selects a backend of Burn.

use crate::error::bad_input;
use anyhow::{Result, anyhow};
use burn::prelude::{Device, Tensor};
use clap::ValueEnum;
use std::panic::{self, AssertUnwindSafe};
use std::sync::{Arc, OnceLock};

/// Value of `--device`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum DeviceChoice {
    /// A GPU if this build supports one and the machine has one, otherwise the CPU.
    Auto,
    /// CPU.
    Cpu,
    /// A GPU through Vulkan, or Metal on a Mac (cargo feature `wgpu`).
    Wgpu,
    /// A Vulkan driver that computes on the CPU: slow, to test `wgpu` without a GPU (cargo feature `wgpu-software`).
    WgpuSoftware,
    /// An NVIDIA GPU through CUDA (cargo feature `cuda`).
    Cuda,
}

impl DeviceChoice {
    /// Returns the name on the command line.
    fn name(self) -> String {
        self.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
    }

    /// Returns the cargo feature that the choice needs, if this build lacks it.
    fn missing_feature(self) -> Option<&'static str> {
        match self {
            Self::Wgpu if !cfg!(feature = "wgpu-software") => Some("wgpu"),
            Self::WgpuSoftware if !cfg!(feature = "wgpu-software") => Some("wgpu-software"),
            Self::Cuda if !cfg!(feature = "cuda") => Some("cuda"),
            _ => None,
        }
    }
}

/// An open device and its name for display.
pub(crate) struct Opened {
    /// Device.
    pub(crate) device: Device,
    /// Name for display.
    pub(crate) name: String,
}

/// Opens a device.
pub(crate) fn open(choice: DeviceChoice) -> Result<Opened> {
    if let Some(feature) = choice.missing_feature() {
        return Err(bad_input(anyhow!(
            "--device {}: not part of this build; build with `cargo build --release --features {feature}`, \
             or use --device cpu",
            choice.name()
        )));
    }
    let candidates = if choice == DeviceChoice::Cpu { vec![cpu()] } else { candidates() };
    let mut others = Vec::new();
    for candidate in candidates {
        if choice == DeviceChoice::Auto && candidate.choice == DeviceChoice::WgpuSoftware {
            continue;
        }
        match candidate.open() {
            Ok((found, opened)) if fits(choice, found) => return Ok(opened),
            Ok((_, opened)) => others.push(opened.name),
            Err(reason) => others.push(reason),
        }
    }
    let name = choice.name();
    Err(bad_input(anyhow!("--device {name}: this machine has no such device; it has {}", others.join("; "))))
}

/// Returns whether a working device satisfies a choice. A software rasterizer is used only on request.
fn fits(choice: DeviceChoice, found: DeviceChoice) -> bool {
    match choice {
        DeviceChoice::Auto => found != DeviceChoice::WgpuSoftware,
        _ => found == choice,
    }
}

/// A device that a driver reports. It is not open yet.
struct Candidate {
    choice: DeviceChoice,
    device: Device,
}

impl Candidate {
    /// Opens the device and runs an addition on it, because a driver may lack the compiler for its kernels.
    fn open(self) -> Result<(DeviceChoice, Opened), String> {
        let Self { choice, device } = self;
        let card = attempt(|| {
            (Tensor::<1>::ones([1], &device) + 1.0).into_data();
            card(&device)
        });
        match card.map_err(|reason| format!("{}: a device that does not open ({reason})", choice.name()))? {
            None => Ok((choice, Opened { device, name: "CPU".to_owned() })),
            Some(card) => {
                let choice = if is_software(&card) { DeviceChoice::WgpuSoftware } else { choice };
                Ok((choice, Opened { device, name: format!("{}: {card}", choice.name()) }))
            }
        }
    }
}

/// Returns whether a device name is that of a software rasterizer. Drivers may report one as a GPU, as in a virtual machine.
fn is_software(card: &str) -> bool {
    let card = card.to_lowercase();
    ["llvmpipe", "lavapipe", "softpipe", "swrast", "swiftshader", "basic render driver"]
        .iter()
        .any(|name| card.contains(name))
}

/// Runs code in which a driver may panic. Returns the panic message, also from a thread that Burn started, instead of printing it.
fn attempt<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    let words = Arc::new(OnceLock::new());
    let heard = Arc::clone(&words);
    let hook = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        let words = panic.payload_as_str().unwrap_or_default();
        heard.get_or_init(|| words.split_whitespace().collect::<Vec<_>>().join(" "));
    }));
    let result = panic::catch_unwind(AssertUnwindSafe(work));
    panic::set_hook(hook);
    result.map_err(|_| words.get().cloned().unwrap_or_default())
}

/// Returns the devices of this machine that this build supports, best first.
fn candidates() -> Vec<Candidate> {
    [cuda(), wgpu(), vec![cpu()]].into_iter().flatten().collect()
}

fn cpu() -> Candidate {
    Candidate { choice: DeviceChoice::Cpu, device: Device::flex() }
}

/// Returns the name of the card behind a device, or `None` for the CPU.
#[cfg(any(feature = "wgpu-software", feature = "cuda"))]
fn card(device: &Device) -> Option<String> {
    device.identity().map(|identity| identity.name)
}

#[cfg(not(any(feature = "wgpu-software", feature = "cuda")))]
fn card(_: &Device) -> Option<String> {
    None
}

/// Returns the devices of a kind that drivers report. A driver that fails reports none.
#[cfg(any(feature = "wgpu-software", feature = "cuda"))]
fn enumerate(kind: burn::tensor::DeviceType) -> Vec<Device> {
    attempt(|| Device::enumerate(kind).into_vec()).unwrap_or_default()
}

#[cfg(feature = "cuda")]
fn cuda() -> Vec<Candidate> {
    let devices = enumerate(burn::tensor::DeviceType::Cuda);
    devices.into_iter().map(|device| Candidate { choice: DeviceChoice::Cuda, device }).collect()
}

/// Returns the wgpu devices: discrete GPUs first, software rasterizers last.
#[cfg(feature = "wgpu-software")]
fn wgpu() -> Vec<Candidate> {
    use burn::backend::{CubeDevice, DispatchDevice, WgpuDevice, WgpuDeviceKind};

    let kind = |device: &Device| match device.as_dispatch() {
        DispatchDevice::Cube(CubeDevice::Wgpu(WgpuDevice { kind, .. })) => Some(kind.clone()),
        _ => None,
    };
    let is_discrete = |device: &Device| matches!(kind(device), Some(WgpuDeviceKind::DiscreteGpu(_)));
    let is_software = |device: &Device| kind(device) == Some(WgpuDeviceKind::Cpu);
    let mut devices = enumerate(burn::tensor::DeviceType::Wgpu);
    devices.sort_by_key(|device| (is_software(device), !is_discrete(device)));
    let choice = |device: &Device| {
        if is_software(device) { DeviceChoice::WgpuSoftware } else { DeviceChoice::Wgpu }
    };
    devices.into_iter().map(|device| Candidate { choice: choice(&device), device }).collect()
}

#[cfg(not(feature = "cuda"))]
fn cuda() -> Vec<Candidate> {
    Vec::new()
}

#[cfg(not(feature = "wgpu-software"))]
fn wgpu() -> Vec<Candidate> {
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOFTWARE: DeviceChoice = DeviceChoice::WgpuSoftware;

    #[test]
    fn a_software_rasterizer_is_used_only_on_request() {
        for choice in DeviceChoice::value_variants() {
            assert_eq!(fits(*choice, SOFTWARE), *choice == SOFTWARE, "{choice:?}");
        }
        assert!(fits(DeviceChoice::Auto, DeviceChoice::Wgpu) && fits(DeviceChoice::Auto, DeviceChoice::Cpu));
        assert!(!fits(DeviceChoice::Cuda, DeviceChoice::Wgpu) && !fits(SOFTWARE, DeviceChoice::Wgpu));
    }

    #[test]
    fn software_rasterizers_are_known_by_name() {
        let software = [
            "llvmpipe (LLVM 15.0.6, 256 bits)",
            "Virtio-GPU Venus (llvmpipe (LLVM 19.1.7, 256 bits))",
            "SwiftShader Device (Subzero)",
            "softpipe",
            "Microsoft Basic Render Driver",
        ];
        let cards =
            ["NVIDIA H100 80GB HBM3", "AMD Radeon 8060S Graphics", "Intel(R) Arc(tm) A770", "Apple M4"];
        assert!(software.into_iter().all(is_software) && !cards.into_iter().any(is_software));
    }

    #[test]
    fn a_panic_of_a_driver_is_an_error_with_the_message_of_its_thread() {
        let thread = || std::thread::spawn(|| panic!("no driver {}", 7)).join().expect("the driver's thread");
        assert_eq!(attempt(thread), Err::<(), _>("no driver 7".to_owned()));
        assert_eq!(attempt(|| 7), Ok(7));
    }
}
