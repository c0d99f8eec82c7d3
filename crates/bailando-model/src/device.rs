//! What graphs are computed on.

use std::{fmt, str::FromStr};

use super::ModelError;

/// What the graphs of a model directory are computed on.
///
/// ```
/// use bailando_model::Device;
///
/// assert_eq!("cuda".parse::<Device>()?, Device::Cuda { index: 0 });
/// assert_eq!(Device::Cuda { index: 1 }.to_string(), "cuda:1");
/// # Ok::<(), bailando_model::ModelError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// The processor.
    #[default]
    Cpu,
    /// An NVIDIA GPU, through the CUDA execution provider of ONNX Runtime.
    Cuda {
        /// Which of those that CUDA shows to the process (`CUDA_VISIBLE_DEVICES`), from 0 on.
        index: u16,
    },
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => write!(f, "cpu"),
            Self::Cuda { index } => write!(f, "cuda:{index}"),
        }
    }
}

impl FromStr for Device {
    type Err = ModelError;

    /// Reads `cpu`, `cuda` (the first GPU) or `cuda:N`.
    fn from_str(text: &str) -> Result<Self, ModelError> {
        let cuda = match text {
            "cpu" => return Ok(Self::Cpu),
            "cuda" => Some(0),
            _ => text.strip_prefix("cuda:").and_then(|index| index.parse().ok()),
        };
        cuda.map(|index| Self::Cuda { index }).ok_or_else(|| ModelError::Input {
            what: "device",
            expected: "cpu, cuda or cuda:N, N a number from 0 on".into(),
            got: format!("{text:?}"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_read_as_it_is_written() {
        for device in [Device::Cpu, Device::Cuda { index: 0 }, Device::Cuda { index: 7 }] {
            assert_eq!(device.to_string().parse::<Device>().unwrap(), device);
        }
        assert_eq!("cuda".parse::<Device>().unwrap(), Device::Cuda { index: 0 });
    }

    #[test]
    fn another_device_is_refused_with_what_is_accepted() {
        for text in ["", "gpu", "CUDA", "cuda:", "cuda:-1", "cuda:one", "cuda:70000", "cpu:0"] {
            let error = text.parse::<Device>().unwrap_err().to_string();
            let expected =
                format!("device: expected cpu, cuda or cuda:N, N a number from 0 on, got {text:?}");
            assert_eq!(error, expected);
        }
    }
}
