//! Products with matrices of 8-bit integers.
//!
//! Weights have one scale a column. Activations have a fixed scale where their range was measured
//! (static quantisation), else one a row (a token), computed while the graph runs. Either way a
//! token's scale never depends on the rest of the batch, and so do its codes. One scale for the
//! whole batch, as `quantize_dynamic` of ONNX Runtime's tools writes it, would break that.

use bailando::model::WeightStorage;

use super::{
    builder::{Attribute, GraphBuilder, Value},
    proto,
};
use crate::HostTensor;

/// Largest magnitude of a quantised number: symmetric, so that -128 is left out.
const LARGEST: f32 = 127.0;
/// The unsigned number that stands for 0.
const ZERO_POINT: u8 = 128;
/// In place of the scale of a row or column of zeros.
const SMALLEST: f32 = 1e-30;

/// Largest step of an unsigned byte.
const STEPS: f32 = 255.0;

impl GraphBuilder {
    /// `input` times a matrix of weights `[inputs, outputs]`.
    pub(super) fn product(&mut self, name: &str, matrix: &HostTensor, input: &Value) -> Value {
        match self.storage() {
            WeightStorage::F32 | WeightStorage::F16 => {
                let matrix = self.weight(name, matrix);
                self.apply("MatMul", &[input, &matrix], &[])
            }
            WeightStorage::Int8 => match self.range(name) {
                Some(range) => self.statically_quantised_product(name, matrix, input, range),
                None => self.dynamically_quantised_product(name, matrix, input),
            },
        }
    }

    /// Multiplies `input` by `matrix` `[inputs, outputs]`, both quantised; values outside `range`
    /// are clamped to it.
    ///
    /// Written as the product of two dequantised tensors, which runtimes turn into a product of
    /// bytes.
    fn statically_quantised_product(
        &mut self,
        name: &str,
        matrix: &HostTensor,
        input: &Value,
        range: [f32; 2],
    ) -> Value {
        let (step, zero) = step_and_zero(range);
        let step = self.float(&format!("{name}.step"), &HostTensor::from_fn(vec![], |_| step));
        let zero = self.initializer(&format!("{name}.zero"), &[], proto::UINT8, vec![zero]);
        let quantised = self.apply("QuantizeLinear", &[input, &step, &zero], &[]);
        let input = self.apply("DequantizeLinear", &[&quantised, &step, &zero], &[]);

        let (weight, scales) = self.quantised_matrix(name, matrix);
        let centres = vec![0; matrix.dim(1)];
        let centres =
            self.initializer(&format!("{name}.centres"), &[matrix.dim(1)], proto::INT8, centres);
        let columns = [("axis", Attribute::Int(1))];
        let matrix = self.apply("DequantizeLinear", &[&weight, &scales, &centres], &columns);
        self.apply("MatMul", &[&input, &matrix], &[])
    }

    /// Multiplies where the range is unknown: every row has its own.
    fn dynamically_quantised_product(
        &mut self,
        name: &str,
        matrix: &HostTensor,
        input: &Value,
    ) -> Value {
        let (weight, scales) = self.quantised_matrix(name, matrix);
        let scalar = |graph: &mut Self, part: &str, value: f32| {
            graph.float(&format!("{name}.{part}"), &HostTensor::from_fn(vec![], |_| value))
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

    /// The bytes of a matrix, and the scales of its columns.
    fn quantised_matrix(&mut self, name: &str, matrix: &HostTensor) -> (Value, Value) {
        let columns = Columns::of(matrix);
        let weight =
            self.initializer(&format!("{name}.int8"), matrix.shape(), proto::INT8, columns.bytes);
        let outputs = columns.scales.len();
        let scales = HostTensor::from_fn(vec![outputs], |column| columns.scales[column]);
        (weight, self.float(&format!("{name}.scales"), &scales))
    }

    fn cast(&mut self, value: &Value, element: i32) -> Value {
        let to = ("to", Attribute::Int(i64::from(element)));
        self.apply("Cast", &[value], &[to])
    }
}

/// What one step of a byte is worth, and the byte that stands for 0, which is in every range.
fn step_and_zero([least, largest]: [f32; 2]) -> (f32, u8) {
    let (least, largest) = (least.min(0.0), largest.max(0.0));
    let step = ((largest - least) / STEPS).max(SMALLEST);
    (step, (-least / step).round() as u8)
}

/// Returns the range that [`step_and_zero`] was given.
pub(super) fn range(step: f32, zero: u8) -> [f32; 2] {
    [-f32::from(zero) * step, (STEPS - f32::from(zero)) * step]
}

/// A matrix, quantised column by column.
struct Columns {
    /// Row-major, one signed byte each.
    bytes: Vec<u8>,
    /// What a column's numbers are multiplied by.
    scales: Vec<f32>,
}

impl Columns {
    fn of(matrix: &HostTensor) -> Self {
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
    use std::{
        env::consts::{DLL_PREFIX, DLL_SUFFIX},
        sync::OnceLock,
    };

    use bailando::model::WeightStorage;
    use ort::{environment::Environment, session::Session};

    use super::*;
    use crate::onnx::{
        InputRanges,
        builder::{Dim, Element},
    };

    #[test]
    fn columns_are_off_by_half_a_step_at_most() {
        let matrix = HostTensor::from_fn(vec![5, 3], |flat| match flat % 3 {
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

    /// The runtime's environment, of which a process has one.
    fn environment() -> &'static Environment {
        static ENVIRONMENT: OnceLock<Environment> = OnceLock::new();
        ENVIRONMENT.get_or_init(|| {
            let library = std::env::var_os("ORT_DYLIB_PATH").unwrap_or_else(|| {
                let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../.onnxruntime/lib");
                format!("{folder}/{DLL_PREFIX}onnxruntime{DLL_SUFFIX}").into()
            });
            let builder = ort::environment::init_from(library).unwrap();
            builder.build().unwrap()
        })
    }

    /// Runs a graph of one product with `matrix` on rows of numbers.
    fn runner(matrix: &HostTensor, ranges: &InputRanges) -> impl FnMut(&[f32]) -> Vec<f32> + use<> {
        let inputs = matrix.dim(0);
        let mut graph = GraphBuilder::new("product", WeightStorage::Int8).with_ranges(ranges);
        let shape = |last| [Dim::Named("rows"), Dim::Fixed(last)];
        let input = graph.input("input", Element::Float, &shape(inputs));
        let product = graph.product("matrix", matrix, &input);
        graph.output("product", &product, Element::Float, &shape(matrix.dim(1)));
        let bytes = graph.finish().unwrap();
        let mut session =
            Session::builder(environment()).unwrap().commit_from_memory(&bytes).unwrap();
        move |rows| {
            let input = ([rows.len() / inputs, inputs], rows.to_vec());
            let input = ort::value::Tensor::from_array(input).unwrap();
            let outputs = session.run(ort::inputs! { "input" => input }).unwrap();
            outputs["product"].try_extract_tensor::<f32>().unwrap().1.to_vec()
        }
    }

    /// Computes the product of a row as defined, in double precision, from bytes of `step` each.
    fn by_definition(input: &[f32], columns: &Columns, step: f64, bytes: [f64; 2]) -> Vec<f64> {
        let width = columns.scales.len();
        let product = |column: usize| {
            let terms = input.iter().enumerate().map(|(k, &x)| {
                let weight = columns.bytes[width * k + column].cast_signed();
                let byte = (f64::from(x) / step).round_ties_even();
                byte.clamp(bytes[0], bytes[1]) * f64::from(weight)
            });
            terms.sum::<f64>() * step * f64::from(columns.scales[column])
        };
        (0..width).map(product).collect()
    }

    const INPUTS: usize = 40;

    fn matrix() -> HostTensor {
        HostTensor::from_fn(vec![INPUTS, 3], |flat| (flat as f32 * 0.7).sin())
    }

    #[test]
    fn a_product_is_as_defined_and_a_row_knows_nothing_of_the_others() {
        let mut run = runner(&matrix(), &InputRanges::default());
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
        let columns = Columns::of(&matrix());
        for (row, input) in rows.chunks(INPUTS).enumerate() {
            let found = &together[3 * row..3 * row + 3];
            assert_eq!(run(input), found);
            let largest = input.iter().fold(0.0_f32, |largest, x| largest.max(x.abs()));
            let step = f64::from(largest.max(SMALLEST) / LARGEST);
            let wanted = by_definition(input, &columns, step, [-127.0, 127.0]);
            for (&found, wanted) in found.iter().zip(wanted) {
                let tolerance = 1e-5 * f64::from(largest) + 1e-30;
                assert!((f64::from(found) - wanted).abs() < tolerance, "{row}");
            }
        }
    }

    #[test]
    fn a_product_in_a_known_range_is_as_defined_and_ends_where_the_range_does() {
        let range = [-0.5, 2.0];
        let ranges: InputRanges = [("matrix".to_owned(), range)].into_iter().collect();
        let mut run = runner(&matrix(), &ranges);
        let rows: Vec<f32> = (0..3 * INPUTS)
            .map(|flat| 3.0 * (flat as f32 * 0.9).cos() * (flat / INPUTS) as f32)
            .collect();
        let together = run(&rows);
        let columns = Columns::of(&matrix());
        let (step, zero) = step_and_zero(range);
        assert_eq!(zero, 51);
        let bytes = [-f64::from(zero), 255.0 - f64::from(zero)];
        for (row, input) in rows.chunks(INPUTS).enumerate() {
            let found = &together[3 * row..3 * row + 3];
            assert_eq!(run(input), found);
            let wanted = by_definition(input, &columns, f64::from(step), bytes);
            for (&found, wanted) in found.iter().zip(wanted) {
                assert!((f64::from(found) - wanted).abs() < 1e-4, "{row}: {found} {wanted}");
            }
        }
    }

    #[test]
    fn zero_is_a_byte_of_every_range() {
        assert_eq!(step_and_zero([-1.0, 1.55]).1, 100);
        assert_eq!(step_and_zero([0.5, 2.55]), (0.01, 0));
        assert_eq!(step_and_zero([-2.0, -1.0]).1, 255);
        assert_eq!(step_and_zero([0.0, 0.0]).1, 0);
    }
}
