//! BVH files of callers: read for their hierarchy, and written again with another motion.

use std::fmt::Write;

use glam::{DQuat, DVec3};

use super::{
    limits::{RigLimits, check_name},
    pose::Poses,
    refusal::{problem, short},
    tree::{Bone, Tree},
};
use crate::{decimal::push_decimal, error::FormatError, euler::RotationOrder};

/// Most channels of one joint: three of place and three of rotation.
const MOST_CHANNELS: usize = 6;
/// Longest line of a hierarchy in bytes.
const LONGEST_LINE: usize = 64 * 1024;
/// Decimals of lengths and of degrees.
const DECIMALS: usize = 6;
/// Longest part of an OFFSET: it is written with every frame, and must not have hundreds of digits.
const FARTHEST: f64 = 1e6;
/// What a frame of one joint with three channels takes, about, in bytes.
const BYTES_PER_JOINT: usize = 45;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
    Place(usize),
    Turn(usize),
}

/// A BVH file whose motion is replaced.
#[derive(Clone, Debug)]
pub(super) struct BvhFile {
    bytes: Vec<u8>,
    /// Where the hierarchy ends.
    motion: usize,
    /// Channels of every bone, in its order in the file; ends of bones have none.
    channels: Vec<Vec<Channel>>,
    line_end: &'static str,
}

/// Whether a file begins as BVH does.
pub(super) fn is_bvh(bytes: &[u8]) -> bool {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    text.get(..9).is_some_and(|word| word.eq_ignore_ascii_case(b"HIERARCHY"))
}

/// Reads a file.
pub(super) fn read(bytes: Vec<u8>, limits: &RigLimits) -> Result<(BvhFile, Tree), FormatError> {
    let mut reader = Reader::new(limits);
    let mut at = 0;
    let mut motion = None;
    for line in bytes.split_inclusive(|&byte| byte == b'\n' || byte == b'\r') {
        if line.len() > LONGEST_LINE {
            return problem(format!("the BVH file's hierarchy has a line of {} bytes", line.len()));
        }
        let text = String::from_utf8_lossy(line);
        if text.trim().eq_ignore_ascii_case("MOTION") {
            motion = Some(at);
            break;
        }
        reader.line(text.trim_start_matches('\u{feff}').trim())?;
        at += line.len();
    }
    let Some(motion) = motion else {
        return problem("it is a BVH file without MOTION");
    };
    if !reader.open.is_empty() || reader.bones.is_empty() {
        return problem("the hierarchy of the BVH file does not end");
    }
    let line_end = if bytes[..motion].contains(&b'\r') { "\r\n" } else { "\n" };
    let Reader { bones, channels, .. } = reader;
    let tree = Tree::new(bones)?;
    Ok((BvhFile { bytes, motion, channels, line_end }, tree))
}

struct Reader<'a> {
    limits: &'a RigLimits,
    bones: Vec<Bone>,
    channels: Vec<Vec<Channel>>,
    /// Bones whose braces are open.
    open: Vec<usize>,
    /// The bone whose brace comes next.
    announced: Option<usize>,
}

impl<'a> Reader<'a> {
    fn new(limits: &'a RigLimits) -> Self {
        Self { limits, bones: Vec::new(), channels: Vec::new(), open: Vec::new(), announced: None }
    }

    fn line(&mut self, line: &str) -> Result<(), FormatError> {
        let (line, opens) = match line.strip_suffix('{') {
            Some(line) => (line.trim_end(), true),
            None => (line, false),
        };
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        match word.to_ascii_uppercase().as_str() {
            "" | "HIERARCHY" => {}
            "ROOT" | "JOINT" => self.announce(rest, true)?,
            "END" => self.announce("", false)?,
            "OFFSET" => self.offset(rest)?,
            "CHANNELS" => self.channels(rest)?,
            _ if !line.is_empty() && line.chars().all(|c| c == '}' || c.is_whitespace()) => {
                for _ in line.chars().filter(|&c| c == '}') {
                    if self.open.pop().is_none() {
                        return problem("a brace of the BVH file's hierarchy closes nothing");
                    }
                }
            }
            _ => {
                return problem(format!("the BVH file's hierarchy has the line `{}`", short(line)));
            }
        }
        if opens {
            match self.announced.take() {
                Some(bone) => self.open.push(bone),
                None => return problem("a brace of the BVH file's hierarchy opens nothing"),
            }
        }
        Ok(())
    }

    fn announce(&mut self, name: &str, turns: bool) -> Result<(), FormatError> {
        let parent = self.open.last().copied();
        if self.announced.is_some() || (parent.is_none() && !self.bones.is_empty()) {
            return problem("the BVH file has several roots, or a joint without braces");
        }
        self.limits.check_bones(self.bones.len() + 1)?;
        check_name(name)?;
        self.announced = Some(self.bones.len());
        self.channels.push(Vec::new());
        self.bones.push(Bone {
            name: name.to_owned(),
            parent,
            place: DVec3::ZERO,
            turn: DQuat::IDENTITY,
            scale: DVec3::ONE,
            turns,
        });
        Ok(())
    }

    fn open_bone(&self) -> Result<usize, FormatError> {
        match self.open.last() {
            Some(&bone) => Ok(bone),
            None => problem("the BVH file has an OFFSET or CHANNELS outside of a joint"),
        }
    }

    fn offset(&mut self, text: &str) -> Result<(), FormatError> {
        let bone = self.open_bone()?;
        let numbers: Vec<f64> =
            text.split_whitespace().take(4).filter_map(|word| word.parse().ok()).collect();
        match numbers.as_slice() {
            &[x, y, z] if [x, y, z].iter().all(|v| v.abs() <= FARTHEST) => {
                self.bones[bone].place = DVec3::new(x, y, z);
                Ok(())
            }
            _ => {
                let (name, text) = (short(&self.bones[bone].name), short(text));
                problem(format!(
                    "the OFFSET of `{name}` is `{text}`, not three numbers of at most {FARTHEST}"
                ))
            }
        }
    }

    fn channels(&mut self, text: &str) -> Result<(), FormatError> {
        let bone = self.open_bone()?;
        let mut words = text.split_whitespace();
        let count = words.next().and_then(|count| count.parse::<usize>().ok());
        let channels: Option<Vec<Channel>> = words.take(MOST_CHANNELS + 1).map(channel).collect();
        let fits = |channels: &Vec<Channel>| {
            let twice = |(at, channel): (usize, &Channel)| channels[..at].contains(channel);
            count == Some(channels.len())
                && channels.len() <= MOST_CHANNELS
                && !channels.iter().enumerate().any(twice)
        };
        match channels.filter(fits) {
            Some(channels) => {
                self.channels[bone] = channels;
                Ok(())
            }
            None => {
                let (name, text) = (short(&self.bones[bone].name), short(text));
                problem(format!(
                    "the CHANNELS of `{name}` are `{text}`, not a count and at most six different \
                     ones of Xposition, Yposition, Zposition, Xrotation, Yrotation, Zrotation"
                ))
            }
        }
    }
}

fn channel(word: &str) -> Option<Channel> {
    let (axis, kind) = word.split_at_checked(1)?;
    let axis = ["x", "y", "z"].iter().position(|name| axis.eq_ignore_ascii_case(name))?;
    match kind.to_ascii_lowercase().as_str() {
        "position" => Some(Channel::Place(axis)),
        "rotation" => Some(Channel::Turn(axis)),
        _ => None,
    }
}

impl BvhFile {
    /// Returns the bone whose position channels carry the hips along: they, or one above.
    pub(super) fn carrier(&self, tree: &Tree, hips: usize) -> Result<usize, FormatError> {
        let moves =
            |&bone: &usize| (0..3).all(|axis| self.channels[bone].contains(&Channel::Place(axis)));
        let found = std::iter::once(hips).chain(tree.above(hips)).find(moves);
        match found {
            Some(bone) => Ok(bone),
            None => problem("neither its hips nor a joint above them have position channels"),
        }
    }

    /// Checks that bones have three channels of rotation.
    pub(super) fn check_turns(
        &self,
        tree: &Tree,
        bones: impl Iterator<Item = usize>,
    ) -> Result<(), FormatError> {
        for bone in bones {
            if self.order(bone).is_none() {
                let name = tree.shown(bone);
                return problem(format!("`{name}` does not have three channels of rotation"));
            }
        }
        Ok(())
    }

    fn order(&self, bone: usize) -> Option<RotationOrder> {
        let turns = self.channels[bone].iter().filter_map(|channel| match channel {
            Channel::Turn(axis) => Some(*axis),
            Channel::Place(_) => None,
        });
        let axes: Vec<usize> = turns.collect();
        <[usize; 3]>::try_from(axes).ok().map(RotationOrder)
    }

    /// About the most bytes of a file with so many frames.
    pub(super) fn most_bytes(&self, frames: usize) -> usize {
        let channels: usize = self.channels.iter().map(Vec::len).sum();
        let frame = BYTES_PER_JOINT.saturating_mul(channels / 3 + 2);
        self.motion.saturating_add(frame.saturating_mul(frames)).saturating_add(200)
    }

    /// Writes the file with other frames.
    pub(super) fn write(&self, tree: &Tree, poses: &Poses) -> Result<Vec<u8>, FormatError> {
        let frames = poses.hips.len();
        let mut text = String::with_capacity(self.most_bytes(frames) - self.motion);
        let end = self.line_end;
        let frame_time = 1.0 / f64::from(poses.fps);
        write!(text, "MOTION{end}Frames: {frames}{end}Frame Time: {frame_time:.8}{end}")?;
        let carrier = self.carrier(tree, poses.hips_bone)?;
        let rest = tree.places[poses.hips_bone];
        let turned: Vec<Option<usize>> =
            (0..tree.bones.len()).map(|bone| poses.track_of(bone)).collect();
        let orders: Vec<Option<RotationOrder>> =
            (0..tree.bones.len()).map(|bone| self.order(bone)).collect();
        let mut angles = vec![[0.0; 3]; tree.bones.len()];
        for (frame, hips) in poses.hips.iter().enumerate() {
            let start = text.len();
            for (bone, channels) in self.channels.iter().enumerate() {
                let place = match bone == carrier {
                    true => tree.bones[bone].place + (*hips - rest),
                    false => tree.bones[bone].place,
                };
                if let (Some(track), Some(order)) = (turned[bone], orders[bone]) {
                    let turn = poses.turns[track][frame];
                    angles[bone] = order.nearest_angles(turn, angles[bone]);
                }
                let mut turns = angles[bone].iter();
                for channel in channels {
                    let value = match channel {
                        Channel::Place(axis) => place[*axis],
                        Channel::Turn(_) => turns.next().copied().unwrap_or(0.0).to_degrees(),
                    };
                    text.push(' ');
                    push_decimal(&mut text, value, DECIMALS)?;
                }
            }
            if text.len() > start {
                // Every number comes with a space in front; a line starts without.
                text.remove(start);
            }
            text.push_str(end);
        }
        Ok([&self.bytes[..self.motion], text.as_bytes()].concat())
    }
}
