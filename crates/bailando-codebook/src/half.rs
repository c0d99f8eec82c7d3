//! The two halves of the body that have codes of their own.

/// A half of the body with codes of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// From the lowest spine joint upwards.
    Upper,
    /// Pelvis and legs.
    Lower,
}

impl Half {
    /// Both halves, in the order of every `[upper, lower]`.
    pub(crate) const BOTH: [Self; 2] = [Self::Upper, Self::Lower];

    /// `upper` or `lower`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Upper => "upper",
            Self::Lower => "lower",
        }
    }

    /// Returns the half that `joint` belongs to.
    pub(crate) fn of_joint(joint: usize, upper_joints: &[usize]) -> Self {
        match upper_joints.contains(&joint) {
            true => Self::Upper,
            false => Self::Lower,
        }
    }

    pub(crate) const fn other(self) -> Self {
        match self {
            Self::Upper => Self::Lower,
            Self::Lower => Self::Upper,
        }
    }

    /// Picks this half's part of an `[upper, lower]`.
    pub(crate) const fn of<T>(self, [upper, lower]: &[T; 2]) -> &T {
        match self {
            Self::Upper => upper,
            Self::Lower => lower,
        }
    }
}
