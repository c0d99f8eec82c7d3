//! Learned tensors: as a named list on the host, and as the same list on a device.

use std::sync::Arc;

use burn_tensor::{Tensor as Device, TensorData, backend::AutodiffBackend, backend::Backend};

use super::{kernels::Precision, watch::Watch};
use crate::Tensor;

/// Place of a tensor in a [`Store`] and in the [`Parameters`] made of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slot(usize);

/// Named tensors on the host, in the layout that the forward passes want.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Store {
    entries: Vec<(String, Tensor)>,
}

impl Store {
    /// Appends a tensor.
    pub(super) fn push(&mut self, name: String, tensor: Tensor) -> Slot {
        self.entries.push((name, tensor));
        Slot(self.entries.len() - 1)
    }

    pub(super) fn get(&self, slot: Slot) -> &Tensor {
        &self.entries[slot.0].1
    }

    /// Names and tensors, in order.
    #[must_use]
    pub fn entries(&self) -> &[(String, Tensor)] {
        &self.entries
    }

    /// Whether another has the same names and shapes.
    #[must_use]
    pub fn fits(&self, other: &Self) -> bool {
        let names = |store: &Self| -> Vec<(String, Vec<usize>)> {
            let entries = store.entries.iter();
            let named = entries.map(|(name, tensor)| (name.clone(), tensor.shape().to_vec()));
            named.collect()
        };
        names(self) == names(other)
    }

    /// Values that lie a share of the way to those of another store with the same names and shapes.
    #[must_use]
    pub fn towards(&self, other: &Self, share: f64) -> Self {
        let between = |(from, to): (&f32, &f32)| {
            let (from, to) = (f64::from(*from), f64::from(*to));
            (from + share * (to - from)) as f32
        };
        let pairs = self.entries.iter().zip(&other.entries);
        let values = pairs.map(|((_, from), (_, to))| {
            let values = from.data().iter().zip(to.data());
            values.map(between).collect()
        });
        self.with_values(values.collect())
    }

    /// The same names and shapes with other values.
    #[must_use]
    pub fn with_values(&self, values: Vec<Vec<f32>>) -> Self {
        let entries = self.entries.iter().zip(values);
        Self {
            entries: entries
                .map(|((name, old), mut values)| {
                    let mut values = values.drain(..);
                    let tensor = Tensor::from_fn(old.shape().to_vec(), |_| {
                        values.next().unwrap_or(f32::NAN)
                    });
                    (name.clone(), tensor)
                })
                .collect(),
        }
    }
}

/// The tensors of a [`Store`] on a device, flat; a forward pass gives them their shape.
///
/// One rank for all keeps the optimiser and the files free of ranks.
#[derive(Clone, Debug)]
pub struct Parameters<B: Backend> {
    tensors: Vec<Device<B, 1>>,
    shapes: Vec<Vec<usize>>,
    device: B::Device,
    precision: Precision,
    watch: Option<Arc<Watch>>,
}

impl<B: Backend> Parameters<B> {
    /// Copies a store to `device`.
    #[must_use]
    pub fn from_store(store: &Store, device: &B::Device) -> Self {
        let tensors = store.entries.iter().map(|(_, tensor)| {
            let data = tensor.data().to_vec();
            let length = data.len();
            Device::from_data(TensorData::new(data, [length]), device)
        });
        Self {
            tensors: tensors.collect(),
            shapes: store
                .entries
                .iter()
                .map(|(_, tensor)| tensor.shape().to_vec())
                .collect(),
            device: device.clone(),
            precision: Precision::default(),
            watch: None,
        }
    }

    /// The same tensors, which remember what they are multiplied with.
    #[must_use]
    pub(crate) fn watched(self) -> Self {
        let watch = Some(Arc::new(Watch::new(self.tensors.len())));
        Self { watch, ..self }
    }

    /// The least and the largest number that each watched tensor was multiplied with, by the names of `store`: means
    /// over all passes.
    pub(crate) fn input_ranges(&self, store: &Store) -> Vec<(String, [f32; 2])> {
        let ranges = self.watch.iter().flat_map(|watch| watch.ranges());
        let names = store.entries.iter();
        ranges
            .zip(names)
            .filter_map(|(range, (name, _))| Some((name.clone(), range?)))
            .collect()
    }

    /// A tensor is about to be multiplied with `input`.
    pub(super) fn see<const D: usize>(&self, slot: Slot, input: &Device<B, D>) {
        if let Some(watch) = &self.watch {
            watch.see(slot.0, input);
        }
    }

    /// The same tensors, whose products are computed in `precision`.
    #[must_use]
    pub fn in_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    pub(super) fn precision(&self) -> Precision {
        self.precision
    }

    /// Copies the values back to the host, under the names of `store`.
    #[must_use]
    pub fn to_store(&self, store: &Store) -> Store {
        store.with_values(self.tensors.iter().map(values).collect())
    }

    /// The device that the tensors are on.
    #[must_use]
    pub fn device(&self) -> &B::Device {
        &self.device
    }

    /// The flat tensors, in the store's order.
    #[must_use]
    pub fn tensors(&self) -> &[Device<B, 1>] {
        &self.tensors
    }

    /// The flat tensors, to be replaced by others of the same length.
    pub(crate) fn tensors_mut(&mut self) -> &mut [Device<B, 1>] {
        &mut self.tensors
    }

    /// One tensor as it is kept.
    pub(super) fn flat(&self, slot: Slot) -> Device<B, 1> {
        self.tensors[slot.0].clone()
    }

    /// The first dimensions taken together: a matrix with as many columns as the last dimension.
    pub(super) fn matrix(&self, slot: Slot) -> Device<B, 2> {
        let columns = self.shapes[slot.0].last().copied().unwrap_or(1);
        let tensor = self.tensors[slot.0].clone();
        let rows = tensor.dims()[0] / columns.max(1);
        tensor.reshape([rows, columns])
    }

    /// The same values, recording what is computed with them.
    #[must_use]
    pub fn tracked<A: AutodiffBackend<InnerBackend = B, Device = B::Device>>(
        &self,
    ) -> Parameters<A> {
        let tensors = self.tensors.iter();
        Parameters {
            tensors: tensors
                .map(|tensor| Device::from_inner(tensor.clone()).require_grad())
                .collect(),
            shapes: self.shapes.clone(),
            device: self.device.clone(),
            precision: self.precision,
            watch: None,
        }
    }
}

impl<A: AutodiffBackend> Parameters<A> {
    /// The same values, recording nothing: for parts that do not learn.
    #[must_use]
    pub fn untracked(&self) -> Parameters<A::InnerBackend> {
        Parameters {
            tensors: self
                .tensors
                .iter()
                .map(|tensor| tensor.clone().inner())
                .collect(),
            shapes: self.shapes.clone(),
            device: self.device.clone(),
            precision: self.precision,
            watch: None,
        }
    }
}

/// The values of a tensor on the host, in row-major order.
pub(crate) fn values<B: Backend, const D: usize>(tensor: &Device<B, D>) -> Vec<f32> {
    tensor.to_data().iter::<f32>().collect()
}
