//! What a model may be told beside the music: a style, and how much energy.

use ndarray::{Array2, ArrayView2};

/// Most styles of a model.
pub const MAX_STYLES: usize = 64;
/// Longest name of a style in bytes.
const LONGEST_NAME: usize = 32;
/// Values of the option `style` that are no style: one that is to be found for the music, and none
/// of them.
pub const NO_STYLE: [&str; 2] = ["auto", "mixed"];

/// Style and energy of a dance, as far as they are known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Manner {
    /// Place of the style among those of the model.
    pub style: Option<usize>,
    /// From 0, the slowest of its style in training, to 1, the quickest.
    pub energy: Option<f32>,
}

/// Which manners a model knows; their columns follow those of the music.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MannerSpec {
    /// Number of styles.
    pub styles: usize,
    /// Whether it knows energies.
    pub energy: bool,
}

impl MannerSpec {
    /// Number of columns: one a style; where energies are known, their value and whether it is
    /// given.
    #[must_use]
    pub fn columns(self) -> usize {
        self.styles + 2 * usize::from(self.energy)
    }

    /// Returns the columns of a manner: 1 for its style, 0 for all others; for the energy -1 to 1,
    /// then 1. What is not given, or not known to the model, is 0.
    pub fn values(self, manner: Manner) -> impl Iterator<Item = f32> + Clone {
        let Manner { style, energy } = manner;
        let styles = (0..self.styles).map(move |other| f32::from(u8::from(style == Some(other))));
        let energies = energy.map_or([0.0; 2], |energy| [2.0 * energy - 1.0, 1.0]);
        styles.chain(energies.into_iter().filter(move |_| self.energy))
    }

    /// Returns rows of music `[rows, columns]` with the columns of a manner after them.
    #[must_use]
    pub fn beside(self, music: ArrayView2<'_, f32>, manner: Manner) -> Array2<f32> {
        let (rows, width) = music.dim();
        let mut beside = Array2::zeros((rows, width + self.columns()));
        for (mut row, music) in beside.rows_mut().into_iter().zip(music.rows()) {
            let values = music.iter().copied().chain(self.values(manner));
            row.iter_mut().zip(values).for_each(|(cell, value)| *cell = value);
        }
        beside
    }
}

/// Checks names of styles: they are values of an option.
///
/// # Errors
/// One line that says what is wrong.
pub fn check_styles(styles: &[String]) -> Result<(), String> {
    if styles.len() > MAX_STYLES {
        let count = styles.len();
        return Err(format!("{count} styles are listed, expected at most {MAX_STYLES}"));
    }
    let plain = |name: &str| {
        let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
        (1..=LONGEST_NAME).contains(&name.len())
            && name.bytes().all(plain)
            && !NO_STYLE.contains(&name)
    };
    if let Some(name) = styles.iter().find(|name| !plain(name)) {
        return Err(format!(
            "{name:?} is no name of a style: expected up to {LONGEST_NAME} of a to z, 0 to 9 and \
             -, but not {}",
            NO_STYLE.join(" or ")
        ));
    }
    let mut sorted: Vec<&String> = styles.iter().collect();
    sorted.sort_unstable();
    match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(format!("style {:?} is listed twice", pair[0])),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_styles_are_checked() {
        let check = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|&name| name.into()).collect();
            check_styles(&names)
        };
        assert_eq!(check(&["salsa", "la-hiphop", "style-2"]), Ok(()));
        assert_eq!(check(&[]), Ok(()));
        let long = "x".repeat(33);
        for wrong in ["", "Salsa", "street jazz", "auto", "mixed", "bre&k", &long] {
            assert!(check(&["pop", wrong]).unwrap_err().contains("no name of a style"), "{wrong}");
        }
        assert!(check(&["pop", "lock", "pop"]).unwrap_err().contains("twice"));
        let many: Vec<String> = (0..65).map(|number| format!("s{number}")).collect();
        assert!(check_styles(&many).unwrap_err().contains("at most 64"));
    }

    fn values(spec: MannerSpec, style: Option<usize>, energy: Option<f32>) -> Vec<f32> {
        let values: Vec<f32> = spec.values(Manner { style, energy }).collect();
        assert_eq!(values.len(), spec.columns());
        values
    }

    #[test]
    fn a_manner_has_a_column_for_each_style_and_two_for_the_energy() {
        let spec = MannerSpec { styles: 3, energy: true };
        assert_eq!(values(spec, Some(1), Some(0.75)), [0.0, 1.0, 0.0, 0.5, 1.0]);
        assert_eq!(values(spec, None, Some(0.0)), [0.0, 0.0, 0.0, -1.0, 1.0]);
        assert_eq!(values(spec, Some(7), None), [0.0; 5]);
        let spec = MannerSpec { styles: 2, energy: false };
        assert_eq!(values(spec, Some(0), Some(0.5)), [1.0, 0.0]);
        assert_eq!(values(MannerSpec::default(), Some(0), Some(0.5)), [0.0; 0]);
        let music = ndarray::array![[7.0], [8.0]];
        let beside = spec.beside(music.view(), Manner { style: Some(1), energy: None });
        assert_eq!(beside, ndarray::array![[7.0, 0.0, 1.0], [8.0, 0.0, 1.0]]);
    }
}
