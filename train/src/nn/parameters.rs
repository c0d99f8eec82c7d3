//! Learned tensors: as a named list on the host, and as the same list on a device.

use std::sync::Arc;

use bailando_kernels::Affine;
use burn_tensor::{Tensor, TensorData, backend::AutodiffBackend, backend::Backend};

use super::{host::values, range_observer::RangeObserver};
use crate::HostTensor;

/// Place of a tensor in a [`Store`] and in the [`Parameters`] made of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slot(usize);

/// Named tensors on the host, in the layout that the forward passes want.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Store {
    entries: Vec<(String, HostTensor)>,
}

impl Store {
    /// Appends a tensor.
    pub(super) fn push(&mut self, name: String, tensor: HostTensor) -> Slot {
        self.entries.push((name, tensor));
        Slot(self.entries.len() - 1)
    }

    pub(super) fn get(&self, slot: Slot) -> &HostTensor {
        &self.entries[slot.0].1
    }

    /// Returns names and tensors, in order.
    #[must_use]
    pub fn entries(&self) -> &[(String, HostTensor)] {
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

    /// Returns values a share of the way to those of another store with the same names and shapes.
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

    /// Returns the same names and shapes with other values.
    #[must_use]
    pub fn with_values(&self, values: Vec<Vec<f32>>) -> Self {
        let entries = self.entries.iter().zip(values);
        Self {
            entries: entries
                .map(|((name, old), mut values)| {
                    let mut values = values.drain(..);
                    let tensor = HostTensor::from_fn(old.shape().to_vec(), |_| {
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
    tensors: Vec<Tensor<B, 1>>,
    shapes: Vec<Vec<usize>>,
    device: B::Device,
    observer: Option<Arc<RangeObserver>>,
}

impl<B: Backend> Parameters<B> {
    /// Copies a store to `device`.
    #[must_use]
    pub fn from_store(store: &Store, device: &B::Device) -> Self {
        let tensors = store.entries.iter().map(|(_, tensor)| {
            let data = tensor.data().to_vec();
            let length = data.len();
            Tensor::from_data(TensorData::new(data, [length]), device)
        });
        Self {
            tensors: tensors.collect(),
            shapes: store.entries.iter().map(|(_, tensor)| tensor.shape().to_vec()).collect(),
            device: device.clone(),
            observer: None,
        }
    }

    /// Makes the tensors record the ranges of their inputs.
    #[must_use]
    pub(crate) fn observed(self) -> Self {
        let observer = Some(Arc::new(RangeObserver::new(self.tensors.len())));
        Self { observer, ..self }
    }

    /// Returns the least and the largest input of each observed tensor, by the names of `store`:
    /// means over all passes.
    pub(crate) fn input_ranges(&self, store: &Store) -> Vec<(String, [f32; 2])> {
        let ranges = self.observer.iter().flat_map(|observer| observer.ranges());
        let names = store.entries.iter();
        ranges.zip(names).filter_map(|(range, (name, _))| Some((name.clone(), range?))).collect()
    }

    /// Records an input of a tensor.
    pub(super) fn observe<const D: usize>(&self, slot: Slot, input: &Tensor<B, D>) {
        if let Some(observer) = &self.observer {
            observer.record(slot.0, input);
        }
    }

    /// Copies the values back to the host, under the names of `store`.
    #[must_use]
    pub fn to_store(&self, store: &Store) -> Store {
        store.with_values(self.tensors.iter().map(values).collect())
    }

    /// Returns the device of the tensors.
    #[must_use]
    pub fn device(&self) -> &B::Device {
        &self.device
    }

    /// Returns the flat tensors, in the store's order.
    #[must_use]
    pub fn tensors(&self) -> &[Tensor<B, 1>] {
        &self.tensors
    }

    /// Returns the flat tensors, for replacement by others of the same length.
    pub(crate) fn tensors_mut(&mut self) -> &mut [Tensor<B, 1>] {
        &mut self.tensors
    }

    /// Returns what an affine operation takes.
    pub(super) fn affine(&self, input: Tensor<B, 3>, weight: Slot, bias: Slot) -> Affine<B> {
        let [weight, bias] = [weight, bias].map(|slot| self.tensors[slot.0].clone());
        Affine { input, weight, bias }
    }

    /// Returns a tensor as a matrix with as many columns as its last dimension.
    pub(super) fn matrix(&self, slot: Slot) -> Tensor<B, 2> {
        let columns = self.shapes[slot.0].last().copied().unwrap_or(1);
        let tensor = self.tensors[slot.0].clone();
        let rows = tensor.dims()[0] / columns.max(1);
        tensor.reshape([rows, columns])
    }

    /// Returns the same values, with derivatives recorded.
    #[must_use]
    pub fn tracked<A: AutodiffBackend<InnerBackend = B, Device = B::Device>>(
        &self,
    ) -> Parameters<A> {
        let tensors = self.tensors.iter();
        Parameters {
            tensors: tensors
                .map(|tensor| Tensor::from_inner(tensor.clone()).require_grad())
                .collect(),
            shapes: self.shapes.clone(),
            device: self.device.clone(),
            observer: None,
        }
    }
}

impl<A: AutodiffBackend> Parameters<A> {
    /// Returns the same values without derivatives, for parts that do not learn.
    #[must_use]
    pub fn untracked(&self) -> Parameters<A::InnerBackend> {
        Parameters {
            tensors: self.tensors.iter().map(|tensor| tensor.clone().inner()).collect(),
            shapes: self.shapes.clone(),
            device: self.device.clone(),
            observer: None,
        }
    }
}
