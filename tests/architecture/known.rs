//! What breaks a rule today. The list only shrinks; it goes when it is empty.

/// Files in a circle.
pub(crate) const CIRCLES: &[&str] = &[
    "crates/bailando-model/src/manifest.rs",
    "crates/bailando-model/src/suppressed.rs",
    "train/src/data/check/mod.rs",
    "train/src/data/check/motions.rs",
    "train/src/data/check/music.rs",
    "train/src/data/check/splits.rs",
    "train/src/export/manifest.rs",
    "train/src/export/mod.rs",
    "train/src/nn/kernels/cpu/attention.rs",
    "train/src/nn/kernels/cpu/convolution.rs",
    "train/src/nn/kernels/cpu/descent.rs",
    "train/src/nn/kernels/cpu/elementwise.rs",
    "train/src/nn/kernels/cpu/linear.rs",
    "train/src/nn/kernels/cpu/mod.rs",
    "train/src/nn/kernels/mod.rs",
    "train/src/nn/kernels/plain.rs",
];
