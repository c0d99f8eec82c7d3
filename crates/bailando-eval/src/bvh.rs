//! BVH of any rig: hierarchy, channels, and where the joints are.

use std::str::SplitWhitespace;

use glam::{DQuat, DVec3};

/// One number of a line of channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Channel {
    Position(usize),
    Rotation(DVec3),
}

/// A joint of a [`BvhFile`].
#[derive(Clone, Debug)]
pub struct BvhJoint {
    /// Its name.
    pub name: String,
    /// Place of its parent, which comes before it; none for a root.
    pub parent: Option<usize>,
    /// From the parent, in the file's unit.
    pub offset: DVec3,
    /// Offset of its end site, where it has one.
    pub end: Option<DVec3>,
    pub(crate) channels: Vec<Channel>,
}

/// A BVH file of any rig, in its own unit.
#[derive(Clone, Debug)]
pub struct BvhFile {
    /// Joints, a parent before its children.
    pub joints: Vec<BvhJoint>,
    /// Frames a second.
    pub frames_per_second: f64,
    pub(crate) values: Vec<f64>,
    /// Numbers of a frame; above zero.
    pub(crate) channels: usize,
}

/// Places, local and world rotations of all joints of a file in one frame.
#[derive(Clone, Debug, Default)]
pub struct BvhPose {
    /// Where the joints are. A root is where its position channels say.
    pub places: Vec<DVec3>,
    /// Rotations beside the parents'.
    pub local: Vec<DQuat>,
    /// Rotations in the world.
    pub world: Vec<DQuat>,
}

impl BvhFile {
    /// Reads a file.
    ///
    /// # Errors
    /// What is wrong with it, in words.
    ///
    /// ```
    /// use bailando_eval::BvhFile;
    ///
    /// let text = "HIERARCHY ROOT hips { OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition
    ///     End Site { OFFSET 0 1 0 } } MOTION Frames: 1 Frame Time: 0.01 4 5 6";
    /// let file = BvhFile::parse(text)?;
    /// assert_eq!(file.frames_per_second, 100.0);
    /// assert_eq!(file.pose(0).places[0].to_array(), [4.0, 5.0, 6.0]);
    /// # Ok::<(), String>(())
    /// ```
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut words = text.split_whitespace();
        let joints = hierarchy(&mut words)?;
        let frames: usize = labelled(&mut words, &["Frames:"])?;
        let frame_time: f64 = labelled(&mut words, &["Frame", "Time:"])?;
        let values: Vec<f64> = words.map(number).collect::<Result<_, _>>()?;
        let channels = joints.iter().map(|joint| joint.channels.len()).sum();
        if channels == 0 || frames.checked_mul(channels) != Some(values.len()) {
            let found = values.len();
            return Err(format!("{found} numbers are not {frames} frames of {channels} channels"));
        }
        Ok(Self { joints, frames_per_second: 1.0 / frame_time, values, channels })
    }

    /// Returns the number of frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.values.len() / self.channels
    }

    /// Returns the pose of a frame; of a frame that is not there, that of zeros.
    #[must_use]
    pub fn pose(&self, frame: usize) -> BvhPose {
        let mut values = self.values.iter().copied().skip(frame * self.channels);
        let mut found = BvhPose::default();
        for joint in &self.joints {
            let mut shift = None;
            let mut local = DQuat::IDENTITY;
            for channel in &joint.channels {
                let value = values.next().unwrap_or_default();
                match *channel {
                    Channel::Position(axis) => shift.get_or_insert(DVec3::ZERO)[axis] += value,
                    Channel::Rotation(axis) => {
                        local *= DQuat::from_axis_angle(axis, value.to_radians());
                    }
                }
            }
            let (place, world) = match joint.parent {
                None => (shift.unwrap_or_default(), local),
                Some(parent) => {
                    let turn = found.world[parent];
                    let offset = shift.unwrap_or(joint.offset);
                    (found.places[parent] + turn * offset, turn * local)
                }
            };
            found.places.push(place);
            found.local.push(local);
            found.world.push(world);
        }
        found
    }
}

/// Reads the joints up to the word MOTION; a parent comes before its children.
fn hierarchy(words: &mut SplitWhitespace<'_>) -> Result<Vec<BvhJoint>, String> {
    expect(words, "HIERARCHY")?;
    let mut joints: Vec<BvhJoint> = Vec::new();
    // The joints whose brackets are open, and whether it is that of their end site.
    let mut open: Vec<(usize, bool)> = Vec::new();
    loop {
        match word(words)? {
            "ROOT" | "JOINT" => {
                joints.push(BvhJoint {
                    name: word(words)?.to_owned(),
                    parent: open.last().map(|&(joint, _)| joint),
                    offset: DVec3::ZERO,
                    end: None,
                    channels: Vec::new(),
                });
                expect(words, "{")?;
                open.push((joints.len() - 1, false));
            }
            "End" => {
                expect(words, "Site")?;
                expect(words, "{")?;
                let &(joint, _) = open.last().ok_or("an end site without a joint")?;
                open.push((joint, true));
            }
            "OFFSET" => {
                let offset = vector(words)?;
                let of = open.last().and_then(|&(at, end)| Some((joints.get_mut(at)?, end)));
                match of {
                    Some((joint, true)) => joint.end = Some(offset),
                    Some((joint, false)) => joint.offset = offset,
                    None => {}
                }
            }
            "CHANNELS" => {
                let channels = channels(words)?;
                let at = open.last().filter(|(_, is_end)| !is_end).map(|&(joint, _)| joint);
                let joint = at.and_then(|at| joints.get_mut(at));
                joint.ok_or("channels without a joint")?.channels = channels;
            }
            "}" => {
                open.pop().ok_or("a bracket closes nothing")?;
            }
            "MOTION" => return Ok(joints),
            other => return Err(format!("the hierarchy holds {other:?}")),
        }
    }
}

fn channels(words: &mut SplitWhitespace<'_>) -> Result<Vec<Channel>, String> {
    let count = number(word(words)?)? as usize;
    (0..count.min(6))
        .map(|_| match word(words)? {
            "Xposition" => Ok(Channel::Position(0)),
            "Yposition" => Ok(Channel::Position(1)),
            "Zposition" => Ok(Channel::Position(2)),
            "Xrotation" => Ok(Channel::Rotation(DVec3::X)),
            "Yrotation" => Ok(Channel::Rotation(DVec3::Y)),
            "Zrotation" => Ok(Channel::Rotation(DVec3::Z)),
            other => Err(format!("there is no channel {other:?}")),
        })
        .collect()
}

fn word<'a>(words: &mut SplitWhitespace<'a>) -> Result<&'a str, String> {
    words.next().ok_or_else(|| "the file ends too early".into())
}

fn expect(words: &mut SplitWhitespace<'_>, wanted: &str) -> Result<(), String> {
    match word(words)? {
        found if found == wanted => Ok(()),
        found => Err(format!("expected {wanted}, got {found:?}")),
    }
}

fn number(word: &str) -> Result<f64, String> {
    word.parse().map_err(|_| format!("{word:?} is no number"))
}

fn vector(words: &mut SplitWhitespace<'_>) -> Result<DVec3, String> {
    let mut next = || number(word(words)?);
    Ok(DVec3::new(next()?, next()?, next()?))
}

fn labelled<T: std::str::FromStr>(
    words: &mut SplitWhitespace<'_>,
    label: &[&str],
) -> Result<T, String> {
    for part in label {
        expect(words, part)?;
    }
    let value = word(words)?;
    let parsed = value.parse();
    parsed.map_err(|_| format!("{} {value:?} is no number", label.join(" ")))
}
