//! `bailando study`: a page that asks people which of two dances is better, and the score of their
//! answers.

use std::path::PathBuf;

use bailando::evaluation::{StudyOptions, StudyScore};

use super::console::{say, say_error};

/// Ask people which of two dances is the better one to a song, and count their answers
///
/// Motions and songs belong together by their names. The page needs no server: send the folder, and
/// collect the files that it saves.
#[derive(Debug, clap::Args)]
pub(super) struct StudyArgs {
    /// Dances of the first method (.npy, .json, .bvh)
    #[arg(long, value_name = "DIR", required_unless_present = "score")]
    a: Option<PathBuf>,
    /// Dances of the second method
    #[arg(long, value_name = "DIR", required_unless_present = "score")]
    b: Option<PathBuf>,
    /// Their songs
    #[arg(long, value_name = "DIR", required_unless_present = "score")]
    songs: Option<PathBuf>,
    /// Folder for the page
    #[arg(short, long, value_name = "DIR", required_unless_present = "score")]
    output: Option<PathBuf>,
    /// Name of the study, which the answers carry
    #[arg(long, default_value = "study")]
    name: String,
    /// Count the answers in this folder instead: the share of wins of the first method
    #[arg(long, value_name = "DIR", conflicts_with_all = ["a", "b", "songs", "output", "name"])]
    score: Option<PathBuf>,
    /// Print the score as JSON
    #[arg(long, requires = "score")]
    json: bool,
}

pub(super) fn run(args: &StudyArgs) -> anyhow::Result<()> {
    match &args.score {
        Some(folder) => {
            let score = StudyScore::read(folder)?;
            say(&if args.json { serde_json::to_string_pretty(&score)? } else { table(&score) });
            Ok(())
        }
        None => write_page(args),
    }
}

fn write_page(args: &StudyArgs) -> anyhow::Result<()> {
    // The parser has seen to it that they are there.
    let folder = |given: &Option<PathBuf>| given.clone().unwrap_or_default();
    let output = folder(&args.output);
    let options = StudyOptions {
        a: folder(&args.a),
        b: folder(&args.b),
        songs: folder(&args.songs),
        output: output.clone(),
        name: args.name.clone(),
    };
    let (pairs, left) = options.write()?;
    if !left.is_empty() {
        say_error(&format!("warning: not in all three folders: {}", left.join(", ")));
    }
    say(&format!("{}: {pairs} pairs", output.join("index.html").display()));
    Ok(())
}

fn table(score: &StudyScore) -> String {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let margin = score.margin.map_or_else(String::new, |margin| format!(" ± {}", percent(margin)));
    let mut text = format!(
        "{}: the first method wins {}{margin} (mean over {} people, 95 % interval; {} answers)",
        score.study,
        percent(score.wins),
        score.people,
        score.answers
    );
    for (pair, share) in &score.pairs {
        text += &format!("\n  {pair}: {}", percent(*share));
    }
    text
}
