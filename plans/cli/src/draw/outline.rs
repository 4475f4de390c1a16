//! What is on the ground by its outline: parking spaces as they were last seen, what people said is there, and what they are
//! asked about.

use std::borrow::Cow;

use crate::draw::colours;

/// What an outline is of.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Mark {
    /// A space that was free when it was last seen.
    Free,
    /// A space that was taken when it was last seen.
    Taken,
    /// A space that nobody has seen well enough to say.
    Unseen,
    /// A label of another kind, this one.
    Label(String),
    /// A box that a person is asked about.
    Asked,
    /// A label as the version of this number places it.
    Version(u64),
}

impl Mark {
    /// Of a space in this state.
    pub fn of_state(state: &str) -> Self {
        match state {
            "free" => Self::Free,
            "taken" => Self::Taken,
            _ => Self::Unseen,
        }
    }

    /// As the legend has it.
    pub fn name(&self) -> Cow<'static, str> {
        match self {
            Self::Free => "space, free when last seen".into(),
            Self::Taken => "space, taken when last seen".into(),
            Self::Unseen => "space, not seen".into(),
            Self::Label(kind) => kind.replace('_', " ").into(),
            Self::Asked => "asked about".into(),
            Self::Version(number) => format!("version {number}").into(),
        }
    }

    /// Its colour.
    pub fn colour(&self) -> String {
        let colour = match self {
            Self::Free => colours::FREE,
            Self::Taken => colours::TAKEN,
            Self::Unseen => colours::UNSEEN,
            Self::Label(_) => colours::LABEL,
            Self::Asked => colours::ASKED,
            Self::Version(number) => return colours::session(number.saturating_sub(1) as usize),
        };
        colour.to_owned()
    }

    /// How much of what lies below it hides.
    pub fn opacity(&self) -> f64 {
        match self {
            Self::Free | Self::Taken => 0.3,
            Self::Unseen | Self::Label(_) | Self::Asked | Self::Version(_) => 0.0,
        }
    }
}

/// An outline on the ground.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// What it is of.
    pub mark: Mark,
    /// What a person reads who points at it.
    pub title: String,
    /// Whether a person said that it is there; else it was found.
    pub said: bool,
    /// Whether it is an area, rather than a line.
    pub closed: bool,
    /// Its corners in the map (m).
    pub points: Vec<[f64; 2]>,
}
