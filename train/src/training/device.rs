//! Devices, chosen at run time.

use super::error::TrainError;

/// Evaluates an expression on the device of a name: `|Backend, device|` stand for the backend's
/// type and the device in it.
macro_rules! on_device {
    ($name:expr, |$backend:ident, $device:ident| $body:expr) => {
        match $name {
            "cpu" => {
                type $backend = burn_autodiff::Autodiff<burn_flex::Flex>;
                let $device = burn_flex::FlexDevice;
                $body
            }
            #[cfg(feature = "libtorch")]
            "libtorch" => $crate::training::device::guarded(|| {
                type $backend = burn_autodiff::Autodiff<burn_tch::LibTorch>;
                let $device = $crate::training::device::libtorch();
                $body
            }),
            name => Err($crate::training::device::unknown(name)),
        }
    };
}
pub(super) use on_device;

/// Returns the error for a device that this build does not have.
pub(super) fn unknown(name: &str) -> TrainError {
    TrainError::Device {
        device: name.to_owned(),
        message: match name {
            "libtorch" => {
                "not in this build: cargo build --release -p bailando-train --features libtorch"
            }
            _ => "expected cpu or libtorch",
        }
        .to_owned(),
    }
}

/// Returns LibTorch's GPU if it has one, else its CPU.
#[cfg(feature = "libtorch")]
pub(super) fn libtorch() -> burn_tch::LibTorchDevice {
    match tch::Cuda::is_available() {
        true => burn_tch::LibTorchDevice::Cuda(0),
        false => burn_tch::LibTorchDevice::Cpu,
    }
}

/// Turns a panic into an error: an accelerator's library panics where there is no driver.
#[cfg(feature = "libtorch")]
pub(super) fn guarded<T>(job: impl FnOnce() -> Result<T, TrainError>) -> Result<T, TrainError> {
    let run = std::panic::AssertUnwindSafe(job);
    std::panic::catch_unwind(run).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
        Err(TrainError::Device {
            device: "libtorch".to_owned(),
            message: format!("failed: {}", text.unwrap_or("no reason given")),
        })
    })
}
