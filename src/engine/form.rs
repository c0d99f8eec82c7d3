//! The song's form in the dance: where a section returns, its choreography returns.

use ndarray::ArrayView2;

use crate::features::{BeatPhase, Rate, Return, returns};

/// What is added to the logit of a code that must come.
const CERTAIN: f32 = 1e4;
/// What is added at the end of the bar before: there the model chooses its way to what returns, of
/// ever fewer.
const LEADING: f32 = 10.0;

/// Whether sections return if a caller does not say (docs/evaluation.md, "Form").
pub(super) const FORM: bool = false;

/// Which codes of a sequence are favoured because they were there before.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Form(Vec<Option<Favoured>>);

/// A code that stood there before.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Favoured {
    /// Codes from there to here.
    lag: usize,
    /// What is added to its logit.
    bonus: f32,
}

impl Form {
    /// The form of a song of feature rows, one per code.
    pub(crate) fn of(rows: ArrayView2<'_, f32>, counts: &BeatPhase) -> Self {
        let mut favoured = vec![None; rows.nrows()];
        for section in returns(rows, counts) {
            favour(&mut favoured, section);
        }
        Self(favoured)
    }

    /// Of forty codes of which those from 20 to 30 are those from 0 to 10.
    #[cfg(test)]
    pub(super) fn example() -> Self {
        let s = |code: f64| code / Rate::Conditioning.rows_per_second();
        let mut favoured = vec![None; 40];
        let section =
            Return { start_s: s(20.2), end_s: s(29.9), lag_s: s(20.0), bar_before_s: s(15.0) };
        favour(&mut favoured, section);
        Self(favoured)
    }

    /// Makes room for the prompt's code, before the first row.
    pub(super) fn after(&mut self, prompt: usize) {
        if !self.0.is_empty() {
            self.0 = [vec![None; prompt], std::mem::take(&mut self.0)].concat();
        }
    }

    /// The pair of codes that is favoured after `codes`, and what is added to its logits.
    pub(super) fn favoured(&self, codes: &[[u32; 2]]) -> Option<([u32; 2], f32)> {
        let Favoured { lag, bonus } = self.0.get(codes.len()).copied()??;
        let earlier = codes.len().checked_sub(lag)?;
        Some((codes[earlier], bonus))
    }
}

/// Favours the codes of a section, and a little those of the bar that led into it before.
fn favour(favoured: &mut [Option<Favoured>], section: Return) {
    let code = |seconds: f64| (seconds * Rate::Conditioning.rows_per_second()).round() as usize;
    let Return { start_s, end_s, lag_s, bar_before_s } = section;
    let (lead, start, end, lag) = (code(bar_before_s), code(start_s), code(end_s), code(lag_s));
    let steps = (start - lead) as f32 + 1.0;
    for (code, slot) in favoured.iter_mut().enumerate().take(end).skip(lead) {
        let bonus = match code < start {
            true => LEADING * (code - lead + 1) as f32 / steps,
            false => CERTAIN,
        };
        // What is certain to return is led nowhere else, and nothing stood before the first code.
        if code >= lag && slot.is_none_or(|other| other.bonus < CERTAIN) {
            *slot = Some(Favoured { lag, bonus });
        }
    }
}

/// Adds its bonus to the logit of the code that is favoured.
pub(super) fn favouring(
    logits: impl Iterator<Item = (u32, f32)>,
    favoured: Option<(u32, f32)>,
) -> impl Iterator<Item = (u32, f32)> {
    logits.map(move |(code, logit)| match favoured {
        Some((wanted, bonus)) if wanted == code => (code, logit + bonus),
        _ => (code, logit),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_of_a_section_return_and_those_before_lead_there() {
        let codes: Vec<[u32; 2]> = (0..40).map(|code| [code, code + 100]).collect();
        let at = |form: &Form, code: usize| form.favoured(&codes[..code]);
        let mut form = Form::example();
        assert_eq!(at(&form, 20), Some(([0, 100], CERTAIN)));
        assert_eq!(at(&form, 29), Some(([9, 109], CERTAIN)));
        for free in [0, 14, 19, 30, 39] {
            assert_eq!(at(&form, free), None, "{free}");
        }
        form.after(1);
        assert_eq!(at(&form, 20), None);
        assert_eq!(at(&form, 21), Some(([1, 101], CERTAIN)));
        assert_eq!(at(&Form::default(), 21), None);
    }

    #[test]
    fn the_bar_before_is_favoured_ever_more() {
        let mut favoured = vec![None; 40];
        let s = |code: f64| code / Rate::Conditioning.rows_per_second();
        let section =
            Return { start_s: s(30.0), end_s: s(40.0), lag_s: s(20.0), bar_before_s: s(26.0) };
        favour(&mut favoured, section);
        let bonus = |code: usize| favoured[code].map_or(0.0, |favoured| favoured.bonus);
        assert_eq!([25, 26, 27, 28, 29].map(bonus), [0.0, 2.0, 4.0, 6.0, 8.0]);
        assert_eq!(bonus(30), CERTAIN);
    }

    #[test]
    fn the_favoured_code_gains() {
        let logits = || (0..3).map(|code| (code, code as f32));
        let gained: Vec<_> = favouring(logits(), Some((1, 4.0))).collect();
        assert_eq!(gained, [(0, 0.0), (1, 5.0), (2, 2.0)]);
        assert!(favouring(logits(), None).eq(logits()));
    }
}
