//! Linear maps: one product of all rows, by the backend's multi-threaded multiplication.

use burn_flex::Flex;
use burn_tensor::{Tensor, TensorPrimitive};
use rayon::prelude::*;

use super::memory::{add, host, tensor, values};
use crate::{Affine, Convolution};

/// Rows that one thread takes at a time where it is not a product.
const ROWS: usize = 256;

pub(super) fn map(
    plan: Convolution,
    Affine { input, weight, bias }: Affine<Flex>,
) -> Tensor<Flex, 3> {
    let [batch, length, _] = input.dims();
    let rows = input.reshape([batch * length, plan.inputs]);
    let product = rows.matmul(weight.reshape([plan.inputs, plan.outputs]));
    let mut product = host(product);
    let bias = host(bias);
    let sums = product.storage_mut::<f32>();
    sums.par_chunks_mut((ROWS * plan.outputs).max(1)).for_each(|rows| {
        for row in rows.chunks_mut(plan.outputs.max(1)) {
            add(row, values(&bias));
        }
    });
    let product: Tensor<Flex, 2> = Tensor::from_primitive(TensorPrimitive::Float(product));
    product.reshape([batch, length, plan.outputs])
}

pub(super) fn map_backward(
    plan: Convolution,
    Affine { input, weight, .. }: Affine<Flex>,
    outer: Tensor<Flex, 3>,
) -> Affine<Flex> {
    let [batch, length, _] = input.dims();
    let rows = input.reshape([batch * length, plan.inputs]);
    let outer = outer.reshape([batch * length, plan.outputs]);
    let weight = weight.reshape([plan.inputs, plan.outputs]);
    let by_input = outer.clone().matmul(weight.transpose());
    let by_weight = rows.transpose().matmul(outer.clone());
    Affine {
        input: by_input.reshape([batch, length, plan.inputs]),
        weight: by_weight.reshape([plan.inputs * plan.outputs]),
        bias: column_sums(outer, plan.outputs),
    }
}

/// Sums over all rows, group by group and then in order.
fn column_sums(rows: Tensor<Flex, 2>, columns: usize) -> Tensor<Flex, 1> {
    let rows = host(rows);
    let parts: Vec<Vec<f32>> = values(&rows)
        .par_chunks((ROWS * columns).max(1))
        .map(|rows| {
            let mut sums = vec![0.0; columns];
            for row in rows.chunks(columns.max(1)) {
                add(&mut sums, row);
            }
            sums
        })
        .collect();
    let mut total = vec![0.0; columns];
    for part in parts {
        add(&mut total, &part);
    }
    tensor(total, [columns])
}
