//! The dances of one request: its only one, or those in which a loop is looked for.

use super::RequestOptions;
use crate::{
    engine::{GenerationOptions, MAX_SEED},
    formats::{FormatError, GeneratedMotion, LoopSearch, OutputFormat},
};

/// What becomes of a request's dances.
#[derive(Clone, Debug)]
pub struct Takes {
    search: Option<LoopSearch>,
    /// Seed of the first dance.
    seed: u64,
}

/// What a dance has led to.
#[derive(Debug)]
pub enum Take {
    /// The result.
    Done(GeneratedMotion),
    /// One more dance is wanted, with this seed.
    Another(Takes, u64),
}

impl Takes {
    /// Takes the next dance of the request.
    ///
    /// # Errors
    /// As [`LoopSearch::consider`] and [`LoopSearch::finish`].
    pub fn push(mut self, dance: GeneratedMotion) -> Result<Take, FormatError> {
        let Some(mut search) = self.search else { return Ok(Take::Done(dance)) };
        if search.dances() == 0 {
            self.seed = dance.seed;
        }
        search.consider(dance)?;
        if search.needs_another() {
            let seed = (self.seed + search.dances() as u64) % (MAX_SEED + 1);
            return Ok(Take::Another(Self { search: Some(search), ..self }, seed));
        }
        let found = search.finish()?;
        Ok(Take::Done(found.unwrap_or_else(|| unreachable!("a dance was considered"))))
    }
}

impl RequestOptions {
    /// What becomes of the dances of a request with these options.
    #[must_use]
    pub fn takes(&self) -> Takes {
        Takes { search: self.bars_wanted().map(LoopSearch::new), seed: 0 }
    }

    /// Makes as many dances as these options need for a result in `format`, one after another.
    ///
    /// # Errors
    /// Those of `generate` and of [`Takes::push`].
    pub fn dance<E: From<FormatError>>(
        &self,
        format: OutputFormat,
        mut generate: impl FnMut(GenerationOptions) -> Result<GeneratedMotion, E>,
    ) -> Result<GeneratedMotion, E> {
        let mut options = self.generation(format);
        let mut takes = self.takes();
        loop {
            match takes.push(generate(options.clone())?)? {
                Take::Done(dance) => return Ok(dance),
                Take::Another(rest, seed) => (takes, options.seed) = (rest, Some(seed)),
            }
        }
    }
}
