//! Everything that `check-data` can find, with what it means and what helps.

use serde::Serialize;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Training cannot start, or would learn nonsense.
    Unusable,
    /// Training works; the result may suffer.
    Warning,
    /// Good to know.
    Note,
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Topic {
    /// An entry of the index cannot be used.
    Entry,
    /// Two pieces have one name.
    DuplicateId,
    /// A file is not there.
    MissingFile,
    /// A motion file cannot be read.
    MotionFile,
    /// A song cannot be read.
    AudioFile,
    /// Nothing to train with.
    NoTraining,
    /// The same motion is in both splits.
    Leak,
    /// Values that are no numbers.
    NotFinite,
    /// Not metres.
    Units,
    /// The root's path is of another unit than the body.
    RootUnits,
    /// Not y up.
    Axes,
    /// The index declares another length than the file has.
    DeclaredLength,
    /// Not 60 frames a second.
    FrameRate,
    /// The motion and its song differ in length.
    AudioLength,
    /// The song has no sound.
    Silent,
    /// Left and right look exchanged.
    Sides,
    /// Bones change their length.
    BonesVary,
    /// Bones have other lengths than `offsets`.
    BonesDiffer,
    /// Something jumps.
    Jumps,
    /// Almost nothing moves.
    Still,
    /// The feet are not near y = 0.
    Floor,
    /// Shorter than a crop.
    Short,
    /// The grid's times are no beats of this song.
    Grid,
    /// The grid is early or late.
    GridOffset,
    /// The music has no beats.
    NoBeats,
    /// Stored rows have 60 a second.
    StoredRows,
    /// Lists of splits name dances that are not there.
    Absent,
    /// Nothing to evaluate with.
    NoTest,
    /// Variants of one recording are in both splits.
    SharedRecording,
    /// The same song is in both splits.
    SharedSong,
    /// The same file under two names, or the same pair twice.
    Duplicate,
    /// Pieces without music.
    NoMusic,
    /// A remark of the reader.
    Layout,
}

/// Severity, what it means, what helps.
type Explanation = (Severity, &'static str, &'static str);

impl Topic {
    /// How bad it is.
    #[must_use]
    pub fn severity(self) -> Severity {
        self.explanation().0
    }

    /// What it means, in one sentence.
    #[must_use]
    pub fn meaning(self) -> &'static str {
        self.explanation().1
    }

    /// What to do about it; empty where nothing needs to be done.
    #[must_use]
    pub fn advice(self) -> &'static str {
        self.explanation().2
    }

    #[rustfmt::skip]
    fn explanation(self) -> Explanation {
        use Severity::{Note, Unusable, Warning};
        match self {
            Self::Entry => (Unusable, "Some entries of the data cannot be used.",
                "Correct these entries, or take them out."),
            Self::DuplicateId => (Unusable, "Several pieces have the same id.",
                "Give every piece an id of its own."),
            Self::MissingFile => (Unusable, "Files that the data name are not there.",
                "Copy the missing files into place (names are case-sensitive), or take the pieces \
                 out."),
            Self::MotionFile => (Unusable, "Motion files cannot be read.",
                "Motion is float32 [frames, 24, 3]; write or download the files again."),
            Self::AudioFile => (Unusable, "Songs, or the music rows of files, cannot be read.",
                "Use wav, flac, mp3, ogg/vorbis or m4a/aac files that a player plays to their \
                 end."),
            Self::NoTraining => (Unusable, "No piece can be used for training.",
                "At least one piece needs the split train and 240 frames (4 s)."),
            Self::Leak => (Unusable,
                "The same motion is in train and in test: tests would measure training data.",
                "Move every copy of a motion into one split."),
            Self::NotFinite => (Unusable, "Motions hold values that are no numbers (NaN or \
                                           infinite).",
                "Fill such gaps by interpolation, or cut the piece there."),
            Self::Units => (Unusable, "The body has not the size of a person in metres.",
                "Multiply all positions by the factor given."),
            Self::RootUnits => (Unusable, "The root's path has not the size of a dance floor in \
                                           metres, though the body fits.",
                "Bring the root into metres; with AIST++, check that smpl_trans is in centimetres \
                 and smpl_scaling about 93."),
            Self::Axes => (Unusable, "The figures do not stand upright along +y.",
                "Turn the data so that y points up and the system stays right-handed: from z up, \
                 (x, y, z) becomes (x, z, -y)."),
            Self::DeclaredLength => (Unusable, "Motions have another length than the index \
                                                declares.",
                "Correct `frames` and `seconds`, or bring back the right file: the wrong one may \
                 belong to another song."),
            Self::FrameRate => (Unusable, "Motions do not look like 60 frames a second.",
                "Resample the motion to 60 frames a second."),
            Self::AudioLength => (Warning,
                "Songs are not as long as their motions; only the common part is used.",
                "Check that dance and song belong together and both start at the same moment."),
            Self::Silent => (Unusable, "Songs hold no sound.",
                "Export the songs again."),
            Self::Sides => (Warning, "Left and right look exchanged: the feet point backwards for \
                                      these hips.",
                "Swap the left and right joints, or negate one axis if the data come from a \
                 left-handed system."),
            Self::BonesVary => (Warning, "Bones change their length along a dance.",
                "Put the motion on a fixed skeleton; the model would learn the wobble."),
            Self::BonesDiffer => (Warning, "Bones have other lengths than the skeleton's \
                                            `offsets`.",
                "Retarget the motion to the skeleton, or give the index the offsets of these \
                 dancers."),
            Self::Jumps => (Warning, "Joints jump faster than people move.",
                "Look at these frames: they are tracking failures or cuts."),
            Self::Still => (Warning, "Motions hardly move.",
                "Take out pieces, or parts of them, in which nobody moves."),
            Self::Floor => (Warning, "The standing foot is not near the floor y = 0.",
                "Harmless for training, which sees the root's velocity alone; move the data so \
                 that feet stand at y = 0 before exporting a root height."),
            Self::Short => (Warning, "Motions are shorter than one crop of 240 frames (4 s) and \
                                      are not used.",
                "Join them, or take them out."),
            Self::Grid => (Warning, "The beat grid and the beats found in the song do not agree.",
                "Check tempo and start of `grid_beats_s`, and that the audio belongs to the \
                 piece."),
            Self::GridOffset => (Warning,
                "The beat grid is early or late against the beats found in the song.",
                "Check that the audio starts at frame 0 (mp3 encoders put 25-50 ms in front)."),
            Self::NoBeats => (Warning, "No beats are found in songs.",
                "Check the files; music without a pulse teaches no timing."),
            Self::StoredRows => (Warning, "music_array has 60 rows a second: enough for beat \
                                           scores, but the GPT needs 7.5.",
                "Give the songs with --audio DIR, or the 7.5-row files in a folder `music`."),
            Self::Absent => (Warning, "The lists of splits name dances that the folder lacks.",
                "Get the whole set: the AIST++ archive that is easiest to get holds 411 of 1,408 \
                 dances. Figures of a part compare with no published ones."),
            Self::NoTest => (Warning, "No piece has the split test: there is nothing to judge the \
                                       model by.",
                "Keep some takes apart as test, with songs of their own."),
            Self::SharedRecording => (Warning, "Variants of one recording are in train and in \
                                                test.",
                "Split by recording, not by piece."),
            Self::SharedSong => (Warning, "The same song is in train and in test.",
                "Keep test songs out of train to measure motion for new music."),
            Self::Duplicate => (Warning, "The same content occurs more than once.",
                "Take out the copies, or name one shared file: weights go by motion file."),
            Self::NoMusic => (Note, "Pieces have no music: they train the VQ-VAE alone.", ""),
            Self::Layout => (Note, "About the folder.", ""),
        }
    }
}
