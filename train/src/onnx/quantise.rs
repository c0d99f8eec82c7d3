//! Products with matrices of 8-bit integers.
//!
//! Weights have one scale a column. Activations get one a row (a token) while the graph runs: a token's
//! scale never depends on what else is in the batch, so neither do its codes. One scale for the
//! whole batch, as `quantize_dynamic` of ONNX Runtime's tools writes it, would break that.

use super::{
    builder::{Attribute, GraphBuilder, Value},
    proto,
};
use crate::Tensor;

/// Largest magnitude of a quantised number: symmetric, so that -128 is left out.
const LARGEST: f32 = 127.0;
/// The unsigned number that stands for 0.
const ZERO_POINT: u8 = 128;
/// In place of the scale of a row or column of zeros.
const SMALLEST: f32 = 1e-30;

impl GraphBuilder {
    /// `input` times `matrix` `[inputs, outputs]`, both quantised.
    pub(super) fn quantised_product(
        &mut self,
        name: &str,
        matrix: &Tensor,
        input: &Value,
    ) -> Value {
        let columns = Columns::of(matrix);
        let weight = self.initializer(
            &format!("{name}.int8"),
            matrix.shape(),
            proto::INT8,
            columns.bytes,
        );
        let outputs = columns.scales.len();
        let scales = Tensor::from_fn(vec![outputs], |column| columns.scales[column]);
        let scales = self.float(&format!("{name}.scales"), &scales);
        let scalar = |graph: &mut Self, part: &str, value: f32| {
            graph.float(
                &format!("{name}.{part}"),
                &Tensor::from_fn(vec![], |_| value),
            )
        };
        let smallest = scalar(self, "smallest", SMALLEST);
        let step = scalar(self, "step", 1.0 / LARGEST);
        let middle = scalar(self, "middle", f32::from(ZERO_POINT));
        let zero = self.initializer(&format!("{name}.zero"), &[], proto::UINT8, vec![ZERO_POINT]);
        let last = self.ints(&format!("{name}.last"), &[-1]);

        let magnitude = self.apply("Abs", &[input], &[]);
        let magnitude = self.apply("ReduceMax", &[&magnitude, &last], &[]);
        let magnitude = self.apply("Max", &[&magnitude, &smallest], &[]);
        let row_scale = self.apply("Mul", &[&magnitude, &step], &[]);
        let rounded = self.apply("Div", &[input, &row_scale], &[]);
        let rounded = self.apply("Round", &[&rounded], &[]);
        let shifted = self.apply("Add", &[&rounded, &middle], &[]);
        let quantised = self.cast(&shifted, proto::UINT8);
        let product = self.apply("MatMulInteger", &[&quantised, &weight, &zero], &[]);
        let product = self.cast(&product, proto::FLOAT);
        let product = self.apply("Mul", &[&product, &row_scale], &[]);
        self.apply("Mul", &[&product, &scales], &[])
    }

    fn cast(&mut self, value: &Value, element: i32) -> Value {
        let to = ("to", Attribute::Int(i64::from(element)));
        self.apply("Cast", &[value], &[to])
    }
}

/// A matrix, quantised column by column.
struct Columns {
    /// Row-major, one signed byte each.
    bytes: Vec<u8>,
    /// What a column's numbers are multiplied by.
    scales: Vec<f32>,
}

impl Columns {
    fn of(matrix: &Tensor) -> Self {
        let width = matrix.dim(1).max(1);
        let rows = || matrix.data().chunks(width);
        let mut scales = vec![SMALLEST; width];
        for row in rows() {
            for (scale, value) in scales.iter_mut().zip(row) {
                *scale = scale.max(value.abs() / LARGEST);
            }
        }
        let quantised = |(value, scale): (&f32, &f32)| (value / scale).round() as i8;
        let bytes = rows().flat_map(|row| row.iter().zip(&scales).map(quantised));
        let bytes = bytes.flat_map(i8::to_le_bytes).collect();
        Self { bytes, scales }
    }
}

#[cfg(test)]
mod tests {
    use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};

    use bailando::model::WeightStorage;
    use ort::session::Session;

    use super::*;
    use crate::onnx::builder::{Dim, Element};

    #[test]
    fn columns_are_off_by_half_a_step_at_most() {
        let matrix = Tensor::from_fn(vec![5, 3], |flat| match flat % 3 {
            0 => 0.0,
            1 => (flat as f32 * 0.7).sin(),
            _ => 40.0 * (flat as f32 * 1.3).cos(),
        });
        let columns = Columns::of(&matrix);
        for (flat, (&byte, &value)) in columns.bytes.iter().zip(matrix.data()).enumerate() {
            let scale = columns.scales[flat % 3];
            let back = f32::from(byte.cast_signed()) * scale;
            assert!((back - value).abs() <= 0.501 * scale, "{flat}");
        }
        // The largest of each column uses the whole range.
        for column in 1..3 {
            let bytes = columns.bytes.iter().skip(column).step_by(3);
            let largest = bytes.map(|byte| byte.cast_signed().unsigned_abs()).max();
            assert_eq!(largest, Some(127));
        }
    }

    /// The graph against the definition, in double precision.
    #[test]
    fn a_product_is_as_defined_and_a_row_knows_nothing_of_the_others() {
        const INPUTS: usize = 40;
        let matrix = Tensor::from_fn(vec![INPUTS, 3], |flat| (flat as f32 * 0.7).sin());
        let mut graph = GraphBuilder::new("product", WeightStorage::Int8);
        let shape = |last| [Dim::Named("rows"), Dim::Fixed(last)];
        let input = graph.input("input", Element::Float, &shape(INPUTS));
        let product = graph.product("matrix", &matrix, &input);
        graph.output("product", &product, Element::Float, &shape(3));
        let bytes = graph.finish().unwrap();
        let library = std::env::var_os("ORT_DYLIB_PATH").unwrap_or_else(|| {
            let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../.onnxruntime/lib");
            format!("{folder}/{DLL_PREFIX}onnxruntime{DLL_SUFFIX}").into()
        });
        let environment = ort::environment::init_from(library).unwrap();
        let environment = environment.build().unwrap();
        let mut session = Session::builder(&environment)
            .unwrap()
            .commit_from_memory(&bytes)
            .unwrap();
        let mut run = |rows: &[f32]| -> Vec<f32> {
            let input = ([rows.len() / INPUTS, INPUTS], rows.to_vec());
            let input = ort::value::Tensor::from_array(input).unwrap();
            let outputs = session.run(ort::inputs! { "input" => input }).unwrap();
            outputs["product"]
                .try_extract_tensor::<f32>()
                .unwrap()
                .1
                .to_vec()
        };
        // A row of zeros, one of ones, one of large and one of small numbers.
        let rows: Vec<f32> = (0..4 * INPUTS)
            .map(|flat| match flat / INPUTS {
                0 => 0.0,
                1 => 1.0,
                2 => 300.0 * (flat as f32 * 0.9).cos(),
                _ => 1e-4 * (flat as f32 * 1.7).sin(),
            })
            .collect();
        let together = run(&rows);
        let columns = Columns::of(&matrix);
        for (row, input) in rows.chunks(INPUTS).enumerate() {
            let found = &together[3 * row..3 * row + 3];
            assert_eq!(run(input), found);
            let largest = input
                .iter()
                .fold(0.0_f32, |largest, x| largest.max(x.abs()));
            let step = f64::from(largest.max(SMALLEST) / LARGEST);
            for (column, &found) in found.iter().enumerate() {
                let sum: f64 = input
                    .iter()
                    .enumerate()
                    .map(|(k, &x)| {
                        let weight = columns.bytes[3 * k + column].cast_signed();
                        (f64::from(x) / step).round_ties_even() * f64::from(weight)
                    })
                    .sum();
                let wanted = sum * step * f64::from(columns.scales[column]);
                let tolerance = 1e-5 * f64::from(largest) + 1e-30;
                assert!(
                    (f64::from(found) - wanted).abs() < tolerance,
                    "{row} {column}"
                );
            }
        }
    }
}
