//! The options as flags of the command line.

use clap::{
    Arg, ArgMatches, Args, Command, Error, FromArgMatches,
    builder::{PossibleValuesParser, TypedValueParser},
    error::ErrorKind,
};

use super::{OPTIONS, OptionSpec, RequestOptions, Section, accepts::Accepts};

/// Returns the flag of an option; its id is the name of the option.
fn arg(spec: &'static OptionSpec) -> Arg {
    let value = match spec.accepts {
        Accepts::Boolean => "BOOL".to_owned(),
        Accepts::Tail => "TAIL".to_owned(),
        _ => spec.name.to_uppercase(),
    };
    let about = spec.about.trim_end_matches('.').replace('`', "");
    let accepts = match spec.accepts {
        Accepts::IntegerOf(_) => format!(": {}", spec.accepts),
        _ => String::new(),
    };
    let arg = Arg::new(spec.name)
        .long(spec.name.replace('_', "-"))
        .value_name(value)
        .help(format!("{about}{accepts} [default: {}]", spec.default))
        .allow_hyphen_values(true);
    let arg = match spec.section {
        Section::Sampling => arg.help_heading("Sampling"),
        Section::Song => arg.help_heading("Song and motion"),
        Section::Output | Section::HttpOutput | Section::HttpInput => arg,
    };
    match spec.accepts.words() {
        Some(words) => arg.value_parser(PossibleValuesParser::new(words).map(String::from)),
        None => arg.value_parser(move |text: &str| {
            let checked = spec.check(text).map(|()| text.to_owned());
            checked.map_err(|_| format!("expected {}", spec.accepts))
        }),
    }
}

fn flags() -> impl Iterator<Item = &'static OptionSpec> {
    let all = OPTIONS.iter();
    all.filter(|spec| !matches!(spec.section, Section::HttpOutput | Section::HttpInput))
}

impl Args for RequestOptions {
    fn augment_args(command: Command) -> Command {
        flags().fold(command, |command, spec| command.arg(arg(spec)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for RequestOptions {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        let mut options = Self::default();
        options.update_from_arg_matches(matches)?;
        Ok(options)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        for spec in flags() {
            if let Some(text) = matches.get_one::<String>(spec.name) {
                let set = self.set(spec.name, text);
                set.map_err(|error| Error::raw(ErrorKind::InvalidValue, error))?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Flags {
        #[command(flatten)]
        options: RequestOptions,
    }

    fn parse(flags: &[&str]) -> Result<RequestOptions, String> {
        let parsed = Flags::try_parse_from([&["generate"], flags].concat());
        parsed.map(|flags| flags.options).map_err(|error| error.to_string())
    }

    #[test]
    fn a_flag_sets_the_option_of_its_name() {
        let mut wanted = RequestOptions::default();
        assert_eq!(parse(&[]).as_ref(), Ok(&wanted));
        for (name, value) in [("top_k", "7"), ("redo", "true"), ("fps", "24"), ("bvh_unit", "m")] {
            wanted.set(name, value).unwrap();
        }
        let flags = ["--fps=24", "--bvh-unit", "m", "--redo", "true", "--top-k", "7"];
        let mut parsed = parse(&flags).unwrap();
        // In the order of the list.
        wanted.given.sort_unstable();
        parsed.given.sort_unstable();
        assert_eq!(parsed, wanted);
    }

    #[test]
    fn a_wrong_value_is_refused_with_what_is_accepted() {
        for (flag, accepted) in [
            ("--fps=25", "expected one of 20, 24, 30, 60"),
            ("--candidates=99", "expected a whole number from 1 to 16"),
            ("--temperature=-1", "expected a number from 0 to 10"),
            ("--redo=maybe", "[possible values: true, false]"),
            ("--window=wide", "[possible values: hop, sliding]"),
        ] {
            let problem = parse(&[flag]).unwrap_err();
            assert!(problem.contains(accepted), "{flag}: {problem}");
        }
        assert!(parse(&["--include", "rotations"]).is_err());
    }
}
