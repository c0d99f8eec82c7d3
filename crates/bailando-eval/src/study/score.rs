//! The score of a study: how often people preferred the dances of the first method.

use std::{collections::BTreeMap, path::Path};

use serde::{Deserialize, Serialize};

use crate::{
    error::EvaluationError,
    files::{entries, text},
    interval::mean_and_margin,
};

/// A file that the page exports.
#[derive(Deserialize)]
struct Answers {
    study: String,
    person: String,
    answers: Vec<Answer>,
}

#[derive(Deserialize)]
struct Answer {
    pair: String,
    chosen: Method,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
enum Method {
    A,
    B,
}

/// What people preferred.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StudyScore {
    /// The study's name.
    pub study: String,
    /// People who answered.
    pub people: usize,
    /// Their answers.
    pub answers: usize,
    /// Mean over the people of each one's share of answers for the first method, 0 to 1.
    pub wins: f64,
    /// Half of the 95 % confidence interval of `wins` (Student's t over people); none of one
    /// person.
    pub margin: Option<f64>,
    /// The share for each pair, by name, over all its answers.
    pub pairs: BTreeMap<String, f64>,
}

impl StudyScore {
    /// Reads every `.json` file of a folder. A person who answered about a pair twice is counted
    /// once, with the answer of the file that comes last by name.
    ///
    /// # Errors
    /// [`EvaluationError`] names a file that is no answers, or those of another study.
    ///
    /// # Examples
    /// ```no_run
    /// let score = bailando_eval::StudyScore::read("answers".as_ref())?;
    /// println!("{:.0} % of {} people's answers", 100.0 * score.wins, score.people);
    /// # Ok::<(), bailando_eval::EvaluationError>(())
    /// ```
    pub fn read(folder: &Path) -> Result<Self, EvaluationError> {
        let mut study: Option<String> = None;
        let mut people: BTreeMap<String, BTreeMap<String, Method>> = BTreeMap::new();
        for path in entries(folder)? {
            if path.extension().is_none_or(|extension| extension != "json") {
                continue;
            }
            let answers: Answers = serde_json::from_str(&text(&path)?)
                .map_err(|error| EvaluationError::file(&path, format!("no answers: {error}")))?;
            let first = study.get_or_insert_with(|| answers.study.clone());
            if *first != answers.study {
                let problem = format!("answers of the study {:?}, not {first:?}", answers.study);
                return Err(EvaluationError::file(&path, problem));
            }
            let person = people.entry(answers.person).or_default();
            person.extend(answers.answers.into_iter().map(|answer| (answer.pair, answer.chosen)));
        }
        people.retain(|_, answers| !answers.is_empty());
        let nobody = || EvaluationError::file(folder, "nobody's answers are in it");
        let study = study.ok_or_else(nobody)?;
        let shares: Vec<f64> = people.values().map(|own| share(own.values().copied())).collect();
        let (wins, margin) = mean_and_margin(&shares).ok_or_else(nobody)?;
        let mut by_pair: BTreeMap<String, Vec<Method>> = BTreeMap::new();
        for (pair, chosen) in people.values().flatten() {
            by_pair.entry(pair.clone()).or_default().push(*chosen);
        }
        Ok(Self {
            study,
            people: people.len(),
            answers: people.values().map(BTreeMap::len).sum(),
            wins,
            margin,
            pairs: by_pair.into_iter().map(|(pair, all)| (pair, share(all.into_iter()))).collect(),
        })
    }
}

/// The share of the first method.
fn share(chosen: impl ExactSizeIterator<Item = Method>) -> f64 {
    let count = chosen.len() as f64;
    chosen.filter(|&method| method == Method::A).count() as f64 / count
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn answers(person: &str, chosen: &[(&str, &str)]) -> String {
        let answers: Vec<_> = chosen
            .iter()
            .map(|(pair, chosen)| serde_json::json!({"pair": pair, "chosen": chosen}))
            .collect();
        serde_json::json!({"study": "s", "person": person, "answers": answers}).to_string()
    }

    /// By hand: shares 3/4, 1/2 and 1 of three people: mean 0.75, deviation 0.25, and
    /// 4.30265 * 0.25 / sqrt(3) = 0.62104.
    #[test]
    fn wins_are_the_mean_over_people() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: String| fs::write(folder.path().join(name), text).unwrap();
        let read = || StudyScore::read(folder.path());
        assert!(read().unwrap_err().to_string().contains("nobody's answers"));
        write("1.json", answers("x", &[("p", "a"), ("q", "a"), ("r", "b"), ("s", "b")]));
        // The same person again: only what changed counts.
        write("2.json", answers("x", &[("s", "a")]));
        write("3.json", answers("y", &[("p", "a"), ("q", "b")]));
        write("4.json", answers("z", &[("p", "a")]));
        write("notes.txt", String::new());
        let score = read().unwrap();
        assert_eq!((score.people, score.answers, score.wins), (3, 7, 0.75));
        assert!((score.margin.unwrap() - 0.621_04).abs() < 1e-4);
        assert_eq!((score.pairs["p"], score.pairs["q"]), (1.0, 0.5));
        write("5.json", answers("w", &[]).replace("\"s\"", "\"t\""));
        assert!(read().unwrap_err().to_string().contains("5.json: answers of the study \"t\""));
        write("5.json", "{}".to_owned());
        assert!(read().unwrap_err().to_string().contains("5.json: no answers"));
    }
}
